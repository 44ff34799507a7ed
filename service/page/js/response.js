// What the table answers along one load, with its error band, among its rows.

import { get, of, trouble } from "./api.js";
import { choice, el, note, put } from "./dom.js";
import { emptyTable } from "./empty.js";
import { LOADS, OUTPUTS, counted, marked, number, plain, prefixOf, quantity, symbol, unitOfLoad, unitOfOutput } from "./format.js";
import { OUTSIDE, beyondRange, loadsOf } from "./inputs.js";
import { draw, faint } from "./plot.js";
import { solverError, tableError } from "./shares.js";
import { wrenchForm } from "./wrench_form.js";

const LEAST_REST = 1e-3; // of the interpolation error: what is less is no colour in the drawing

export async function show(root, about, signal) {
  if (!about.rows) {
    put(root, emptyTable(about, "The table has no rows yet. This view will draw a displacement along a load, with its error band."));
    return;
  }
  const loads = loadsOf(about); // along the others there is no line to draw
  const state = { load: loads.includes("fz") ? "fz" : loads[0], output: "uz", at: LOADS.map(() => 0), less: "nothing", sweep: null, rows: null, drawing: null, inner: tableError(about), rest: solverError(about) };
  const place = el("div", { class: "plot low", id: "response" });
  const caption = el("p", { class: "muted small", "aria-live": "polite" });
  const load = async () => {
    others.inputs.forEach((input, k) => { input.closest("label").hidden = input.disabled = LOADS[k] === state.load; });
    put(summary, `Other loads: ${LOADS.flatMap((one, k) => (one !== state.load && state.at[k] ? `${plain(one)} ${number(state.at[k])} ${unitOfLoad(one)}` : [])).join(", ") || "0"}`);
    try {
      await ask(about, state, signal);
      measuredOnly(root, state);
      state.drawing ??= await draw(place, (shade) => picture(state, shade), signal, "");
      again();
    } catch (error) { if (!signal.aborted) put(caption, trouble(error)); }
  };
  // The key names what is drawn alone.
  const key = bands(about), [, rest, thin, outside, row] = key.children;
  const again = () => {
    const k = OUTPUTS.indexOf(state.output);
    rest.hidden = !state.sweep.error.some((one, place) => one[k] > (1 + LEAST_REST) * state.sweep.interpolation[place][k]);
    thin.hidden = !state.sweep.coverage.includes(1);
    outside.hidden = !state.sweep.coverage.includes(2);
    row.hidden = !state.rows?.displacement.some((one) => one[k] !== null);
    state.drawing?.again();
    place.setAttribute("aria-label", labelOf(state));
    put(caption, labelOf(state));
  };
  const symbols = (names) => names.map((name) => [name, symbol(name)]);
  const others = wrenchForm(about, { action: "Apply", asked: (wrench) => { state.at = wrench; load(); } });
  others.inputs.forEach((input) => { input.value = "0"; });
  const summary = el("summary", {});
  put(root, el("section", { class: "card" },
    el("div", { class: "line bottom" },
      choice("load", "Along", symbols(loads), state.load, (value) => { state.load = value; load(); }),
      choice("output", "Output", symbols(OUTPUTS), state.output, (value) => { state.output = value; again(); }),
      choice("less", "Drawn", [["nothing", "output"], ["line", "deviation from a straight line"]], state.less, (value) => { state.less = value; again(); })),
    place, key, caption,
    el("details", { id: "other-loads" }, summary,
      el("div", { class: "stack" }, note("", "Rows are drawn only if all of these are zero."), others.form))));
  await load();
}

async function ask(about, state, signal) {
  const at = LOADS.map((one, place) => `${one}=${state.at[place] || 0}`).join("&");
  const alone = LOADS.every((one, place) => one === state.load || !state.at[place]);
  const [sweep, rows] = await Promise.all([
    get(`${of(about.name)}/response?load=${state.load}&${at}`, signal),
    alone ? get(`${of(about.name)}/drawing?along=${state.load}&most=1000`, signal) : null,
  ]);
  if (rows) {
    const inside = rows.wrench.map((one) => !beyondRange(about, one)); // a row far out would flatten the curve
    rows.outside = inside.filter((one) => !one).length;
    rows.shown -= rows.outside;
    for (const column of ["wrench", "displacement"]) rows[column] = rows[column].filter((_, place) => inside[place]);
  }
  Object.assign(state, { sweep, rows });
}

