// How the planner revised the tokens: one row a step, one column a token, a colour a code. The column that is playing is
// marked; a cell that differs from the step before has a dot.
const codeHue = (code) => [(code * 137.508) % 360, 0.62, 0.46 + ((code * 7) % 5) * 0.04];
const codeColor = (code) => { const [h, s, l] = codeHue(code); return `hsl(${h} ${100 * s}% ${100 * l}%)`; };

// Black or white, whichever stands out more from the code's colour.
function dotColor(code) {
  const [h, s, l] = codeHue(code), a = s * Math.min(l, 1 - l);
  const channel = (n) => { const k = (n + h / 30) % 12; return l - a * Math.max(-1, Math.min(k - 3, 9 - k, 1)); };
  const linear = (v) => (v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4);
  const light = 0.2126 * linear(channel(0)) + 0.7152 * linear(channel(8)) + 0.0722 * linear(channel(4));
  return light > 0.179 ? "#000" : "#fff";
}

function drawTokens(host, plan, framesPerToken) {
  const canvas = document.createElement("canvas"), read = document.createElement("div");
  const rows = plan.steps, columns = rows[0].length, tall = Math.max(7, Math.min(16, 150 / rows.length));
  canvas.tabIndex = 0;
  canvas.setAttribute("role", "slider");
  canvas.setAttribute("aria-label", "Tokens after each planner step; left and right jump from token to token, up and down choose a step");
  canvas.setAttribute("aria-valuemin", 0);
  canvas.setAttribute("aria-valuemax", columns - 1);
  read.className = "read";
  host.append(canvas, read);
  // The cell below the pointer, and the one that the keyboard is on, [step, token].
  let hover = null, chosen = null, playing = -1;

  const changed = (r, c) => r > 0 && rows[r][c] !== rows[r - 1][c] && rows[r - 1][c] !== null;
  const say = () => {
    const cell = hover || chosen;
    const revised = rows.map((row, r) => row.filter((_, c) => changed(r, c)).length);
    read.textContent = cell
      ? `step ${cell[0]}, token ${cell[1]} (${((cell[1] * framesPerToken) / scene.fps).toFixed(1)} s): ${rows[cell[0]][cell[1]] === null ? "yet to come" : `code ${rows[cell[0]][cell[1]]}`}${plan.fixed.includes(cell[1]) ? ", fixed" : ""}`
      : `${columns} tokens; revised in steps 1 to ${rows.length - 1}: ${revised.slice(1).join(", ")}`;
    canvas.setAttribute("aria-valuenow", cell ? cell[1] : Math.max(0, playing));
    canvas.setAttribute("aria-valuetext", read.textContent);
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
      // The clause of that position is yet to be planned.
      if (code === null) return;
      c.fillStyle = codeColor(code);
      c.fillRect(i * each, r * tall, each - 0.6, tall - 0.6);
      if (changed(r, i)) {
        c.fillStyle = dotColor(code);
        c.beginPath();
        c.arc(i * each + each / 2, r * tall + tall / 2, Math.min(each, tall) * 0.14, 0, 7);
        c.fill();
      }
    }));
    const mark = (x, y, w, h) => [["--panel", 3.5], ["--text", 1.5]].forEach(([color, width]) => {
      c.strokeStyle = getComputedStyle(document.documentElement).getPropertyValue(color);
      c.lineWidth = width;
      c.strokeRect(x - 0.5, y + 0.75, w, h - 1.5);
    });
    if (playing >= 0) mark(playing * each, 0, each, tall * rows.length);
    if (chosen) mark(chosen[1] * each, chosen[0] * tall, each, tall);
  };
  const at = (e) => {
    const box = canvas.getBoundingClientRect();
    const cell = [Math.floor(((e.clientY - box.top) / box.height) * rows.length), Math.floor(((e.clientX - box.left) / box.width) * columns)];
    return rows[cell[0]] && rows[cell[0]][cell[1]] !== undefined ? cell : null;
  };
  canvas.addEventListener("pointermove", (e) => { hover = at(e); say(); });
  canvas.addEventListener("pointerleave", () => { hover = null; say(); });
  canvas.addEventListener("click", (e) => { const cell = at(e); if (cell) choose(...cell); });
  const choose = (step, token) => {
    chosen = [Math.max(0, Math.min(rows.length - 1, step)), Math.max(0, Math.min(columns - 1, token))];
    setPlaying(false);
    seek(chosen[1] * framesPerToken);
    say();
    draw();
  };
  canvas.addEventListener("focus", () => { chosen = chosen || [rows.length - 1, Math.max(0, playing)]; say(); draw(); });
  canvas.addEventListener("blur", () => { chosen = null; say(); draw(); });
  onArrows(canvas, (by) => choose(chosen[0], chosen[1] + by), (by) => choose(chosen[0] + by, chosen[1]), (end) => choose(chosen[0], end * (columns - 1)));
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
