// The coverage of one axis in space: its rows, their hull, what is thin, what was asked last.

import { asked } from "./asked.js";
import { get, of, trouble } from "./api.js";
import { choice, el, note, put, table, working } from "./dom.js";
import { emptyTable, linkTo } from "./empty.js";
import { LOADS, count, counted, number, percent, plain, symbol, unitOfLoad } from "./format.js";
import { OUTSIDE, axesOf, beyondRange, loadsOf } from "./inputs.js";
import { box } from "./load_box.js";
import { draw } from "./plot.js";
import { CUBE, figure } from "./view3d.js";
import { keepWrench } from "./wrench_form.js";

const TRIES = 3; // drawings until picture and figures are of one version: a fill adds rows faster

export async function show(root, about, signal) {
  if (!about.rows) {
    put(root, emptyTable(about, "The table has no rows yet. This view will show the loads that its rows reach, and the largest gaps between them."));
    return;
  }
  const stage = el("div", { class: "stack" }), below = el("div", { class: "halves" });
  const pick = (axis) => axisOf(stage, below, about, axis, signal).catch((error) => { if (!signal.aborted) put(stage, trouble(error)); });
  const axes = axesOf(about), first = axes.at(-1);
  put(root, el("section", { class: "card" }, choice("axis", "Rows of", axes.map((axis) => [axis, `axis ${axis}`]), first, pick), stage), below);
  await pick(first);
}

// The picture and its figures come by two calls: where rows arrived between them, both are asked for again.
async function axisOf(stage, below, about, axis, signal, tries = TRIES) {
  const [rows, latest] = await Promise.all([
    get(`${of(about.name)}/drawing?axis=${axis}&most=3000`, signal),
    latestOf(about, signal),
  ]);
  const inside = rows.wrench.map((one) => !beyondRange(about, one)), far = inside.filter((one) => !one).length; // rows far out would shrink all else to a point
  for (const column of ["wrench", "clean"]) rows[column] = rows[column].filter((_, place) => inside[place]);
  let gap = { hull: [], worst: [] };
  const drawn = rows.inputs.filter((load) => loadsOf(about).includes(load));
  const place = Object.assign(el("div", { class: "plot", id: "coverage" }), { fit: { box: CUBE } });
  const view = figure(place, `Rows of axis ${axis}`, marks(about, rows, latest));
  const waiting = working("The convex hull is computed …");
  put(below, waiting);
  put(stage, rows.shown < rows.of ? note("", `${count(rows.shown)} of ${count(rows.of)} rows are drawn, spread over the table.`) : null, far ? note("", `${counted(far, "row")} ${OUTSIDE} and not drawn.`) : null, drawn.length > 1 ? view.root : el("div", { class: "line" }, `Of this axis only ${plain(drawn[0])} has a load range: the response along it shows its rows.`, linkTo(about, "response", "Show the response")));
  const drawing = drawn.length > 1 && await draw(place, (shade) => picture(about, rows, gap, latest, shade, view.camera()), signal, `${rows.shown} rows of axis ${axis} over ${rows.inputs.join(", ")}`);
  if (drawing) view.hold(drawing);
  const cover = await get(`${of(about.name)}/coverage`, signal); // seconds for 100,000 rows
  if (!below.contains(waiting)) return; // another axis was chosen meanwhile
  const differs = cover.table_version !== rows.table_version;
  if (differs && tries > 1) { await axisOf(stage, below, about, axis, signal, tries - 1); return; }
  gap = cover.gaps.find((one) => one.axis === axis) || gap;
  put(below, differs ? note("thin", `Rows arrive: the picture is of table version ${rows.table_version}, the figures are of ${cover.table_version}.`) : null,
    el("section", { class: "card" }, el("h2", {}, "Coverage of this axis"), holds(rows, cover.axes.find((one) => one.axis === axis))),
    el("section", { class: "card" }, el("h2", {}, "Largest gaps within the hull"), worst(about, gap)));
  if (drawing) await drawing.again();
}

// What the server was asked and could not cover, if it keeps that, and what this tab asked.
async function latestOf(about, signal) {
  const own = asked(about.name).map((one) => one.wrench);
  const reply = await get(`${of(about.name)}/demand`, signal).catch(() => null);
  return [...own, ...(reply?.latest || []).map((one) => one.wrench)].slice(0, 100);
}

