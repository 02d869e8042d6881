// Tracks as curves, from green where the motion is on them to the colour of faults where it is far off, and obstacles as see-through bodies.
// A motion is far off a track from here on, centimetres.
const FAR_OFF = 10;

// Where a track wants its joint at a frame; axes that do not count are those of the motion.
function trackPoint(track, index) {
  const place = track.positions[index];
  if (!place) return null;
  const at = jointAt(motions.after, track.first + index, track.joint);
  return place.map((v, k) => (track.axes[k] ? v : at[k]));
}

function drawTrack(track, number, frame) {
  const last = track.positions.length - 1, now = Math.round(frame) - track.first;
  ctx.lineCap = "round";
  let before = null;
  for (let i = 0; i <= last; i++) {
    const point = trackPoint(track, i), q = point && project(point);
    if (q) {
      const error = track.after_cm[i] ?? 0, color = palette.reference.map((v, k) => v + (palette.fault[k] - v) * Math.min(1, error / FAR_OFF));
      ctx.strokeStyle = ctx.fillStyle = rgba(color.map(Math.round), i <= now ? 0.95 : 0.45);
      ctx.lineWidth = 2;
      ctx.beginPath();
      if (before) { ctx.moveTo(before.x, before.y); ctx.lineTo(q.x, q.y); ctx.stroke(); } else { ctx.arc(q.x, q.y, 2, 0, 2 * Math.PI); ctx.fill(); }
    }
    before = q;
  }
  const point = now >= 0 && now <= last ? trackPoint(track, now) : null, q = point && project(point);
  if (!q) return;
  ctx.strokeStyle = rgba(palette.target, 1);
  ctx.lineWidth = 2;
  ctx.beginPath();
  ctx.arc(q.x, q.y, Math.max(4, 0.04 * q.s), 0, 2 * Math.PI);
  ctx.stroke();
  if (show.after) line(ctx, jointAt(motions.after, frame, track.joint), point);
  if (show.labels) tag(`track ${number}`, q.x + 10, q.y - 10, palette.target);
}

function tag(text, x, y, color) {
  ctx.font = "600 11px system-ui, -apple-system, 'Segoe UI', Roboto, 'DejaVu Sans', sans-serif";
  ctx.textBaseline = "middle";
  const w = ctx.measureText(text).width + 10;
  ctx.beginPath();
  ctx.roundRect(x, y - 9, w, 18, 5);
  ctx.fillStyle = rgba(palette.panel, 0.88);
  ctx.fill();
  ctx.strokeStyle = rgba(color, 0.9);
  ctx.lineWidth = 1;
  ctx.stroke();
  ctx.fillStyle = rgba(palette.text, 1);
  ctx.fillText(text, x + 5, y + 0.5);
}

// The middle of an obstacle at a frame that may lie between two.
function middleAt(obstacle, frame) {
  const all = obstacle.middles, f0 = Math.min(all.length - 1, Math.floor(frame)), f1 = Math.min(all.length - 1, f0 + 1);
  return add(all[f0], sub(all[f1], all[f0]), all.length > 1 ? frame - Math.floor(frame) : 0);
}

const ringAt = (p, radius) => Array.from({ length: 28 }, (_, i) => [p[0] + radius * Math.cos((i * Math.PI) / 14), p[1], p[2] + radius * Math.sin((i * Math.PI) / 14)]);

// The outline of points on the screen, counter-clockwise.
function hull(points) {
  const sorted = [...points].sort((a, b) => a.x - b.x || a.y - b.y);
  const half = (list) => {
    const out = [];
    for (const p of list) {
      const turn = () => { const [a, b] = out.slice(-2); return (b.x - a.x) * (p.y - a.y) - (b.y - a.y) * (p.x - a.x); };
      while (out.length > 1 && turn() <= 0) out.pop();
      out.push(p);
    }
    return out.slice(0, -1);
  };
  return [...half(sorted), ...half(sorted.reverse())];
}

