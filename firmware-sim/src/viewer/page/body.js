// The body: tapered capsules around the 22-joint skeleton, shaded by their direction to the light, painted back to front.
// [parent joint, joint, radius there, radius here] in metres.
const LIMBS = [
  [0, 1, 0.1, 0.085], [0, 2, 0.1, 0.085], [1, 4, 0.085, 0.058], [2, 5, 0.085, 0.058], [4, 7, 0.056, 0.04], [5, 8, 0.056, 0.04],
  [7, 10, 0.042, 0.034], [8, 11, 0.042, 0.034], [0, 3, 0.118, 0.112], [3, 6, 0.112, 0.12], [6, 9, 0.12, 0.112], [9, 12, 0.085, 0.048],
  [12, 15, 0.046, 0.046], [9, 13, 0.09, 0.075], [9, 14, 0.09, 0.075], [13, 16, 0.07, 0.058], [14, 17, 0.07, 0.058],
  [16, 18, 0.054, 0.043], [17, 19, 0.054, 0.043], [18, 20, 0.042, 0.031], [19, 21, 0.042, 0.031],
];
const LIGHT = norm([-0.45, -0.9, 0]);

// Which way the chest looks: across the shoulders x up.
function facing(pose) {
  const across = sub(pose[16], pose[17]);
  const up = sub(pose[12], pose[0]);
  return norm(cross(across, up));
}

function capsules(pose) {
  const out = LIMBS.map(([i, j, ra, rb]) => ({ a: pose[i], b: pose[j], ra, rb, joint: j }));
  for (const [e, w] of [[18, 20], [19, 21]]) out.push({ a: pose[w], b: add(pose[w], norm(sub(pose[w], pose[e])), 0.09), ra: 0.031, rb: 0.026, joint: w });
  const front = facing(pose), up = norm(sub(pose[15], pose[12]));
  for (const f of [10, 11]) {
    const toe = norm(sub(pose[f], pose[f - 3]));
    out.push({ a: pose[f], b: add(pose[f], norm([toe[0], 0, toe[2]]), 0.06), ra: 0.034, rb: 0.028, joint: f });
  }
  const crown = add(add(pose[15], up, 0.1), front, 0.02);
  out.push({ a: add(pose[15], up, 0.045), b: crown, ra: 0.082, rb: 0.1, joint: 15 });
  // A visor, so that the direction of sight can be read at a glance.
  const right = norm(cross(up, front)), eye = add(add(crown, front, 0.066), up, -0.01);
  out.push({ a: add(eye, right, 0.042), b: add(eye, right, -0.042), ra: 0.034, rb: 0.034, visor: true });
  return out;
}

// Outline of two circles and their common tangents; always clockwise, so that several make one union in a nonzero fill.
function capsulePath(ctx, ax, ay, ra, bx, by, rb) {
  const d = Math.hypot(bx - ax, by - ay);
  if (d <= Math.abs(ra - rb) + 1e-3) {
    const [x, y, r] = ra > rb ? [ax, ay, ra] : [bx, by, rb];
    ctx.moveTo(x + r, y);
    ctx.arc(x, y, r, 0, 2 * Math.PI);
    return;
  }
  const along = Math.atan2(by - ay, bx - ax), open = Math.acos((ra - rb) / d);
  ctx.moveTo(bx + rb * Math.cos(along - open), by + rb * Math.sin(along - open));
  ctx.arc(bx, by, rb, along - open, along + open);
  ctx.arc(ax, ay, ra, along + open, along - open + 2 * Math.PI);
  ctx.closePath();
}

const mix = (a, b, t) => `rgb(${a.map((v, k) => Math.round(v + (b[k] - v) * t)).join(",")})`;

// `base` gives the colour of what ends in a joint.
function drawBody(ctx, pose, base, visor) {
  const shapes = [];
  for (const c of capsules(pose)) {
    const a = project(c.a), b = project(c.b);
    if (a && b) shapes.push({ c, a, b, z: (a.z + b.z) / 2 - (c.visor ? 0.1 * Math.sign((a.z + b.z) / 2 < project(pose[15]).z) : 0) });
  }
  shapes.sort((p, q) => q.z - p.z);
  for (const { c, a, b } of shapes) {
    const ra = c.ra * a.s, rb = c.rb * b.s, dx = b.x - a.x, dy = b.y - a.y, d = Math.hypot(dx, dy) || 1;
    let nx = -dy / d, ny = dx / d, k = nx * LIGHT[0] + ny * LIGHT[1];
    if (k < 0) { nx = -nx; ny = -ny; k = -k; }
    if (d < 0.6 * Math.max(ra, rb)) { nx = LIGHT[0]; ny = LIGHT[1]; k = 1; }
    const r = Math.max(ra, rb), mx = (a.x + b.x) / 2, my = (a.y + b.y) / 2;
    const tone = c.visor ? visor : base(c.joint);
    const g = ctx.createLinearGradient(mx + nx * r, my + ny * r, mx - nx * r, my - ny * r);
    g.addColorStop(0, mix(tone, [255, 255, 255], 0.12 + 0.38 * k));
    g.addColorStop(0.5, mix(tone, [255, 255, 255], 0.02));
    g.addColorStop(1, mix(tone, [8, 14, 24], 0.25 + 0.32 * k));
    ctx.beginPath();
    capsulePath(ctx, a.x, a.y, ra, b.x, b.y, rb);
    ctx.fillStyle = g;
    ctx.fill();
    ctx.lineWidth = 1;
    ctx.strokeStyle = mix(tone, [8, 14, 24], 0.45);
    ctx.globalAlpha *= 0.5;
    ctx.stroke();
    ctx.globalAlpha /= 0.5;
  }
}

// A soft contact shadow: the body's capsules dropped onto the floor, as one union.
function drawShadow(ctx, pose, alpha) {
  ctx.beginPath();
  for (const c of capsules(pose)) {
    const a = project([c.a[0], 0, c.a[2]]), b = project([c.b[0], 0, c.b[2]]);
    if (!a || !b) continue;
    capsulePath(ctx, a.x, a.y, c.ra * a.s * 0.8, b.x, b.y, c.rb * b.s * 0.8);
  }
  ctx.fillStyle = `rgba(0,0,0,${alpha})`;
  ctx.fill("nonzero");
}

// Bones as lines with joint dots: the reference, which lies within millimetres of the body.
function drawWire(ctx, pose, color) {
  ctx.strokeStyle = color;
  ctx.fillStyle = color;
  ctx.lineWidth = 2;
  ctx.lineCap = "round";
  for (let j = 1; j < JOINTS; j++) {
    const s = projectSegment(pose[j], pose[scene.parents[j]]);
    if (!s) continue;
    ctx.beginPath();
    ctx.moveTo(s[0], s[1]);
    ctx.lineTo(s[2], s[3]);
    ctx.stroke();
  }
  for (const p of pose) {
    const q = project(p);
    if (!q) continue;
    ctx.beginPath();
    ctx.arc(q.x, q.y, 3, 0, 2 * Math.PI);
    ctx.fill();
  }
}
