// The anchors' labels. Each stands beside its anchor where it covers neither a body nor another label nor a control, as near as can be, and
// stays where it is as long as that is no worse.
// Directions in degrees, the best first, at distances in pixels.
const SPOTS = [34, 62, 96, 136, 182, 234, 292].flatMap((far) => [90, 60, 120, 30, 150, 0, 180, -30, -150, -60, -120, -90].map((turn) => {
  const t = (turn * Math.PI) / 180;
  return { far, x: Math.cos(t), y: -Math.sin(t) };
}));
// What is worse by how much, in pixels of distance.
const COST = { body: 900, ghost: 60, anchor: 300, label: 2000, control: 2000, moved: 14 };
const stood = new Map();

// The outlines of a body as circles on the screen.
function circles(pose) {
  const out = [];
  for (const c of capsules(pose)) for (const t of [0, 1 / 3, 2 / 3, 1]) {
    const q = project(add(c.a, sub(c.b, c.a), t));
    if (q) out.push({ x: q.x, y: q.y, r: (c.ra + t * (c.rb - c.ra)) * q.s + 3 });
  }
  return out;
}

const overRect = (a, b) => a.x < b.x + b.w + 3 && b.x < a.x + a.w + 3 && a.y < b.y + b.h + 3 && b.y < a.y + a.h + 3;
function overCircle(box, c) {
  const dx = c.x - Math.max(box.x, Math.min(box.x + box.w, c.x)), dy = c.y - Math.max(box.y, Math.min(box.y + box.h, c.y));
  return dx * dx + dy * dy < c.r * c.r;
}

// Buttons and the clock on top of the view.
function controls() {
  const view = canvas.getBoundingClientRect();
  return [...document.querySelectorAll("#toggles button, .viewtools button, #clock")].map((e) => {
    const box = e.getBoundingClientRect();
    return { x: box.left - view.left, y: box.top - view.top, w: box.width, h: box.height };
  });
}

// The box of w x h for the label of anchor i, which is at q.
function place(i, q, w, h, width, height, taken) {
  let best = null;
  SPOTS.forEach((spot, k) => {
    // A label to the side begins there.
    const x = q.x + spot.x * (spot.far + w / 2) - w / 2, y = q.y + spot.y * spot.far - h / 2;
    const box = { x: Math.max(4, Math.min(width - w - 4, x)), y: Math.max(4, Math.min(height - h - 4, y)), w, h };
    let cost = spot.far + 0.02 * k + (stood.get(i) === k ? -COST.moved : 0);
    for (const kind of ["label", "control"]) for (const other of taken[kind]) if (overRect(box, other)) cost += COST[kind];
    for (const kind of ["body", "anchor", "ghost"]) {
      for (const c of taken[kind]) {
        if (best && cost >= best.cost) return;
        if (overCircle(box, c)) cost += COST[kind];
      }
    }
    if (!best || cost < best.cost) best = { box, cost, k };
  });
  stood.set(i, best.k);
  return best.box;
}

function drawLabels(frame, width, height, pose) {
  const bodies = (ids) => ids.filter((id) => show[id] && pose[id]).flatMap((id) => circles(pose[id]));
  const taken = { label: [], control: controls(), body: bodies(["after", "robot", "reference"]), ghost: bodies(GHOSTS) };
  ctx.font = "600 12px system-ui, -apple-system, 'Segoe UI', Roboto, 'DejaVu Sans', sans-serif";
  ctx.textBaseline = "middle";
  const order = scene.anchors.map((a, i) => ({ a, i, q: project(a.target.length === 2 ? [a.target[0], 1.0, a.target[1]] : a.target) })).filter((l) => l.q);
  order.sort((l, m) => m.q.y - l.q.y);
  taken.anchor = order.map(({ q }) => ({ x: q.x, y: q.y, r: 12 }));
  for (const { a, i, q } of order) {
    const near = nearness(a, frame) > 0, text = `${i + 1}  ${a.name} · ${(a.frame / scene.fps).toFixed(2)} s`, h = 20;
    const box = place(i, q, ctx.measureText(text).width + 14, h, width, height, taken);
    taken.label.push(box);
    const end = [Math.max(box.x, Math.min(box.x + box.w, q.x)), Math.max(box.y, Math.min(box.y + h, q.y))];
    ctx.strokeStyle = rgba(palette.target, 0.6);
    ctx.lineWidth = 1;
    ctx.beginPath();
    ctx.moveTo(q.x, q.y);
    ctx.lineTo(end[0], end[1]);
    ctx.stroke();
    ctx.beginPath();
    ctx.roundRect(box.x, box.y, box.w, h, 6);
    ctx.fillStyle = rgba(near ? palette.target : palette.panel, near ? 1 : 0.92);
    ctx.fill();
    ctx.strokeStyle = rgba(palette.target, 1);
    ctx.stroke();
    ctx.fillStyle = rgba(near ? (palette.dark ? palette.bg : palette.bg2) : palette.text, 1);
    ctx.fillText(text, box.x + 7, box.y + h / 2 + 0.5);
  }
}
