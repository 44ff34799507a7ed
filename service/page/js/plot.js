// Draws Plotly figures in the colours of the page; the library is loaded with the first figure.

import { base } from "./api.js";
import { el, working } from "./dom.js";

export const NARROW = 600; // px: a figure below this width has the layout of a telephone
const COLOURS = ["ink", "muted", "line", "card", "paper", "accent", "covered", "thin", "outside", "query", "sunken", "part"];

let loading = null; // the promise of the library

function plotly() {
  loading ??= new Promise((resolve, reject) => {
    const script = el("script", { src: new URL("page/plotly.min.js", base).href });
    script.onload = () => resolve(window.Plotly);
    script.onerror = () => { loading = null; reject(new Error("What draws could not be loaded. Try again.")); };
    document.head.append(script);
  });
  return loading;
}

// The colours of the present theme by name: Plotly reads no CSS variables.
export function colours() {
  const probe = el("span", { class: "unseen" });
  document.body.append(probe);
  const byName = {};
  for (const name of COLOURS) {
    probe.style.color = `var(--${name})`;
    byName[name] = getComputedStyle(probe).color;
  }
  probe.remove();
  return byName;
}

export const faint = (colour, opacity) => colour.replace(/^rgb\((.*)\)$/, `rgba($1, ${opacity})`);

// The layout with the theme's colours and fonts where it has none of its own.
function themed(layout, narrow) {
  const shade = colours();
  const axis = { gridcolor: shade.line, zerolinecolor: shade.line, linecolor: shade.line, tickcolor: shade.line, exponentformat: "SI", automargin: true };
  const spaceAxis = { ...axis, backgroundcolor: shade.card, showbackground: false, showspikes: false, tickfont: { size: narrow ? 10 : 12 } };
  const common = {
    paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)",
    font: { family: getComputedStyle(document.body).fontFamily, size: 12, color: shade.muted },
    margin: { l: 8, r: 8, t: 8, b: 8 }, hoverlabel: { bgcolor: shade.card, bordercolor: shade.line, font: { color: shade.ink } },
    showlegend: false, autosize: true,
  };
  const title = (name) => ({ font: { size: narrow ? 11 : 14 }, ...layout.scene[name].title });
  const inSpace = (name) => [name, { ...spaceAxis, ...layout.scene[name], title: title(name) }];
  if (layout.scene) return { ...common, ...layout, scene: { ...layout.scene, ...Object.fromEntries(["xaxis", "yaxis", "zaxis"].map(inSpace)) } };
  return { ...common, ...layout, xaxis: { ...axis, ...layout.xaxis }, yaxis: { ...axis, ...layout.yaxis } };
}

// Draws `make(colours)` -> {data, layout} into an element, and again when theme or width change, until
// `signal` is aborted. Returns a drawing: `again()` draws new content, `plotly` changes a part of it.
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
    place.dataset.drawn = String(Number(place.dataset.drawn || 0) + 1); // the page's tests wait for it
  };
  if (signal.aborted) return drawing;
  const again = () => drawing.again();
  window.addEventListener("theme", again);
  await drawing.again();
  let width = place.clientWidth;
  const resized = new ResizeObserver(() => {
    if (!place.clientWidth || place.clientWidth === width) return;
    width = place.clientWidth; // a telephone that is turned has another layout, not only another size
    again().then(() => drawing.plotly.Plots.resize(place)).catch(() => {});
  });
  resized.observe(place);
  signal.addEventListener("abort", () => { window.removeEventListener("theme", again); resized.disconnect(); drawing.plotly.purge(place); });
  return drawing;
}
