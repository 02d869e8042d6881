// How the planner revised the tokens: one row a step, one column a token, a colour a code. The column that is playing is
// marked; a cell that differs from the step before has a dot.
const codeColor = (code) => `hsl(${(code * 137.508) % 360} 62% ${46 + ((code * 7) % 5) * 4}%)`;

function drawTokens(host, plan, framesPerToken) {
  const canvas = document.createElement("canvas"), read = document.createElement("div");
  canvas.setAttribute("role", "img");
  canvas.setAttribute("aria-label", "Tokens after each planner step; click to jump to a token");
  read.className = "read";
  host.append(canvas, read);
  const rows = plan.steps, columns = rows[0].length, tall = Math.max(7, Math.min(16, 150 / rows.length));
  let hover = null, playing = -1;

  const changed = (r, c) => r > 0 && rows[r][c] !== rows[r - 1][c];
  const say = () => {
    const revised = rows.map((row, r) => row.filter((_, c) => changed(r, c)).length);
    read.textContent = hover
      ? `step ${hover[0]}, token ${hover[1]} (${((hover[1] * framesPerToken) / scene.fps).toFixed(1)} s): code ${rows[hover[0]][hover[1]]}${plan.fixed.includes(hover[1]) ? ", fixed" : ""}`
      : `${columns} tokens; revised in steps 1 to ${rows.length - 1}: ${revised.slice(1).join(", ")}`;
  };
  const draw = () => {
    const wide = host.clientWidth || 312, scale = window.devicePixelRatio || 1, each = wide / columns;
    canvas.style.width = `${wide}px`;
    canvas.style.height = `${tall * rows.length}px`;
    canvas.width = wide * scale;
    canvas.height = tall * rows.length * scale;
    const c = canvas.getContext("2d");
    c.scale(scale, scale);
    rows.forEach((row, r) => row.forEach((code, i) => {
      c.fillStyle = codeColor(code);
      c.fillRect(i * each, r * tall, each - 0.6, tall - 0.6);
      if (changed(r, i)) {
        c.fillStyle = "rgb(255 255 255 / .85)";
        c.beginPath();
        c.arc(i * each + each / 2, r * tall + tall / 2, Math.min(each, tall) * 0.14, 0, 7);
        c.fill();
      }
    }));
    if (playing >= 0) {
      c.strokeStyle = getComputedStyle(document.documentElement).getPropertyValue("--text");
      c.lineWidth = 1.5;
      c.strokeRect(playing * each - 0.5, 0.75, each, tall * rows.length - 1.5);
    }
  };
  const at = (e) => {
    const box = canvas.getBoundingClientRect();
    const cell = [Math.floor(((e.clientY - box.top) / box.height) * rows.length), Math.floor(((e.clientX - box.left) / box.width) * columns)];
    return rows[cell[0]] && rows[cell[0]][cell[1]] !== undefined ? cell : null;
  };
  canvas.addEventListener("pointermove", (e) => { hover = at(e); say(); });
  canvas.addEventListener("pointerleave", () => { hover = null; say(); });
  canvas.addEventListener("click", (e) => { const cell = at(e); if (cell) { setPlaying(false); seek(cell[1] * framesPerToken); } });
  new ResizeObserver(draw).observe(host);
  say();
  // Marks the token that is playing.
  return (frame) => {
    const token = Math.min(columns - 1, Math.floor(frame / framesPerToken));
    if (token !== playing) { playing = token; draw(); }
  };
}

// Work of each stage as one bar, with its share and time here.
function drawStages(host, stages) {
  const total = stages.reduce((sum, s) => sum + s.macs, 0) || 1, bar = document.createElement("div"), list = document.createElement("dl");
  bar.className = "bar";
  list.className = "facts";
  stages.forEach((s, i) => {
    const piece = document.createElement("i"), dt = document.createElement("dt"), dd = document.createElement("dd");
    piece.style.flexGrow = s.macs / total;
    piece.style.setProperty("--swatch", `var(${["--reference", "--before", "--accent", "--target"][i % 4]})`);
    piece.title = s.label;
    bar.append(piece);
    dt.textContent = s.label;
    dd.textContent = `${(s.macs / 1e6).toFixed(0)} M MAC, ${s.milliseconds.toFixed(0)} ms here`;
    list.append(dt, dd);
  });
  host.append(bar, list);
}
