// Curves over the frames of the motion, as an inline SVG that marks the frame that is shown and moves it.
// Each curve: its name, the class of its line, and a value or null for each frame, centimetres.
function drawOverTime(host, label, curves, signed) {
  host.replaceChildren();
  const W = 312, H = 116, left = 40, right = 6, top = 8, bottom = 26, last = Math.max(1, FRAMES - 1);
  const values = curves.flatMap((c) => c.values).filter((v) => v !== null && Number.isFinite(v));
  // What is far away says no more than that it is.
  const hi = Math.max(1, Math.min(signed ? 60 : Infinity, Math.max(...values, 0))), lo = signed ? Math.min(-5, ...values) : 0;
  const svg = element(host, "svg", { viewBox: `0 0 ${W} ${H}`, role: "slider", tabindex: 0, "aria-label": `${label}; left and right move in time`, "aria-valuemin": 0, "aria-valuemax": FRAMES - 1 });
  const x = (f) => left + ((W - left - right) * f) / last;
  const y = (v) => top + ((H - top - bottom) * (hi - Math.max(lo, Math.min(hi, v)))) / (hi - lo);
  for (const v of signed ? [lo, 0, hi] : [0, hi / 2, hi]) {
    element(svg, "line", { class: v === 0 && signed ? "zero" : "grid", x1: left, x2: W - right, y1: y(v), y2: y(v) });
    element(svg, "text", { x: left - 6, y: y(v) + 4, "text-anchor": "end" }, v.toFixed(hi < 4 ? 1 : 0));
  }
  const seconds = last / scene.fps, step = Math.max(1, Math.ceil(seconds / 6));
  for (let s = 0; s <= seconds; s += step) element(svg, "text", { x: x(s * scene.fps), y: H - bottom + 14, "text-anchor": "middle" }, `${s} s`);
  for (const curve of curves) {
    let run = [];
    const flush = () => { if (run.length > 0) element(svg, "polyline", { class: curve.name, points: run.length > 1 ? run.join(" ") : `${run[0]} ${run[0]}` }); run = []; };
    curve.values.forEach((v, f) => { if (v === null || f > last) flush(); else run.push(`${x(f).toFixed(1)},${y(v).toFixed(1)}`); });
    flush();
  }
  const head = element(svg, "line", { class: "head", y1: top, y2: H - bottom }), read = element(svg, "text", { class: "read", x: W - right, y: H - 1, "text-anchor": "end" });
  const still = (frame) => { setPlaying(false); seek(frame); };
  svg.addEventListener("pointerdown", (e) => {
    const box = svg.getBoundingClientRect();
    still(Math.round((((e.clientX - box.left) / box.width) * W - left) / (W - left - right) * last));
  });
  onArrows(svg, (by) => still(Math.round(player.frame) + by), null, (end) => still(end * last));
  const words = (f) => curves.map((c) => (c.values[f] ?? null) === null ? null : `${c.values[f].toFixed(1)} cm ${c.name === "before" ? "before" : "refined"}`).filter((t) => t).join(", ");
  return (frame) => {
    for (const k of ["x1", "x2"]) head.setAttribute(k, x(frame));
    const text = words(frame) || "free";
    read.textContent = text;
    svg.setAttribute("aria-valuenow", frame);
    svg.setAttribute("aria-valuetext", `${(frame / scene.fps).toFixed(2)} s: ${text}`);
  };
}

// Curves of each track's error, and of the clearance; returns what moves their heads to a frame.
function drawFollowing() {
  const over = (track, errors) => Array.from({ length: FRAMES }, (_, f) => errors[f - track.first] ?? null);
  const marks = scene.tracks.map((track, number) => {
    const name = document.createElement("h3"), host = document.createElement("div");
    name.textContent = `track ${number}: ${track.name}`;
    host.className = "chart";
    $("trackcharts").append(name, host);
    const curves = [{ name: "before", values: over(track, track.before_cm) }, { name: "after", values: over(track, track.after_cm) }];
    return drawOverTime(host, `Distance of the ${track.name} from track ${number}, centimetres`, curves, false);
  });
  if (scene.clearance) {
    const curves = [{ name: "before", values: scene.clearance.before_cm }, { name: "after", values: scene.clearance.after_cm }];
    marks.push(drawOverTime($("clearancechart"), "Room between the body and the margins of obstacles, centimetres", curves, true));
  }
  return (frame) => marks.forEach((mark) => mark(frame));
}