// The key of what is drawn, and of nothing else.
function marks(about, rows, latest) {
  const has = (code) => rows.grid.coverage.includes(code);
  const kinds = [
    [rows.clean.some(Boolean), "", "accent", "row with loads of this axis only"], [!rows.clean.every(Boolean), "hollow", "card", "row with other loads too"],
    [has(1), "square", "thin", "loads that are thin"], [has(2), "hollow diamond", "card", "loads outside the rows"],
    [true, "hollow square", "card", "frame: the load range"], [rows.of > 3 && spans(rows) === rows.inputs.length && rows.inputs.every((load) => loadsOf(about).includes(load)), "square pale", "accent", "convex hull of the rows"],
    [latest.some((one) => isNear(about, one)), "diamond", "query", "latest queries, within twice the load range"],
  ];
  return el("ul", { class: "key-of-marks" }, kinds.filter(([drawn]) => drawn).map(([, kind, colour, text]) => {
    const mark = el("i", { class: kind });
    mark.style.background = `var(--${colour})`;
    return el("li", {}, mark, text);
  }));
}

// The number of loads that vary in the rows.
const spans = (rows) => rows.inputs.filter((load) => new Set(rows.wrench.map((one) => one[LOADS.indexOf(load)])).size > 1).length;

function picture(about, rows, gap, latest, shade, camera) {
  const columns = rows.inputs.map((load) => LOADS.indexOf(load));
  const clean = rows.wrench.filter((_, place) => rows.clean[place]);
  const mixed = rows.wrench.filter((_, place) => !rows.clean[place]);
  const many = rows.shown > 400;
  const at = (code) => rows.grid.wrench.filter((_, place) => rows.grid.coverage[place] === code);
  const data = [
    ...hull(gap, rows.inputs, shade),
    dots(columns, mixed, { size: many ? 2 : 4, color: shade.card, line: { color: shade.muted, width: 1 } }, "row with other loads"),
    dots(columns, clean, { size: many ? 2 : 4.5, color: shade.accent, opacity: many ? 0.6 : 1 }, "row"),
    dots(columns, at(1), { size: 4, symbol: "square", color: shade.thin, opacity: 0.55 }, "thin"),
    dots(columns, at(2), { size: 4, symbol: "diamond-open", color: shade.muted, opacity: 0.8 }, "outside"),
    dots(columns, latest.filter((one) => isNear(about, one)), { size: 6, symbol: "diamond", color: shade.query }, "asked"),
    box(about, columns, shade),
  ];
  const axis = (load) => ({ title: { text: `${plain(load)}, ${unitOfLoad(load)}` }, nticks: 5 });
  const scene = { xaxis: axis(rows.inputs[0]), yaxis: axis(rows.inputs[1]), zaxis: axis(rows.inputs[2]), aspectmode: "cube", camera };
  return { data, layout: { scene, uirevision: "same" } };
}

// A query far outside the load range would shrink all else to a point.
const isNear = (about, wrench) => [...about.range.force, ...about.range.moment].every(([low, high], k) => Math.abs(wrench[k]) <= 2 * Math.max(Math.abs(low), Math.abs(high)));

function dots(columns, wrenches, marker, name) {
  const [x, y, z] = columns.map((k) => wrenches.map((one) => one[k]));
  return { type: "scatter3d", mode: "markers", x, y, z, marker, hovertemplate: `${name}<br>%{x:.4~g}, %{y:.4~g}, %{z:.4~g}<extra></extra>` };
}

function hull(gap, inputs, shade) {
  if (gap.hull.length < 4) return [];
  const [x, y, z] = inputs.map((load) => gap.hull.map((one) => one[load]));
  return [{ type: "mesh3d", x, y, z, alphahull: 0, color: shade.accent, opacity: 0.09, hoverinfo: "skip" }];
}

function holds(rows, summary) {
  if (!summary) return el("p", {}, "The table's compliance answers: all loads are covered by six unit solves, whatever the rows.");
  const lines = Object.entries(summary.spans).map(([load, [low, high]]) => [symbol(load), number(low), number(high), unitOfLoad(load)]);
  return [
    el("p", {}, `Rows at ${counted(summary.rows, "load")}, ${summary.corrected ? (summary.corrected === summary.rows ? "all" : count(summary.corrected)) : "none"} of them with loads of other axes too, span ${counted(summary.dimensions ?? 0, "dimension")}.${(summary.dimensions ?? 0) < rows.inputs.length ? "" : ` Their convex hull encloses ${percent(summary.part_of_range)} of the range.`} Kriging covers loads beyond it where its error is known and within the tolerance.`),
    lines.length ? table(["Load", "#from", "#to", "unit"], lines) : null,
  ];
}

function worst(about, gap) {
  if (!gap.worst.length) return el("p", {}, "There are no gaps within the hull.");
  const loads = Object.keys(gap.worst[0].loads);
  const query = (one) => el("a", { href: `#/c/${encodeURIComponent(about.name)}/query`, onclick: () => keepWrench(about.name, LOADS.map((load) => one.loads[load] ?? 0)) }, "Query");
  return table([...loads.map((load) => `#${plain(load)}, ${unitOfLoad(load)}`), "#size, of the range", ""],
    gap.worst.map((one) => [...loads.map((load) => number(one.loads[load], 3)), percent(one.part_of_range), query(one)]), { scrolls: true, class: "folds named" });
}