const isMeasured = (sweep, k) => sweep.displacement.some((one) => one[k] !== null);

// An output that no row has cannot be chosen.
function measuredOnly(root, state) {
  const there = OUTPUTS.filter((_, k) => isMeasured(state.sweep, k));
  if (there.length && !there.includes(state.output)) state.output = there[0];
  for (const radio of root.querySelectorAll("input[name=output]")) {
    radio.disabled = there.length > 0 && !there.includes(radio.value);
    radio.checked = radio.value === state.output;
  }
}

function labelOf(state) {
  const { sweep, rows, output, load, inner: table, rest } = state, straight = straightOf(state);
  const thin = sweep.coverage.filter((one) => one > 0).length;
  const share = Math.round(100 * (1 - thin / sweep.coverage.length));
  const k = OUTPUTS.indexOf(output), shown = rows?.displacement.filter((one) => one[k] !== null).length;
  const drawn = rows ? `${shown === 1 ? "1 row lies" : `${shown || "no"} rows lie`} on this line${rows.outside ? ` (${counted(rows.outside, "row")} ${OUTSIDE} and not drawn)` : ""}` : "rows are not drawn, since other loads act";
  if (!isMeasured(sweep, k)) return `${plain(output)} is not measured in any row.`;
  const bars = sweep.error.map((one) => one[k] ?? 0);
  const unit = unitOfOutput(output), place = bars.indexOf(Math.max(...bars)), widest = quantity(bars[place], unit, 2), inner = sweep.interpolation[place]?.[k] ?? 0;
  const unknown = Math.round(100 * sweep.error.filter((one) => one[k] === null).length / sweep.error.length);
  const parts = sweep.bars_are_whole ? ` (${table} ${inner > bars[place] / 1000 ? quantity(inner, unit, 2) : "negligible"}${bars[place] > inner ? `, ${rest} ${quantity(bars[place] - inner, unit, 2)}` : ""})` : "";
  const line = `${plain(output)} over ${plain(load)} by ${sweep.method}${straight ? `, less the straight line ${quantity(straight.at(0), unit)} + ${quantity(straight.slope, `${unit}/${unitOfLoad(load).replace("N·m", "(N·m)")}`)} · ${plain(load)}` : ""}.`, rest_ = `${share} % of the line is covered; ${drawn}.`;
  if (unknown === 100) return `${line} Its error bar is not known, so no band is drawn; ${rest_}`;
  return `${line} The band is its 95 % error bar, ${sweep.bars_are_whole ? "" : "without the discretisation error, which is not known, "}at most ±\u00a0${widest}${parts}${unknown ? `, and not known, nor drawn, on ${unknown} % of the line` : ""}; ${rest_}`;
}

function picture(state, shade) {
  const { sweep, rows, output, load } = state;
  const k = OUTPUTS.indexOf(output);
  const line = straightOf(state), less = (value, x) => (value === null ? null : value - (line?.at(x) ?? 0));
  const values = sweep.displacement.map((one, place) => less(one[k], sweep.at[place])), bars = sweep.error.map((one) => one[k]), inner = sweep.interpolation.map((one) => one[k]);
  const largest = values.reduce((a, b, place) => Math.max(a, Math.abs(b ?? 0) + (line ? bars[place] ?? 0 : 0)), 0);
  const [scale, prefix] = prefixOf(largest);
  const hover = `%{x:.4~g} ${unitOfLoad(load)}: %{y:.5~g} ${prefix}${unitOfOutput(output)}<extra></extra>`;
  const band = (width, fillcolor) => ({ ...around(sweep.at, values, width, scale), mode: "lines", line: { width: 0 }, hoverinfo: "skip", fill: "toself", fillcolor });
  const data = [
    band(bars, faint(shade.query, 0.2)),
    band(inner, faint(shade.accent, 0.4)),
    { x: sweep.at, y: values.map((one) => (one === null ? null : one / scale)), mode: "lines", line: { color: shade.accent, width: 2 }, hovertemplate: hover },
  ];
  if (rows) {
    const place = LOADS.indexOf(load);
    data.push({ x: rows.wrench.map((one) => one[place]), y: rows.displacement.map((one, row) => (one[k] === null ? null : less(one[k], rows.wrench[row][place]) / scale)), mode: "markers", marker: { color: shade.ink, size: 7, symbol: "circle-open", line: { width: 1.5 } }, hovertemplate: hover });
  }
  return { data, layout: {
    xaxis: { title: { text: `${marked(load)}, ${unitOfLoad(load)}` }, range: wide(sweep.at) },
    yaxis: { title: { text: `${marked(output)}${line ? " less a line" : ""}, ${prefix}${unitOfOutput(output)}` } },
    shapes: uncovered(sweep, shade), margin: { l: 56, r: 12, t: 12, b: 44 },
  } };
}

