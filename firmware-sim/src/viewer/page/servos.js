// The servos: a strip a channel with its range, what was commanded and what was reached over the whole run, faults behind them.
const FAULT_NAMES = { nack: "no acknowledgement", stuck: "bus held", late: "late replies", bit: "bit errors", brownout: "power lost" };

// Draws the strips into host; returns what moves the play head to a frame of the motion.
function drawServos(host, robot) {
  const W = 312, H = 34, left = 0, seconds = robot.servos[0].commanded.length / robot.tick_rate;
  const x = (t) => left + ((W - left) * t) / seconds;
  const strips = robot.servos.map((servo, index) => {
    const box = document.createElement("div");
    box.className = "servo";
    const label = document.createElement("div");
    label.className = "name";
    label.innerHTML = `<span></span><b></b>`;
    label.firstChild.textContent = servo.name;
    label.title = servo.bus;
    box.append(label);
    const svg = element(box, "svg", { viewBox: `0 0 ${W} ${H}`, preserveAspectRatio: "none", role: "slider", tabindex: index === 0 ? 0 : -1, "aria-label": `${servo.name}, degrees; left and right move in time, up and down from servo to servo`, "aria-valuemin": 0, "aria-valuemax": FRAMES - 1 });
    const [low, high] = servo.range, pad = 3;
    const y = (angle) => pad + ((H - 2 * pad) * (high - angle)) / (high - low);
    for (const [name, from, until] of robot.faults) {
      const rect = element(svg, "rect", { class: "fault", x: x(from), width: Math.max(1.5, x(until) - x(from)), y: 0, height: H });
      element(rect, "title", {}, `${FAULT_NAMES[name] || name}, ${from.toFixed(2)} to ${until.toFixed(2)} s`);
    }
    for (const limit of [low, high]) element(svg, "line", { class: "limit", x1: left, x2: W, y1: y(limit), y2: y(limit) });
    const line = (values, name) => element(svg, "polyline", { class: name, points: values.map((v, k) => `${x(k / robot.tick_rate).toFixed(1)},${y(v).toFixed(1)}`).join(" ") });
    line(servo.reached, "reached");
    line(servo.commanded, "commanded");
    const head = element(svg, "line", { class: "head", y1: 0, y2: H });
    svg.addEventListener("pointerdown", (e) => {
      const at = svg.getBoundingClientRect(), time = ((e.clientX - at.left) / at.width) * seconds;
      setPlaying(false);
      seek((time - robot.began) * scene.fps);
    });
    host.append(box);
    return { servo, svg, head, read: label.lastChild };
  });
  // One stop of the tab key for all strips: the strip that was visited last.
  const visit = (index) => strips[Math.max(0, Math.min(strips.length - 1, index))].svg.focus();
  const still = (frame) => { setPlaying(false); seek(frame); };
  strips.forEach(({ svg }, index) => {
    svg.addEventListener("focus", () => strips.forEach((strip, k) => strip.svg.setAttribute("tabindex", k === index ? 0 : -1)));
    onArrows(svg, (by) => still(Math.round(player.frame) + by), (by) => visit(index + by), (end) => still(end * (FRAMES - 1)));
  });
  return (frame) => {
    const time = robot.began + frame / scene.fps, tick = Math.min(robot.servos[0].commanded.length - 1, Math.round(time * robot.tick_rate));
    const state = robot.states.filter(([from]) => from <= time + 1e-6).pop();
    $("robotstate").textContent = state ? state[1] : "";
    $("robotstate").classList.toggle("down", !!state && state[1] === "bus down");
    for (const { servo, svg, head, read } of strips) {
      for (const k of ["x1", "x2"]) head.setAttribute(k, x(time));
      read.textContent = `${servo.commanded[tick].toFixed(0)}° → ${servo.reached[tick].toFixed(0)}°`;
      svg.setAttribute("aria-valuenow", frame);
      svg.setAttribute("aria-valuetext", `${time.toFixed(2)} s: ${servo.commanded[tick].toFixed(0)} degrees commanded, ${servo.reached[tick].toFixed(0)} reached`);
    }
  };
}
