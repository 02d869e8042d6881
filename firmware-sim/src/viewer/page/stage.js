// Paints one moment: floor grid, trails, shadows, ghosts, obstacles, body, reference, tracks, anchors, labels.
const canvas = $("view");
const ctx = canvas.getContext("2d");
const layer = document.createElement("canvas");
const layerCtx = layer.getContext("2d");
const show = { after: true, before: true, alone: false, robot: true, reference: false, trails: true, labels: true, scene: true, timeline: true };
// Motions painted as ghosts behind the body, the farthest from the result first.
const GHOSTS = ["alone", "before"].filter((id) => motions[id]);
let palette = {};

const parseColor = (text) => {
  const hex = text.trim().replace("#", "");
  return [0, 2, 4].map((i) => parseInt(hex.slice(i, i + 2), 16));
};
const rgba = (c, a) => `rgba(${c[0]},${c[1]},${c[2]},${a})`;

function readPalette() {
  const style = getComputedStyle(document.documentElement);
  for (const name of ["bg", "bg2", "line", "text", "dim", "accent", "target", "before", "alone", "robot", "reference", "fault", "span", "panel"]) palette[name] = parseColor(style.getPropertyValue(`--${name}`));
  palette.dark = palette.bg[0] < 128;
}

function sizeCanvas() {
  const ratio = Math.min(2, window.devicePixelRatio || 1), box = canvas.getBoundingClientRect();
  const w = Math.max(1, Math.round(box.width * ratio)), h = Math.max(1, Math.round(box.height * ratio));
  for (const c of [canvas, layer]) if (c.width !== w || c.height !== h) { c.width = w; c.height = h; }
  ctx.setTransform(ratio, 0, 0, ratio, 0, 0);
  layerCtx.setTransform(ratio, 0, 0, ratio, 0, 0);
  return [box.width, box.height];
}

function line(context, a, b) {
  const s = projectSegment(a, b);
  if (!s) return;
  context.beginPath();
  context.moveTo(s[0], s[1]);
  context.lineTo(s[2], s[3]);
  context.stroke();
}

// Lines every half metre that fade with distance from the middle of the view; whole metres are stronger.
function drawGrid() {
  const middle = [Math.round(camera.target[0]), 0, Math.round(camera.target[2])];
  const reach = Math.min(24, Math.max(6, Math.ceil(camera.distance * 1.6)));
  const step = reach > 12 ? 1 : 0.5;
  ctx.lineWidth = 1;
  for (let k = -reach; k <= reach; k += step) {
    const whole = Math.abs(k - Math.round(k)) < 1e-6;
    for (let seg = -reach; seg < reach; seg += 1) {
      const fade = 1 - Math.hypot(k, seg + 0.5) / reach;
      if (fade <= 0) continue;
      ctx.strokeStyle = rgba(palette.dim, (whole ? 0.34 : 0.13) * fade);
      line(ctx, [middle[0] + k, 0, middle[2] + seg], [middle[0] + k, 0, middle[2] + seg + 1]);
      line(ctx, [middle[0] + seg, 0, middle[2] + k], [middle[0] + seg + 1, 0, middle[2] + k]);
    }
  }
  // The origin: where the motion starts, facing +z.
  ctx.strokeStyle = rgba(palette.dim, 0.9);
  ctx.lineWidth = 1.5;
  line(ctx, [0, 0, 0], [0, 0, 0.36]);
  line(ctx, [0, 0, 0.36], [0.07, 0, 0.27]);
  line(ctx, [0, 0, 0.36], [-0.07, 0, 0.27]);
  floorRing([0, 0, 0], 0.08);
  ctx.stroke();
}

// Adds a horizontal circle to the current path.
function floorRing(p, radius) {
  ctx.beginPath();
  let first = true;
  for (let i = 0; i <= 40; i++) {
    const t = (i / 40) * 2 * Math.PI, q = project([p[0] + radius * Math.cos(t), p[1], p[2] + radius * Math.sin(t)]);
    if (!q) continue;
    if (first) ctx.moveTo(q.x, q.y); else ctx.lineTo(q.x, q.y);
    first = false;
  }
}

// The path of one joint over the whole motion; floor: dropped to y = 0. What lies ahead of the playhead is fainter.
function drawTrail(m, joint, floor, color, frame, width) {
  const point = (f) => { const p = jointAt(m, f, joint); return floor ? [p[0], 0.003, p[2]] : p; };
  ctx.lineWidth = width;
  ctx.lineCap = "round";
  for (const [from, to, alpha] of [[0, Math.floor(frame), 0.95], [Math.floor(frame), FRAMES - 1, 0.32]]) {
    ctx.strokeStyle = rgba(color, alpha);
    ctx.beginPath();
    let pen = false;
    for (let f = from; f <= to; f++) {
      const q = project(point(f));
      if (!q) { pen = false; continue; }
      if (pen) ctx.lineTo(q.x, q.y); else ctx.moveTo(q.x, q.y);
      pen = true;
    }
    ctx.stroke();
  }
  if (!floor) return;
  ctx.fillStyle = rgba(color, 0.8);
  for (let f = 0; f < FRAMES; f += scene.fps) {
    const q = project(point(f));
    if (!q) continue;
    ctx.beginPath();
    ctx.arc(q.x, q.y, 2.4, 0, 2 * Math.PI);
    ctx.fill();
  }
}

