// Shows tracks and obstacles, switches them off by their key, and goes through their curves by keyboard.
const press = async (key) => {
  (document.activeElement || document).dispatchEvent(new KeyboardEvent("keydown", { key, bubbles: true, cancelable: true }));
  await painted();
};
const view = document.getElementById("view");
const pixels = () => [...view.getContext("2d").getImageData(0, 0, view.width, view.height).data];
const charts = (selector) => [...document.querySelectorAll(`${selector} svg`)].filter((e) => e.getClientRects().length);
motionette.play(false);
motionette.seek(60);
await painted();
const on = pixels();
await press("8");
const off = pixels(), hidden = !motionette.state().layers.scene;
await press("8");
const tracks = charts("#trackcharts"), clearance = charts("#clearancechart");
const seen = { hidden, changed: on.filter((v, i) => v !== off[i]).length, tracks: tracks.length, clearance: clearance.length, read: [] };
for (const chart of [...tracks, ...clearance]) {
  chart.focus();
  await press("ArrowRight");
  seen.read.push([motionette.state().frame, chart.getAttribute("aria-valuetext"), chart.querySelectorAll("polyline").length]);
}
return seen;
