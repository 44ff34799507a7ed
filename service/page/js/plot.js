// Plotly, loaded when something is first drawn, in the page's own colours.

import { base } from "./api.js";
import { el, working } from "./dom.js";

export const NARROW = 600; // px: the width below which a place is that of a telephone

let loading = null;

function plotly() {
  loading ??= new Promise((done, failed) => {
    const script = el("script", { src: new URL("page/plotly.min.js", base).href });
    script.onload = () => done(window.Plotly);
    script.onerror = () => { loading = null; failed(new Error("What draws could not be loaded. Try again.")); };
    document.head.append(script);
  });
  return loading;
}

// The colours of the page as they are now; plotly reads no CSS variables.
export function colours() {
  const probe = el("span", { class: "unseen" });
  document.body.append(probe);
  const found = {};
  for (const name of ["ink", "muted", "line", "card", "paper", "accent", "covered", "thin", "outside", "query", "sunken", "part"]) {
    probe.style.color = `var(--${name})`;
    found[name] = getComputedStyle(probe).color;
  }
  probe.remove();
  return found;
}

export const faint = (colour, part) => colour.replace(/^rgb\((.*)\)$/, `rgba($1, ${part})`);

function themed(layout, narrow) {
  const shade = colours();
  const axis = { gridcolor: shade.line, zerolinecolor: shade.line, linecolor: shade.line, tickcolor: shade.line, exponentformat: "SI", automargin: true };
  const space = { ...axis, backgroundcolor: shade.card, showbackground: false, showspikes: false, tickfont: { size: narrow ? 10 : 12 } };
  const common = {
    paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)",
    font: { family: getComputedStyle(document.body).fontFamily, size: 12, color: shade.muted },
    margin: { l: 8, r: 8, t: 8, b: 8 }, hoverlabel: { bgcolor: shade.card, bordercolor: shade.line, font: { color: shade.ink } },
    showlegend: false, autosize: true,
  };
  const made = { ...common, ...layout };
  if (layout.scene) {
    made.scene = { ...layout.scene };
    for (const name of ["xaxis", "yaxis", "zaxis"]) made.scene[name] = { ...space, ...layout.scene[name], title: { font: { size: narrow ? 11 : 14 }, ...layout.scene[name].title } };
  } else {
    for (const name of ["xaxis", "yaxis"]) made[name] = { ...axis, ...layout[name] };
  }
  return made;
}

// Draws `make(colours)` -> {data, layout}, and again whenever the colours change. Returns a
// drawing with `again()` for new content and `plotly` for changes of a part.
export async function draw(place, make, signal, label) {
  const drawing = { place, plotly: null };
  place.replaceChildren(el("div", { class: "waits" }, working("The drawing is loaded …")));
  drawing.plotly = await plotly();
  place.replaceChildren();
  place.setAttribute("role", "img");
  place.setAttribute("aria-label", label);
  drawing.again = async () => {
    const { data, layout } = make(colours());
    await drawing.plotly.react(place, data, themed(layout, place.clientWidth < NARROW), { displayModeBar: false, responsive: true, displaylogo: false });
    place.dataset.drawn = String(Number(place.dataset.drawn || 0) + 1);
  };
  if (signal.aborted) return drawing;
  const again = () => drawing.again();
  window.addEventListener("theme", again);
  await drawing.again();
  let width = place.clientWidth; // a telephone that is turned has another layout, not only another size
  const resized = new ResizeObserver(() => { if (place.clientWidth && place.clientWidth !== width) { width = place.clientWidth; again().then(() => drawing.plotly.Plots.resize(place)).catch(() => {}); } });
  resized.observe(place);
  signal.addEventListener("abort", () => { window.removeEventListener("theme", again); resized.disconnect(); drawing.plotly.purge(place); });
  return drawing;
}
