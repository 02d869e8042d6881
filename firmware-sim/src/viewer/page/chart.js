// The control error over decoder evaluations, as an inline SVG with a logarithmic error axis and a read-out on hover.
const SVG = "http://www.w3.org/2000/svg";

function element(parent, name, attributes, text) {
  const e = document.createElementNS(SVG, name);
  for (const k in attributes) e.setAttribute(k, attributes[k]);
  if (text !== undefined) e.textContent = text;
  parent.appendChild(e);
  return e;
}

// Has a focused chart move on arrow keys: along by columns, across by rows (if it has any), to its start (0) or end (1). The page's own keys
// rest meanwhile.
function onArrows(chart, along, across, end) {
  const keys = { ArrowLeft: () => along(-1), ArrowRight: () => along(1), Home: () => end(0), End: () => end(1) };
  if (across) Object.assign(keys, { ArrowUp: () => across(-1), ArrowDown: () => across(1) });
  chart.addEventListener("keydown", (e) => {
    if (!keys[e.key] || e.ctrlKey || e.metaKey || e.altKey) return;
    keys[e.key]();
    e.preventDefault();
    e.stopPropagation();
  });
}

const centimetres = (v) => (v >= 10 ? v.toFixed(1) : v >= 1 ? v.toFixed(2) : v.toFixed(3));

function drawChart(host, curve, refinement) {
  host.replaceChildren();
  if (curve.length < 2) {
    const note = document.createElement("p");
    note.textContent = refinement
      ? `Refinement ${refinement}: the joints were edited behind the decoder.`
      : "Refinement was off: the motion is decoded as it is.";
    note.style.color = "var(--dim)";
    host.appendChild(note);
    return;
  }
  const W = 312, H = 172, left = 40, right = 6, top = 10, bottom = 34;
  const svg = element(host, "svg", { viewBox: `0 0 ${W} ${H}`, role: "slider", tabindex: 0, "aria-label": "Control error in centimetres over decoder evaluations", "aria-valuemin": curve[0].evaluations, "aria-valuemax": curve[curve.length - 1].evaluations });
  const last = curve[curve.length - 1].evaluations || 1;
  const floor = 1e-3;
  const values = curve.map((c) => Math.max(floor, c.error_cm));
  const lo = Math.floor(Math.log10(Math.min(...values)) - 1e-9), hi = Math.max(lo + 1, Math.ceil(Math.log10(Math.max(...values)) + 1e-9));
  const x = (n) => left + ((W - left - right) * n) / last;
  const y = (v) => top + ((H - top - bottom) * (hi - Math.log10(Math.max(floor, v)))) / (hi - lo);
  for (let d = lo; d <= hi; d++) {
    element(svg, "line", { class: "grid", x1: left, x2: W - right, y1: y(10 ** d), y2: y(10 ** d) });
    element(svg, "text", { x: left - 7, y: y(10 ** d) + 4, "text-anchor": "end" }, String(+(10 ** d).toPrecision(1)));
  }
  element(svg, "text", { x: left - 7, y: y(10 ** hi) + 16, "text-anchor": "end" }, "cm");
  const step = Math.max(1, Math.ceil(last / 5 / 5) * 5);
  for (let n = 0; n <= last; n += step) element(svg, "text", { x: x(n), y: H - bottom + 16, "text-anchor": "middle" }, String(n));
  element(svg, "text", { x: (left + W - right) / 2, y: H - 3, "text-anchor": "middle" }, "decoder evaluations");
  const points = curve.map((c, i) => `${x(c.evaluations).toFixed(1)},${y(values[i]).toFixed(1)}`);
  element(svg, "polygon", { class: "fill", points: `${points.join(" ")} ${x(last)},${H - bottom} ${x(curve[0].evaluations)},${H - bottom}` });
  element(svg, "polyline", { class: "curve", points: points.join(" ") });
  if (curve.length <= 60) curve.forEach((c, i) => element(svg, "circle", { class: "dot", cx: x(c.evaluations), cy: y(values[i]), r: 2.2 }));
  const hair = element(svg, "line", { class: "hair", y1: top, y2: H - bottom, visibility: "hidden" });
  const read = element(svg, "text", { class: "read", y: top + 12, visibility: "hidden" });
  let at = curve.length - 1;
  const tell = (index) => {
    at = Math.max(0, Math.min(curve.length - 1, index));
    const c = curve[at];
    svg.setAttribute("aria-valuenow", c.evaluations);
    svg.setAttribute("aria-valuetext", `${c.evaluations} evaluations: ${centimetres(c.error_cm)} cm`);
    return c;
  };
  const point = (index) => {
    const c = tell(index), px = x(c.evaluations), flip = px > W / 2;
    for (const k of ["x1", "x2"]) hair.setAttribute(k, px);
    read.setAttribute("x", px + (flip ? -6 : 6));
    read.setAttribute("text-anchor", flip ? "end" : "start");
    read.textContent = `${c.evaluations}: ${centimetres(c.error_cm)} cm`;
    for (const s of [hair, read]) s.setAttribute("visibility", "visible");
  };
  svg.addEventListener("pointermove", (e) => {
    const box = svg.getBoundingClientRect(), n = (((e.clientX - box.left) / box.width) * W - left) / (W - left - right) * last;
    point(curve.reduce((best, p, i) => (Math.abs(p.evaluations - n) < Math.abs(curve[best].evaluations - n) ? i : best), 0));
  });
  const hide = () => { for (const s of [hair, read]) s.setAttribute("visibility", "hidden"); };
  svg.addEventListener("pointerleave", hide);
  svg.addEventListener("focus", () => point(at));
  svg.addEventListener("blur", hide);
  onArrows(svg, (along) => point(at + along), null, (end) => point(end * (curve.length - 1)));
  tell(at);
}
