// What parts of the body do instead: a bar a span below the time axis, one row a part; the joints that spans move at a frame.
const lasts = (span, frame) => frame >= span.first && frame < span.first + span.frames;

const toldJoints = (frame) => new Set(scene.timeline.filter((span) => lasts(span, frame)).flatMap((span) => span.joints));

// Returns what marks the bars of a frame.
function drawTimeline(host, spans) {
  const last = Math.max(1, FRAMES - 1), seconds = (frame) => (frame / scene.fps).toFixed(2), bars = [];
  for (const part of new Set(spans.flatMap((span) => span.parts))) {
    const row = document.createElement("div");
    for (const span of spans.filter((span) => span.parts.includes(part))) {
      const bar = document.createElement("button"), end = span.first + span.frames;
      bar.style.left = `${(100 * span.first) / last}%`;
      bar.style.width = `${(100 * (span.frames - 1)) / last}%`;
      bar.textContent = `${part}: ${span.says}`;
      const understood = span.understood ? `; understood as: ${span.understood}` : "";
      const unknown = span.unknown_words.length ? `; words the vocabulary does not have: ${span.unknown_words.join(", ")}` : "";
      bar.title = `${part}, ${seconds(span.first)} to ${seconds(end)} s: ${span.says}${understood}${unknown}`;
      bar.setAttribute("aria-label", `Jump to the span of the ${bar.title}`);
      bar.addEventListener("click", () => { setPlaying(false); seek(span.first); });
      bars.push([bar, span]);
      row.append(bar);
    }
    host.append(row);
  }
  return (frame) => bars.forEach(([bar, span]) => bar.classList.toggle("now", lasts(span, frame)));
}
