// Goes to every chart as the tab key does, and moves in it with the arrow keys.
const press = async (key) => {
  const e = new KeyboardEvent("keydown", { key, bubbles: true, cancelable: true });
  document.activeElement.dispatchEvent(e);
  await painted();
  return e.defaultPrevented;
};
// What the tab key stops at inside an element.
const stops = (selector) => [...document.querySelectorAll(`${selector} *`)].filter((e) => e.tabIndex >= 0 && e.getClientRects().length);
const value = () => document.activeElement.getAttribute("aria-valuetext");
const frame = () => motionette.state().frame;
const start = async (at) => {
  motionette.play(false);
  motionette.seek(at);
  await painted();
};
const seen = {};

await start(0);
seen.tokenStops = stops("#tokens").length;
stops("#tokens")[0].focus();
seen.tokenFirst = [frame(), value()];
for (const key of ["ArrowRight", "ArrowRight", "ArrowRight", "ArrowUp"]) await press(key);
seen.tokenThird = [frame(), value()];
seen.tokenHandled = await press("End");
seen.tokenLast = [frame(), value()];

await start(40);
seen.servoStops = stops("#servos").length;
stops("#servos")[0].focus();
const first = document.activeElement.getAttribute("aria-label");
await press("ArrowDown");
seen.servos = [first, document.activeElement.getAttribute("aria-label")];
seen.servoStopsLater = stops("#servos").length;
await press("ArrowRight");
await press("ArrowRight");
seen.servoTime = [frame(), value()];
await press("Home");
seen.servoHome = frame();

await start(40);
seen.curveStops = stops("#chart").length;
stops("#chart")[0].focus();
const last = value();
await press("ArrowLeft");
seen.curve = [last, value(), document.querySelector("#chart .read").textContent, frame()];
return seen;
