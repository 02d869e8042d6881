// Plays until the skeleton has moved, 30 s at most, and switches the third layer by its key.
motionette.play(false);
motionette.seek(0);
motionette.play(true);
document.dispatchEvent(new KeyboardEvent("keydown", { key: "3" }));
const alone = motionette.state().layers.alone;
for (let tries = 0; tries < 300 && motionette.state().frame <= 1; tries++) await wait(100);
return {
  state: motionette.state(),
  alone,
  intervals: [...document.querySelectorAll("#intervals button")].map((b) => b.title),
  columns: [...document.querySelectorAll("#anchors th")].map((e) => e.textContent),
};
