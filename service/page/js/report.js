// Error against run time: the report, made on demand, drawn from its figures.

import { Problem, get, of, send, trouble } from "./api.js";
import { el, field, note, put, save, table } from "./dom.js";
import { count, percent, quantity, seconds } from "./format.js";
import { draw } from "./plot.js";

const LOOKS = { kriging: ["accent", "circle", "solid"], griddata: ["outside", "square", "dash"], additive: ["query", "diamond", "longdashdot"], tangent: ["covered", "triangle-up", "dashdot"], linear: ["query", "x", "dot"], nearest: ["muted", "cross", "longdash"], FEA: ["ink", "diamond", "dot"] };
const LOOK_S = 1000; // between looks at how far it is

export async function show(root, about, signal) {
  if (!about.has_fea) {
    put(root, el("p", { class: "empty" }, "This component has no finite-element setup, so there is no reference to report against."));
    return;
  }
  const body = el("div", { class: "stack" }), state = el("div", { "aria-live": "polite" });
  put(root, el("section", { class: "card" }, order(about, state, body, signal), state), body);
  await latest(about, state, body, signal);
}

function order(about, state, body, signal) {
  const wrenches = el("input", { type: "number", min: 3, max: 1000, value: 24 });
  const make = async (event) => {
    event.preventDefault();
    try {
      await send("POST", `${of(about.name)}/report?wrenches=${wrenches.value}`, { signal });
      await latest(about, state, body, signal);
    } catch (error) { if (!signal.aborted) put(state, trouble(error)); }
  };
  return el("form", { class: "line bottom", onsubmit: make },
    field("Wrenches to compare", wrenches), el("button", {}, "Make the report"),
    el("span", { class: "muted small" }, "Each wrench is solved on three meshes; this takes minutes."));
}

async function latest(about, state, body, signal) {
  for (;;) {
    const now = await get(`${of(about.name)}/report?format=state`, signal);
    if (now.state === "running") put(state, el("progress", { max: "1", value: now.fraction }), el("span", { class: "muted small" }, now.message));
    else if (now.state === "failed") put(state, note("outside", "The report could not be made: ", now.message));
    else put(state);
    if (now.state !== "running") break;
    await new Promise((done) => setTimeout(done, LOOK_S));
    if (signal.aborted) return;
  }
  try {
    const told = await get(`${of(about.name)}/report`, signal);
    await page(body, about, told, signal);
  } catch (error) {
    if (signal.aborted) return;
    if (error instanceof Problem && error.status === 404) put(body, el("p", { class: "empty" }, "No report yet."));
    else put(body, trouble(error));
  }
}

const worst = (entry) => {
  const found = (entry.lookup_error || entry.error).rms_relative;
  return found.includes(null) ? Infinity : Math.max(...found);
};
const took = (entry) => (entry.method ? entry.query_us_p50 * 1e-6 : entry.seconds_p50);
const nameOf = (entry) => (entry.method ? `${entry.method}, ${entry.rows} rows` : `FEA, ${entry.level} mesh`);

async function page(body, about, told, signal) {
  const place = el("div", { class: "plot low" });
  const entries = [...told.tables, ...told.fea.slice(0, -1)];
  const lines = entries.map((entry) => [
    nameOf(entry) + (told.pareto.includes(nameOf(entry)) ? " ★" : ""), percent(worst(entry)), timeOf(took(entry)),
    entry.method ? percent(entry.covered, 3) : "–",
    entry.inside_error_bar ? percent(Math.min(...entry.inside_error_bar.filter((one) => one !== null)), 3) : "–",
  ]);
  const keys = Object.keys(LOOKS).filter((name) => groups(told).has(name));
  put(body,
    el("section", { class: "card" }, el("h2", {}, "Error against run time of one answer"), place,
      el("ul", { class: "key-of-marks" }, keys.map((name) => { const mark = el("i", {}); mark.style.background = `var(--${LOOKS[name][0]})`; return el("li", {}, mark, name); })),
      el("p", { class: "muted small" }, `${told.wrenches.compared} of ${told.wrenches.asked} random wrenches, none of them in the table, which has ${count(told.rows)} rows. Errors are RMS over the range of the worst output.`)),
    el("section", { class: "card" }, el("h2", {}, "Figures"),
      table(["", "#error", "#one answer", "#covered", "#inside the error bar"], lines, { scrolls: true }),
      el("div", { class: "line" }, el("span", { class: "muted small" }, "★ nothing else is both better and faster"), files(about))));
  await draw(place, (shade) => front(told, shade), signal, "Error against run time, both logarithmic; the figures are in the table below.");
}

const timeOf = (value) => (value < 1 ? quantity(value, "s") : seconds(value));

function groups(told) {
  const found = new Map();
  for (const entry of told.tables) found.set(entry.method, [...(found.get(entry.method) || []), entry]);
  return found.set("FEA", told.fea.slice(0, -1));
}

function front(told, shade) {
  const data = [...groups(told)].map(([name, entries]) => {
    const shown = entries.filter((entry) => worst(entry) > 0 && worst(entry) < Infinity);
    const [colour, symbol, dash] = LOOKS[name] || LOOKS.nearest;
    return {
      mode: "markers+lines", name, x: shown.map(took), y: shown.map((entry) => 100 * worst(entry)), text: shown.map(nameOf),
      marker: { size: 10, symbol, color: shade[colour] }, line: { color: shade[colour], dash, width: 1.5 },
      hovertemplate: "%{text}<br>%{y:.3~g} %, %{x:.3~s}s<extra></extra>",
    };
  });
  const log = { type: "log", exponentformat: "power", dtick: 1 };
  return { data, layout: { xaxis: { ...log, title: { text: "run time of one answer, s" } }, yaxis: { ...log, title: { text: "largest RMS error, % of the range" } }, margin: { l: 60, r: 12, t: 12, b: 48 } } };
}

function files(about) {
  const take = (format, ending) => async () => {
    const reply = await send("GET", `${of(about.name)}/report?format=${format}`);
    save(await reply.blob(), `${about.name}-report.${ending}`);
  };
  return el("span", { class: "line" }, ["html", "md", "json"].map((format) => el("button", { type: "button", class: "small", onclick: take(format, format) }, `Save ${format.toUpperCase()}`)));
}
