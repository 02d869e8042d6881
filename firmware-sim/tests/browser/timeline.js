// Shows the spans of a timeline, switches them off by their key, and goes to one by its bar.
const press = async (key) => {
  (document.activeElement || document).dispatchEvent(new KeyboardEvent("keydown", { key, bubbles: true, cancelable: true }));
  await painted();
};
const view = document.getElementById("view");
const pixels = () => [...view.getContext("2d").getImageData(0, 0, view.width, view.height).data];
const bars = [...document.querySelectorAll("#timeline button")];
const seen = { labels: bars.map((bar) => bar.textContent), titles: bars.map((bar) => bar.title) };
motionette.play(false);
motionette.seek(50);
await painted();
seen.now = bars.map((bar) => bar.classList.contains("now"));
// Where each bar begins and ends, as frames of the axis.
const axis = document.getElementById("timeline").getBoundingClientRect(), last = motionette.state().frames - 1;
seen.places = bars.map((bar) => { const box = bar.getBoundingClientRect(); return [box.left, box.right].map((x) => Math.round((last * (x - axis.left)) / axis.width)); });
// Colours of the body at the same size of the view: bars that go make room.
const height = view.height;
document.getElementById("timeline").style.cssText = "height: 0; margin: 0; overflow: hidden";
await painted();
const on = pixels();
await press("9");
const off = pixels();
seen.hidden = !motionette.state().layers.timeline && bars.every((bar) => !bar.getClientRects().length);
seen.changed = on.length === off.length ? on.filter((v, i) => v !== off[i]).length : -1;
await press("9");
document.getElementById("timeline").style.cssText = "";
await painted();
seen.back = view.height === height && bars.every((bar) => bar.getClientRects().length);
bars[bars.length - 1].click();
await painted();
seen.frame = motionette.state().frame;
seen.later = bars.map((bar) => bar.classList.contains("now"));
return seen;
