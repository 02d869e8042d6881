// The intervals between anchors on the token grid below the timeline, one row a stage, filled as far as the interval is active there.
function drawIntervals(host, intervals) {
  const stages = ["before", "after"], read = document.createElement("div");
  read.className = "read";
  const part = (frame) => Math.max(0, Math.min(100, (100 * frame) / Math.max(1, FRAMES - 1)));
  const seconds = (frame) => (frame / scene.fps).toFixed(2);
  const describe = (i) => `${seconds(i.left)} to ${seconds(i.right)} s, ${i.tokens} tokens: activity ${stages.map((id, k) => `${i.activity[k].toFixed(2)} ${motions[id].name.toLowerCase()}`).join(", ")}`;
  const legend = () => {
    read.replaceChildren("interval activity");
    for (const id of stages) {
      const swatch = document.createElement("i");
      swatch.style.setProperty("--swatch", `var(${COLORS[id]})`);
      read.append(swatch, motions[id].name.toLowerCase());
    }
  };
  const boxes = intervals.map((interval) => {
    const box = document.createElement("button"), first = interval.token * scene.frames_per_token;
    const from = part(first - 0.5), to = part(first + interval.tokens * scene.frames_per_token - 0.5);
    box.style.left = `${from}%`;
    box.style.width = `${to - from}%`;
    box.style.setProperty("--tokens", interval.tokens);
    box.title = describe(interval);
    box.setAttribute("aria-label", `Jump to the interval of ${box.title}`);
    stages.forEach((id, k) => {
      const row = document.createElement("i");
      row.style.setProperty("--swatch", `var(${COLORS[id]})`);
      row.style.setProperty("--activity", `${100 * interval.activity[k]}%`);
      box.append(row);
    });
    box.addEventListener("click", () => { setPlaying(false); seek(interval.left); });
    for (const event of ["pointerenter", "focus"]) box.addEventListener(event, () => { read.textContent = box.title; });
    for (const event of ["pointerleave", "blur"]) box.addEventListener(event, legend);
    host.append(box);
    return box;
  });
  host.append(read);
  legend();
  // Marks the interval that is playing.
  return (frame) => {
    const token = Math.floor(frame / scene.frames_per_token);
    boxes.forEach((box, k) => box.classList.toggle("now", token >= intervals[k].token && token < intervals[k].token + intervals[k].tokens));
  };
}