function fillHull(points) {
  const seen = points.map(project);
  // Partly behind the eye it has no outline.
  if (seen.some((q) => !q)) return;
  ctx.beginPath();
  hull(seen).forEach((q, i) => (i ? ctx.lineTo(q.x, q.y) : ctx.moveTo(q.x, q.y)));
  ctx.closePath();
  ctx.fill();
  ctx.stroke();
}

const EDGES = [[0, 1], [2, 3], [4, 5], [6, 7], [0, 2], [1, 3], [4, 6], [5, 7], [0, 4], [1, 5], [2, 6], [3, 7]];

function drawObstacle(obstacle, number, frame) {
  const p = middleAt(obstacle, frame), { half, radius } = obstacle, color = palette.fault;
  ctx.fillStyle = rgba(color, palette.dark ? 0.2 : 0.16);
  ctx.strokeStyle = rgba(color, 0.85);
  ctx.lineWidth = 1.5;
  let top = add(p, [0, radius, 0]);
  if (obstacle.name === "sphere" || obstacle.name === "capsule") {
    const a = project(add(p, half)), b = project(sub(p, half));
    if (!a || !b) return;
    ctx.beginPath();
    capsulePath(ctx, a.x, a.y, radius * a.s, b.x, b.y, radius * b.s);
    ctx.fill();
    ctx.stroke();
    top = add(p, [0, Math.abs(half[1]) + radius, 0]);
  } else if (obstacle.name === "cylinder") {
    const ends = [sub(p, half), add(p, half)].map((end) => ringAt(end, radius));
    fillHull(ends.flat());
    for (const ring of ends) ring.forEach((q, i) => line(ctx, q, ring[(i + 1) % ring.length]));
    top = add(p, half);
  } else if (obstacle.name === "box") {
    const corners = [0, 1, 2, 3, 4, 5, 6, 7].map((c) => p.map((v, k) => v + (c & (1 << k) ? half[k] : -half[k])));
    fillHull(corners);
    for (const [i, j] of EDGES) line(ctx, corners[i], corners[j]);
    top = add(p, [0, half[1], 0]);
  } else {
    // Of a plane a patch, of a wall two metres above the floor, and which way is free.
    const n = norm(half), flat = Math.abs(n[1]) > 0.9, u = norm(cross(n, flat ? [1, 0, 0] : [0, 1, 0])), v = cross(n, u);
    const middle = flat ? p : add(p, v, (1 - p[1]) / v[1]), tall = flat ? 2 : 1 / Math.abs(v[1]);
    const at = (i, j) => add(add(middle, u, i), v, j * tall);
    fillHull([at(-2, -1), at(2, -1), at(2, 1), at(-2, 1)]);
    ctx.strokeStyle = rgba(color, 0.35);
    for (let k = -2; k <= 2; k++) { line(ctx, at(k, -1), at(k, 1)); line(ctx, at(-2, k / 2), at(2, k / 2)); }
    ctx.strokeStyle = rgba(color, 0.85);
    line(ctx, middle, add(middle, n, 0.4));
    top = middle;
  }
  // Its way, if it moves.
  if (obstacle.middles.length > 1) {
    ctx.setLineDash([3, 5]);
    ctx.strokeStyle = rgba(color, 0.5);
    for (let f = 0; f + 4 < obstacle.middles.length; f += 4) line(ctx, obstacle.middles[f], obstacle.middles[f + 4]);
    ctx.setLineDash([]);
  }
  const q = project(top);
  if (q && show.labels) tag(`obstacle ${number}`, q.x + 6, q.y - 12, color);
}

// Draws the obstacles that are behind the body, or those in front of it.
function drawObstacles(frame, behind) {
  const body = toCamera(jointAt(motions.after, frame, 0))[2];
  const far = (o) => toCamera(middleAt(o, frame))[2];
  const order = scene.obstacles.map((o, i) => [o, i, far(o)]).filter(([o, , z]) => (o.name === "plane" || z > body) === behind);
  for (const [o, i] of order.sort((a, b) => b[2] - a[2])) drawObstacle(o, i, frame);
}
