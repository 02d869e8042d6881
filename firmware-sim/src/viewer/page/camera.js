// An orbit camera. World: y up, metres. The eye stands at target + distance * (sin yaw cos pitch, sin pitch, cos yaw cos pitch).
const NEAR = 0.08;
const camera = { yaw: 0.72, pitch: 0.2, distance: 5, target: [0, 0.9, 0], focal: 1, cx: 0, cy: 0, right: [1, 0, 0], up: [0, 1, 0], forward: [0, 0, -1], eye: [0, 0, 0] };
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const sub = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
const add = (a, b, s = 1) => [a[0] + s * b[0], a[1] + s * b[1], a[2] + s * b[2]];
const norm = (a) => { const n = Math.hypot(a[0], a[1], a[2]) || 1; return [a[0] / n, a[1] / n, a[2] / n]; };
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];

function updateCamera(width, height) {
  const c = camera, sy = Math.sin(c.yaw), cy = Math.cos(c.yaw), sp = Math.sin(c.pitch), cp = Math.cos(c.pitch);
  c.right = [cy, 0, -sy];
  c.up = [-sy * sp, cp, -cy * sp];
  c.forward = [-sy * cp, -sp, -cy * cp];
  c.eye = add(c.target, c.forward, -c.distance);
  c.focal = 1.35 * Math.min(height, width * 1.15);
  c.cx = width / 2;
  c.cy = height / 2;
}

// World point -> camera coordinates [right, up, depth].
function toCamera(p) {
  const d = sub(p, camera.eye);
  return [dot(d, camera.right), dot(d, camera.up), dot(d, camera.forward)];
}

// World point -> { x, y: pixels; z: depth in metres; s: pixels a metre there }, or null behind the eye.
function project(p) {
  const q = toCamera(p);
  if (q[2] < NEAR) return null;
  const s = camera.focal / q[2];
  return { x: camera.cx + q[0] * s, y: camera.cy - q[1] * s, z: q[2], s };
}

// A world segment clipped at the near plane -> [x0, y0, x1, y1], or null.
function projectSegment(a, b) {
  let p = toCamera(a), q = toCamera(b);
  if (p[2] < NEAR && q[2] < NEAR) return null;
  if (p[2] < NEAR || q[2] < NEAR) {
    if (p[2] > q[2]) [p, q] = [q, p];
    const t = (NEAR - p[2]) / (q[2] - p[2]);
    p = [p[0] + t * (q[0] - p[0]), p[1] + t * (q[1] - p[1]), NEAR];
  }
  const f = camera.focal;
  return [camera.cx + (p[0] * f) / p[2], camera.cy - (p[1] * f) / p[2], camera.cx + (q[0] * f) / q[2], camera.cy - (q[1] * f) / q[2]];
}

// Chooses target and distance so that the whole motion and its anchors are in view.
function frameAll(width, height) {
  const { lo, hi } = bounds();
  camera.yaw = 0.72;
  camera.pitch = 0.2;
  camera.target = [(lo[0] + hi[0]) / 2, 0.5 * (lo[1] + hi[1]), (lo[2] + hi[2]) / 2];
  const corners = [];
  for (let i = 0; i < 8; i++) corners.push([i & 1 ? hi[0] : lo[0], i & 2 ? hi[1] : lo[1], i & 4 ? hi[2] : lo[2]]);
  for (camera.distance = 2.4; camera.distance < 60; camera.distance *= 1.04) {
    updateCamera(width, height);
    const fits = corners.every((p) => {
      const q = project(p);
      return q && q.x > 0.06 * width && q.x < 0.94 * width && q.y > 0.12 * height && q.y < 0.92 * height;
    });
    if (fits) break;
  }
  updateCamera(width, height);
}

function orbit(dx, dy) {
  camera.yaw -= dx * 0.008;
  camera.pitch = Math.max(-0.05, Math.min(1.5, camera.pitch + dy * 0.006));
}

function pan(dx, dy) {
  const metres = camera.distance / camera.focal;
  camera.target = add(add(camera.target, camera.right, -dx * metres), camera.up, dy * metres);
}

function zoom(factor) {
  camera.distance = Math.max(0.7, Math.min(60, camera.distance * factor));
}
