// The scene that the simulator wrote into this page: motions as base64 of little-endian f32 [frame][joint][xyz], metres.
const scene = JSON.parse(document.getElementById("scene").textContent);
const JOINTS = scene.joint_names.length;
const FRAMES = scene.frames;
const $ = (id) => document.getElementById(id);

function decodePositions(base64) {
  const bytes = atob(base64);
  const view = new DataView(new ArrayBuffer(bytes.length));
  for (let i = 0; i < bytes.length; i++) view.setUint8(i, bytes.charCodeAt(i));
  const out = new Float32Array(bytes.length / 4);
  for (let i = 0; i < out.length; i++) out[i] = view.getFloat32(4 * i, true);
  return out;
}

const motions = {};
for (const m of scene.motions) motions[m.id] = { id: m.id, name: m.name, label: m.label, positions: decodePositions(m.positions), stances: m.stances };

// Joint j of motion m at a frame that may lie between two (the view interpolates linearly between recorded frames).
function jointAt(m, frame, j) {
  const f0 = Math.max(0, Math.min(FRAMES - 1, Math.floor(frame)));
  const f1 = Math.min(FRAMES - 1, f0 + 1);
  const s = Math.max(0, Math.min(1, frame - f0));
  const a = 3 * (f0 * JOINTS + j), b = 3 * (f1 * JOINTS + j), p = m.positions;
  return [p[a] + s * (p[b] - p[a]), p[a + 1] + s * (p[b + 1] - p[a + 1]), p[a + 2] + s * (p[b + 2] - p[a + 2])];
}

function poseAt(m, frame) {
  const pose = [];
  for (let j = 0; j < JOINTS; j++) pose.push(jointAt(m, frame, j));
  return pose;
}

// Where an anchor wants its joint; a planar root anchor says nothing about height, so it stands on the floor.
const anchorPoint = (a) => (a.target.length === 2 ? [a.target[0], 0, a.target[1]] : a.target);

// The box that holds all shown motion, all anchors and whole tracks: { lo, hi }.
function bounds() {
  const lo = [Infinity, 0, Infinity], hi = [-Infinity, 1.8, -Infinity];
  const grow = (p) => { for (let k = 0; k < 3; k++) { lo[k] = Math.min(lo[k], p[k]); hi[k] = Math.max(hi[k], p[k]); } };
  for (const id in motions) for (let f = 0; f < FRAMES; f += 2) for (const j of [0, 7, 8, 15, 20, 21]) grow(jointAt(motions[id], f, j));
  for (const a of scene.anchors) grow(anchorPoint(a));
  for (const t of scene.tracks) for (const p of t.positions) if (p && t.axes.every((counts) => counts)) grow(p);
  return { lo, hi };
}
