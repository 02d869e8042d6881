// Ties the page together: playback, timeline, pointer and keyboard, figures.
const player = { frame: 0, playing: false, speed: 1, follow: false, last: 0 };
let dirty = true;
// Mark the token, the interval, the servos' angles, the curves over time and the spans of a frame; set once there are any to show.
let markToken = null, markInterval = null, markServos = null, markFollowing = null, markTimeline = null;
// Layers by key 1, 2, ...; the motions among them are those that the scene has.
const LAYERS = ["after", "before", "alone", "robot", "reference", "trails", "labels", "scene", "timeline"];
const STAGES = ["alone", "before", "after"].filter((id) => motions[id]);
const ICONS = { play: "M3 1.5v13l11-6.5z", pause: "M3 2h4v12H3zM9 2h4v12H9z" };

function setPlaying(on) {
  player.playing = on;
  if (on && player.frame >= FRAMES - 1) player.frame = 0;
  $("play").innerHTML = `<svg viewBox="0 0 16 16" width="17" height="17" aria-hidden="true"><path d="${on ? ICONS.pause : ICONS.play}"/></svg>`;
  $("play").setAttribute("aria-label", on ? "Pause" : "Play");
  player.last = performance.now();
  dirty = true;
}

function seek(frame) {
  player.frame = Math.max(0, Math.min(FRAMES - 1, frame));
  dirty = true;
}

function syncControls() {
  const f = Math.round(player.frame), scrub = $("scrub");
  if (+scrub.value !== f) scrub.value = f;
  scrub.style.setProperty("--done", `${(100 * f) / Math.max(1, FRAMES - 1)}%`);
  scrub.setAttribute("aria-valuetext", `frame ${f}, ${(f / scene.fps).toFixed(2)} seconds`);
  $("clock").innerHTML = `<b>${(f / scene.fps).toFixed(2)} s</b>frame ${f} / ${FRAMES - 1}`;
  if (markToken) markToken(f);
  if (markInterval) markInterval(f);
  if (markServos) markServos(f);
  if (markFollowing) markFollowing(f);
  if (markTimeline) markTimeline(f);
  const lit = (i) => Math.abs(scene.anchors[i].frame - player.frame) < 1.5;
  document.querySelectorAll("#ticks button, #anchors tbody tr").forEach((e) => e.classList.toggle("now", lit(+e.dataset.anchor)));
}

function tick(now) {
  if (player.playing) {
    // A frame's time stamp may lie before the moment at which playing was switched on.
    const dt = Math.max(0, Math.min(0.1, (now - player.last) / 1000));
    player.frame += dt * scene.fps * player.speed;
    if (player.frame >= FRAMES - 1) player.frame = 0;
    dirty = true;
  }
  player.last = now;
  if (player.follow) {
    const root = jointAt(motions.after, player.frame, 0), k = 0.12;
    const move = [root[0] - camera.target[0], 0.9 - camera.target[1], root[2] - camera.target[2]];
    if (Math.hypot(...move) > 1e-3) { camera.target = add(camera.target, move, k); dirty = true; }
  }
  if (dirty) {
    dirty = false;
    paint(player.frame);
    syncControls();
  }
  requestAnimationFrame(tick);
}

function frameView() {
  const box = canvas.getBoundingClientRect();
  frameAll(box.width, box.height);
  dirty = true;
}

function setFollow(on) {
  player.follow = on;
  $("follow").setAttribute("aria-pressed", String(on));
  if (on) camera.distance = Math.min(camera.distance, 4.2);
  dirty = true;
}

function setTheme(name) {
  document.documentElement.dataset.theme = name;
  readPalette();
  dirty = true;
}

const COLORS = { after: "--accent", before: "--before", alone: "--alone", robot: "--robot", reference: "--reference" };
const SURROUNDINGS = ["tracks", "obstacles"].filter((kind) => scene[kind].length);
const hasLayer = (id) => !!motions[id] || id === "trails" || id === "labels" || (id === "scene" && SURROUNDINGS.length > 0) || (id === "timeline" && scene.timeline.length > 0);

function buildToggles() {
  const other = { trails: ["Trails", "--dim"], labels: ["Labels", "--target"], scene: [SURROUNDINGS.join(" and "), "--fault"], timeline: ["timeline", "--span"] };
  LAYERS.forEach((id, i) => {
    if (!hasLayer(id)) return;
    const [name, color] = other[id] || [motions[id].name, COLORS[id]];
    const b = document.createElement("button");
    b.innerHTML = `<i style="--swatch: var(${color})"></i>${name[0].toUpperCase()}${name.slice(1)}`;
    b.dataset.layer = id;
    b.title = `${motions[id] ? motions[id].label : name} (${i + 1})`;
    b.setAttribute("aria-pressed", String(show[id]));
    b.addEventListener("click", () => toggleLayer(id));
    $("toggles").appendChild(b);
  });
}

