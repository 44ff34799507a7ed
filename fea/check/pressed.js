export function pressed(place, choose) {
  // Calls `choose` with the trace of a 3-D figure that is pressed; used by the page and by check --plot.
  // The event plotly_click is not enough: it comes only if a frame is drawn during the press.
  const maxMove = 5; // px: a press that moves farther turns the part
  const hoverDelay = 100; // ms: after a touch Plotly has found the trace by then
  let hovered = null, start = null;
  place.on("plotly_hover", ({ points }) => { hovered = points[0].data; });
  place.on("plotly_unhover", () => { hovered = null; });
  place.addEventListener("pointerdown", ({ clientX, clientY }) => { start = [clientX, clientY]; }, true);
  place.addEventListener("click", ({ clientX, clientY }) => {
    const isStill = start && Math.hypot(clientX - start[0], clientY - start[1]) < maxMove;
    if (isStill) setTimeout(() => { if (hovered) choose(hovered); }, hoverDelay);
  }, true);
}
