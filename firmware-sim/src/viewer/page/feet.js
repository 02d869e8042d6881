// When the feet stand, one row a foot below the timeline.
const FEET = ["left foot", "right foot"], TOES = [10, 11];

function drawFeet(host, motion) {
  const last = Math.max(1, FRAMES - 1), seconds = (frame) => (frame / scene.fps).toFixed(2);
  FEET.forEach((name, foot) => {
    const row = document.createElement("div");
    row.title = `${name} of the ${motion.name.toLowerCase()} motion: where it stands`;
    for (const [from, to] of motion.stances[foot]) {
      const bar = document.createElement("i");
      bar.style.left = `${(100 * from) / last}%`;
      bar.style.width = `${(100 * (to - 1 - from)) / last}%`;
      bar.title = `${name} stands, ${seconds(from)} to ${seconds(to - 1)} s`;
      row.append(bar);
    }
    host.append(row);
  });
}