function toggleLayer(id) {
  if (!hasLayer(id)) return;
  show[id] = !show[id];
  document.querySelector(`[data-layer="${id}"]`).setAttribute("aria-pressed", String(show[id]));
  $("timeline").hidden = !show.timeline;
  dirty = true;
}

const cell = (row, text, name) => { const td = document.createElement("td"); td.textContent = text; if (name) td.className = name; row.appendChild(td); };

function buildAnchors() {
  const head = document.createElement("thead");
  const stages = STAGES.map((id) => `<th title="${motions[id].label}">${motions[id].name.toLowerCase()}</th>`);
  head.innerHTML = `<tr><th>#</th><th>what</th>${stages.join("")}</tr>`;
  const errors = { alone: "unconditioned_cm", before: "before_cm", after: "after_cm" };
  const body = document.createElement("tbody");
  scene.anchors.forEach((a, i) => {
    const row = document.createElement("tr");
    row.dataset.anchor = i;
    row.tabIndex = 0;
    row.title = `target ${a.target.map((v) => v.toFixed(2)).join(", ")} m; jump to frame ${a.frame}`;
    cell(row, String(i + 1), "key");
    cell(row, `${a.name} ${(a.frame / scene.fps).toFixed(2)} s`);
    for (const id of STAGES) cell(row, centimetres(a[errors[id]]), id);
    const go = () => { setPlaying(false); seek(a.frame); };
    row.addEventListener("click", go);
    row.addEventListener("keydown", (e) => { if (e.key === "Enter") go(); });
    body.appendChild(row);
    const mark = document.createElement("button");
    mark.textContent = String(i + 1);
    mark.dataset.anchor = i;
    mark.title = `${a.name} at ${(a.frame / scene.fps).toFixed(2)} s`;
    mark.setAttribute("aria-label", `Jump to anchor ${i + 1}, ${mark.title}`);
    mark.style.left = `${(100 * a.frame) / Math.max(1, FRAMES - 1)}%`;
    mark.addEventListener("click", go);
    $("ticks").appendChild(mark);
  });
  $("anchors").append(head, body);
}

function buildFigures() {
  document.title = `${scene.title}: motionette`;
  $("title").textContent = scene.title;
  $("caption").textContent = scene.caption;
  const piece = (text, name) => { const s = document.createElement("span"); s.className = name; s.textContent = text; $("headline").appendChild(s); };
  // Without anchors there is nothing to say about them.
  $("errorbox").hidden = $("anchorbox").hidden = scene.anchors.length === 0;
  const errors = { alone: scene.error_alone_cm, before: scene.error_before_cm, after: scene.error_after_cm };
  STAGES.forEach((id, i) => {
    if (i > 0) piece("→", "arrow");
    piece(centimetres(errors[id]), id);
    $("headline").lastChild.title = motions[id].label;
  });
  piece("cm, mean over anchors", "unit");
  $("note").hidden = !scene.note;
  $("note").textContent = scene.note || "";
  for (const fact of scene.facts) {
    const dt = document.createElement("dt"), dd = document.createElement("dd");
    dt.textContent = fact.label;
    dd.textContent = fact.value;
    $("facts").append(dt, dd);
  }
  drawChart($("chart"), scene.curve, scene.refinement);
  drawStages($("stages"), scene.stages);
  $("trackbox").hidden = scene.tracks.length === 0;
  $("clearancebox").hidden = !scene.clearance;
  if (SURROUNDINGS.length) markFollowing = drawFollowing();
  if (scene.timeline.length) markTimeline = drawTimeline($("timeline"), scene.timeline);
  drawFeet($("feet"), motions.after);
  if (scene.intervals.length) markInterval = drawIntervals($("intervals"), scene.intervals);
  $("robotname").textContent = scene.robot.name;
  markServos = drawServos($("servos"), scene.robot);
  $("planbox").hidden = !scene.plan;
  if (!scene.plan) return;
  for (const word of scene.plan.words) {
    const s = document.createElement("span");
    s.textContent = word.text;
    if (!word.known) { s.className = "unknown"; s.title = "this word is not in the model's vocabulary"; }
    $("prompt").append(s, " ");
  }
  markToken = drawTokens($("tokens"), scene.plan, scene.frames_per_token);
}