// The straight line that is subtracted, least squares through the answers; null where none is.
function straightOf({ sweep, output, less: kind }) {
  if (kind === "nothing") return null;
  const k = OUTPUTS.indexOf(output), known = sweep.at.map((x, place) => [x, sweep.displacement[place][k]]).filter(([, y]) => y !== null);
  const mean = (of) => known.reduce((sum, one) => sum + of(one), 0) / known.length, middle = mean(([x]) => x), level = mean(([, y]) => y);
  const slope = mean(([x, y]) => (x - middle) * (y - level)) / (mean(([x]) => (x - middle) ** 2) || 1);
  return { slope, at: (x) => level + slope * (x - middle) };
}

// The outline of a band, one polygon each stretch of the line whose error bar is known.
function around(at, values, width, scale) {
  const stretches = [[]];
  at.forEach((_, place) => {
    if (values[place] !== null && (width[place] ?? null) !== null) stretches.at(-1).push(place);
    else if (stretches.at(-1).length) stretches.push([]);
  });
  const found = { x: [], y: [] };
  for (const places of stretches.filter((one) => one.length > 1)) {
    const back = [...places].reverse(), edge = (side) => (place) => (values[place] + side * width[place]) / scale;
    found.x.push(...[...places, ...back].map((place) => at[place]), null);
    found.y.push(...places.map(edge(1)), ...back.map(edge(-1)), null);
  }
  return found;
}

// The band is drawn in two: what more rows lower, and what a finer mesh lowers.
function bands(about) {
  const one = (colour, text, faint_ = 100) => {
    const mark = el("i", { class: `square ${faint_ < 100 ? "stretch" : ""}` });
    mark.style.background = `color-mix(in srgb, var(--${colour}) ${faint_}%, var(--card))`;
    return el("li", {}, mark, text);
  };
  return el("ul", { class: "key-of-marks" }, one("accent", about.has_fea ? "interpolation error: more rows lower it" : `${tableError(about)}: more readings lower them`, 40),
    one("query", about.has_fea ? `${solverError(about)} error: a finer mesh ${about.linear ? "or nonlinear = true " : ""}lowers it` : `${solverError(about)}: a better rig lowers them`, 20),
    one("thin", "thin: the rows do not cover it", 100 * SHADED[1][1]), one("muted", "outside the rows or the load range", 100 * SHADED[2][1]), el("li", {}, el("i", { class: "hollow" }), "row of the table"));
}

function wide(at) {
  const low = at[0], high = at.at(-1), more = 0.02 * (high - low || 1);
  return [low - more, high + more];
}

const SHADED = [null, ["thin", 0.2], ["muted", 0.3]]; // colour and opacity of stretches that are thin and outside
const LABELLED = 0.15; // part of the line that a stretch needs for its word

// Where the line is thin or outside, as shaded stretches.
function uncovered(sweep, shade) {
  const stretches = [];
  sweep.coverage.forEach((code, place) => {
    const last = stretches.at(-1);
    if (last && last.code === code) last.to = sweep.at[place];
    else stretches.push({ code, from: sweep.at[place], to: sweep.at[place] });
  });
  const [low, high] = [sweep.at[0], sweep.at.at(-1)];
  return stretches.filter((one) => one.code).map((one) => ({
    type: "rect", xref: "x", yref: "paper", x0: one.from, x1: one.to, y0: 0, y1: 1, line: { width: 0 }, fillcolor: faint(shade[SHADED[one.code][0]], SHADED[one.code][1]), layer: "below",
    label: { text: one.to - one.from > LABELLED * (high - low) ? ["", "thin", "outside"][one.code] : "", textposition: "top center", font: { size: 12, color: shade.ink } },
  }));
}