// Where each foot of a motion stands: a faint print for every stance, a bright one under a foot that stands now.
function drawPrints(m, frame, color) {
  TOES.forEach((toe, foot) => {
    for (const [from, to] of m.stances[foot]) {
      const [x, , z] = jointAt(m, (from + to - 1) / 2, toe), now = frame >= from && frame < to;
      floorRing([x, 0.003, z], now ? 0.09 : 0.07);
      ctx.lineWidth = now ? 2.5 : 1;
      ctx.strokeStyle = rgba(color, now ? 0.95 : 0.4);
      ctx.stroke();
    }
  });
}

// 1 at the anchor's frame, falling to 0 within half a second: anchors light up as the motion meets them.
const nearness = (a, frame) => Math.max(0, 1 - Math.abs(frame - a.frame) / (0.5 * scene.fps));

function drawAnchor(a, frame) {
  const p = anchorPoint(a), q = project(p), near = nearness(a, frame), color = palette.target;
  if (!q) return;
  const planar = a.target.length === 2;
  ctx.strokeStyle = rgba(color, 0.35 + 0.4 * near);
  ctx.lineWidth = 1.25;
  if (planar) line(ctx, [p[0], 0, p[2]], [p[0], 1.0, p[2]]);
  else line(ctx, [p[0], 0, p[2]], p);
  ctx.strokeStyle = rgba(color, 0.8);
  floorRing([p[0], 0, p[2]], planar ? 0.12 : 0.05);
  ctx.lineWidth = planar ? 2 : 1.25;
  ctx.stroke();
  if (planar) { ctx.fillStyle = rgba(color, 0.15 + 0.4 * near); ctx.fill(); return; }
  const r = Math.max(4, 0.045 * q.s);
  ctx.beginPath();
  ctx.arc(q.x, q.y, r, 0, 2 * Math.PI);
  ctx.fillStyle = rgba(color, 0.22 + 0.6 * near);
  ctx.fill();
  ctx.lineWidth = 2;
  ctx.strokeStyle = rgba(color, 1);
  ctx.stroke();
  ctx.beginPath();
  for (const [dx, dy] of [[1, 0], [-1, 0], [0, 1], [0, -1]]) {
    ctx.moveTo(q.x + dx * r * 0.55, q.y + dy * r * 0.55);
    ctx.lineTo(q.x + dx * r * 1.6, q.y + dy * r * 1.6);
  }
  ctx.lineWidth = 1.25;
  ctx.stroke();
  if (near > 0 && show.after) {
    const joint = jointAt(motions.after, frame, a.joint);
    ctx.setLineDash([4, 4]);
    ctx.strokeStyle = rgba(color, near);
    line(ctx, joint, p);
    ctx.setLineDash([]);
  }
}

function backdrop(width, height) {
  const g = ctx.createRadialGradient(width / 2, height * 0.42, 0, width / 2, height * 0.42, 0.75 * Math.max(width, height));
  g.addColorStop(0, rgba(palette.bg2, 1));
  g.addColorStop(1, rgba(palette.bg, 1));
  ctx.fillStyle = g;
  ctx.fillRect(0, 0, width, height);
}

const VISOR = [28, 36, 48];

function paint(frame) {
  const [width, height] = sizeCanvas();
  updateCamera(width, height);
  backdrop(width, height);
  drawGrid();
  const pose = {};
  for (const id in motions) pose[id] = poseAt(motions[id], frame);
  const joints = [...new Set(scene.anchors.filter((a) => a.target.length === 3).map((a) => a.joint))];
  if (show.trails) {
    for (const id of GHOSTS) if (show[id]) drawTrail(motions[id], 0, true, palette[id], frame, 2);
    if (show.after) {
      drawTrail(motions.after, 0, true, palette.accent, frame, 2.5);
      drawPrints(motions.after, frame, palette.accent);
    }
  }
  for (const id of GHOSTS) if (show[id]) drawShadow(ctx, pose[id], palette.dark ? 0.18 : 0.06);
  if (show.after) drawShadow(ctx, pose.after, palette.dark ? 0.42 : 0.16);
  for (const id of GHOSTS) if (show[id]) {
    // Painted opaque on its own layer, so that overlapping limbs of the ghost do not add up.
    layerCtx.clearRect(0, 0, width, height);
    drawBody(layerCtx, pose[id], () => palette[id], VISOR);
    ctx.globalAlpha = palette.dark ? 0.36 : 0.3;
    ctx.drawImage(layer, 0, 0, width, height);
    ctx.globalAlpha = 1;
  }
  if (show.scene) drawObstacles(frame, true);
  // What a span of the timeline moves has its colour as long as it does.
  const told = show.timeline ? toldJoints(frame) : new Set();
  if (show.after) drawBody(ctx, pose.after, (joint) => (told.has(joint) ? palette.span : palette.accent), VISOR);
  if (show.scene) drawObstacles(frame, false);
  if (show.trails) for (const j of joints) if (j !== 0) {
    for (const id of GHOSTS) if (show[id]) drawTrail(motions[id], j, false, palette[id], frame, 1);
    if (show.after) drawTrail(motions.after, j, false, palette.accent, frame, 1.25);
  }
  if (show.robot && pose.robot) drawWire(ctx, pose.robot, rgba(palette.robot, 0.9));
  if (show.reference && pose.reference) drawWire(ctx, pose.reference, rgba(palette.reference, 1));
  if (show.scene) scene.tracks.forEach((track, i) => drawTrack(track, i, frame));
  for (const a of scene.anchors) drawAnchor(a, frame);
  if (show.labels) drawLabels(frame, width, height, pose);
}