function jumpAnchor(direction) {
  const frames = [...new Set(scene.anchors.map((a) => a.frame))].sort((a, b) => a - b), here = Math.round(player.frame);
  const next = direction > 0 ? frames.find((f) => f > here) : frames.reverse().find((f) => f < here);
  if (next !== undefined) { setPlaying(false); seek(next); }
}

function listenToPointer() {
  const fingers = new Map();
  canvas.addEventListener("contextmenu", (e) => e.preventDefault());
  canvas.addEventListener("pointerdown", (e) => { canvas.setPointerCapture(e.pointerId); fingers.set(e.pointerId, [e.clientX, e.clientY]); });
  for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, (e) => fingers.delete(e.pointerId));
  canvas.addEventListener("pointermove", (e) => {
    const was = fingers.get(e.pointerId);
    if (!was) return;
    const dx = e.clientX - was[0], dy = e.clientY - was[1];
    if (fingers.size === 1) {
      if (e.shiftKey || e.buttons & 6) { if (player.follow) setFollow(false); pan(dx, dy); } else orbit(dx, dy);
    } else if (fingers.size === 2) {
      const other = [...fingers].find(([id]) => id !== e.pointerId)[1];
      const span = (p) => Math.hypot(p[0] - other[0], p[1] - other[1]) || 1;
      zoom(span(was) / span([e.clientX, e.clientY]));
      if (!player.follow) pan(dx / 2, dy / 2);
    }
    fingers.set(e.pointerId, [e.clientX, e.clientY]);
    dirty = true;
  });
  canvas.addEventListener("wheel", (e) => { e.preventDefault(); zoom(Math.exp(Math.max(-60, Math.min(60, e.deltaY)) * 0.0025)); dirty = true; }, { passive: false });
  canvas.addEventListener("dblclick", frameView);
}

function listenToKeys() {
  document.addEventListener("keydown", (e) => {
    if (e.ctrlKey || e.metaKey || e.altKey || e.target.tagName === "SELECT") return;
    const onScrub = e.target.id === "scrub", step = e.shiftKey ? 10 : 1;
    if (e.key === " " && e.target.tagName !== "BUTTON") setPlaying(!player.playing);
    else if (e.key === "ArrowLeft" && !onScrub) { setPlaying(false); seek(Math.round(player.frame) - step); }
    else if (e.key === "ArrowRight" && !onScrub) { setPlaying(false); seek(Math.round(player.frame) + step); }
    else if (e.key === "Home") seek(0);
    else if (e.key === "End") { setPlaying(false); seek(FRAMES - 1); }
    else if (e.key === "[") jumpAnchor(-1);
    else if (e.key === "]") jumpAnchor(1);
    else if (e.key === "+" || e.key === "=") { zoom(0.9); dirty = true; }
    else if (e.key === "-") { zoom(1 / 0.9); dirty = true; }
    else if (e.key === "f") setFollow(!player.follow);
    else if (e.key === "r") frameView();
    else if (e.key === "t") $("theme").click();
    else if (e.key === "?") $("help").click();
    else if (LAYERS[+e.key - 1]) toggleLayer(LAYERS[+e.key - 1]);
    else return;
    if (e.key === " " || e.key.startsWith("Arrow")) e.preventDefault();
  });
}

buildToggles();
buildAnchors();
buildFigures();
listenToPointer();
listenToKeys();
$("scrub").max = FRAMES - 1;
$("scrub").addEventListener("input", (e) => { setPlaying(false); seek(+e.target.value); });
$("play").addEventListener("click", () => setPlaying(!player.playing));
$("speed").addEventListener("change", (e) => { player.speed = +e.target.value; });
$("follow").addEventListener("click", () => setFollow(!player.follow));
$("reset").addEventListener("click", () => { setFollow(false); frameView(); });
$("help").addEventListener("click", () => $("helpbox").showModal());
$("theme").addEventListener("click", () => setTheme(document.documentElement.dataset.theme === "light" ? "dark" : "light"));
setTheme(matchMedia("(prefers-color-scheme: light)").matches ? "light" : "dark");
// At once: until the next frame the browser would stretch what was painted for another size.
new ResizeObserver(() => paint(player.frame)).observe(canvas);
frameView();
// viewer.html#frame=60 opens still, at that frame.
const wanted = /frame=(\d+)/.exec(location.hash);
if (wanted) seek(+wanted[1]);
setPlaying(!wanted && !matchMedia("(prefers-reduced-motion: reduce)").matches);
requestAnimationFrame(tick);
// For automated checks of this page.
window.motionette = { state: () => ({ frame: player.frame, frames: FRAMES, playing: player.playing, layers: { ...show }, camera: { yaw: camera.yaw, pitch: camera.pitch, distance: camera.distance } }), seek, play: setPlaying };
