export function pressed(place, choose) {
  // Calls `choose` with the trace under a press that does not turn the part; of the page and of check --plot.
  // (plotly_click comes only if a frame falls into the press.)
  const still = 5; // px: a press that moves farther turns the part
  const frame = 100; // ms: after a touch plotly has found the trace by then
  let over = null, from = null;
  place.on("plotly_hover", ({ points }) => { over = points[0].data; });
  place.on("plotly_unhover", () => { over = null; });
  place.addEventListener("pointerdown", ({ clientX, clientY }) => { from = [clientX, clientY]; }, true);
  place.addEventListener("click", ({ clientX, clientY }) => {
    if (from && Math.hypot(clientX - from[0], clientY - from[1]) < still) setTimeout(() => { if (over) choose(over); }, frame);
  }, true);
}
