// How much of the body the labels cover: pixels that change both when the body and when the labels are switched off.
const view = document.getElementById("view");
const layer = (id, on) => {
  const button = document.querySelector(`[data-layer="${id}"]`);
  if (button && (button.getAttribute("aria-pressed") === "true") !== on) button.click();
};
const pixels = async (after, labels) => {
  layer("after", after);
  layer("labels", labels);
  await painted();
  return view.getContext("2d").getImageData(0, 0, view.width, view.height).data;
};
const differs = (a, b, k, by) => Math.abs(a[k] - b[k]) + Math.abs(a[k + 1] - b[k + 1]) + Math.abs(a[k + 2] - b[k + 2]) > by;

// On dark ground the body's shadow is no change to speak of.
if (document.documentElement.dataset.theme !== "dark") document.getElementById("theme").click();
for (const id of ["before", "alone", "robot", "reference", "trails"]) layer(id, false);
motionette.play(false);
const shares = [], drawn = [];
for (let frame = 0; frame < motionette.state().frames; frame += 9) {
  motionette.seek(frame);
  const bare = await pixels(false, false), body = await pixels(true, false), labelled = await pixels(true, true);
  let all = 0, covered = 0, ink = 0;
  // The last row may be half a pixel and keep something of what was painted before.
  for (let k = 0; k < body.length - 4 * view.width; k += 4) {
    const label = differs(body, labelled, k, 30);
    if (label) ink++;
    if (!differs(body, bare, k, 90)) continue;
    all++;
    if (label) covered++;
  }
  shares.push(covered / Math.max(1, all));
  drawn.push([all, ink]);
}
return { shares, drawn };
