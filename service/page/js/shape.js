// The deformed part under a typed wrench: magnified, coloured, beside its undeformed outline.

import { caughtUp, get, of, post, send, trouble } from "./api.js";
import { choice, el, facts, field, note, pill, put, save, select, working } from "./dom.js";
import { beyondRange, named } from "./inputs.js";
import { LOADS, counted, number, pageWords, quantity, rounded, stress, symbol, triple, withBar } from "./format.js";
import { NARROW, draw } from "./plot.js";
import { overTolerance } from "./shares.js";
import { boxOf, column, extent, lengths, lines, moved, outline } from "./surface.js";
import { figure } from "./view3d.js";
import { lastWrench, wrenchForm } from "./wrench_form.js";

const MM = 1000;
const NAMES = { true: [60, 28], false: [26, 18] }; // px beside, and above and below the box; at true scale its axes have ticks
const SEEN = 0.12; // of the part's size: what the largest displacement is first magnified to
const SHOWN = () => [["size", "|u|"], ["0", symbol("ux")], ["1", symbol("uy")], ["2", symbol("uz")]];

export async function show(root, about, signal) {
  const stage = el("div", { class: "card", "aria-live": "polite" }, working("The surface is computed …"));
  const form = wrenchForm(about, { action: "Show", asked: (wrench) => bend(stage, about, wrench, signal) });
  put(root, el("div", { class: "two" }, el("section", { class: "card" }, form.form), stage));
  await bend(stage, about, lastWrench(about), signal);
}

const queryOf = (wrench) => LOADS.map((load, place) => `${load}=${wrench[place]}`).join("&");

async function bend(stage, about, wrench, signal) {
  let shape;
  try {
    shape = await get(`${of(about.name)}/deformed?${queryOf(wrench)}`, signal);
  } catch (error) {
    if (signal.aborted) return;
    if (error.status !== 409) { put(stage, trouble(error)); return; }
    const outside = beyondRange(about, wrench);
    const solve = el("button", { type: "button", class: "first", onclick: () => solved(stage, about, wrench, Boolean(outside), signal) }, outside ? "Solve it nevertheless" : "Solve this wrench");
    put(stage, note("thin", el("strong", {}, error.body.title), outside ? el("span", {}, outside) : null, el("span", {}, "Each solve by the embedded solver leaves a deformed surface; surfaces between solves are interpolated.")), el("div", {}, solve));
    return;
  }
  await stageOf(stage, about, wrench, shape, signal);
}

// Solves a wrench, and draws it.
async function solved(stage, about, wrench, outside, signal) {
  put(stage, working("Solving …"));
  try {
    let job = (await post(`${of(about.name)}/solve`, { force: wrench.slice(0, 3), moment: wrench.slice(3), ...(outside && { beyond_range: true }) }, signal)).job;
    while (["waiting", "running"].includes(job.status)) job = await get(`v1/jobs/${job.id}?wait_s=20`, signal);
    if (job.status !== "done") throw new Error(job.error?.message || "The solve was cancelled.");
    await caughtUp(about.name, signal);
    await bend(stage, about, wrench, signal);
  } catch (error) { if (!signal.aborted) put(stage, trouble(error)); }
}

async function stageOf(stage, about, wrench, shape, signal) {
  const mean = await post(`${of(about.name)}/displacement`, { ...named(about, wrench), on_thin: "estimate" }, signal).catch(() => null);
  if (signal.aborted) return;
  const sizes = lengths(shape.displacement);
  const largest = sizes.reduce((a, b) => Math.max(a, b), 0);
  const natural = largest > 0 ? (SEEN * extent(shape.vertices)) / largest : 1;
  const state = { factor: round(natural), colour: "size", edges: outline(shape.vertices, shape.triangles) };
  const place = el("div", { class: "plot", id: "shape" });
  const view = figure(place, `Deformed ${about.name}`);
  const magnification = el("output", { id: "factor" });
  const slider = el("input", { type: "range", min: 0, max: 100, step: 1, value: 50, id: "magnify", "aria-label": "Magnification" });
  let drawing = null;
  const set = (factor, moveSlider) => {
    const sameTicks = (state.factor === 1) === (factor === 1);
    state.factor = factor;
    magnification.textContent = `× ${number(factor, 3)}`;
    slider.setAttribute("aria-valuetext", `${number(factor, 3)} times`);
    if (moveSlider) slider.value = 50 * factor / round(natural);
    if (drawing) sameTicks ? redraw(drawing, shape, state) : drawing.again();
  };
  slider.addEventListener("input", () => set(round((slider.value / 50) * round(natural)), false));
  put(stage,
    el("div", { class: "line" }, isOver(shape) ? pill("covered, over tolerance", "thin") : pill(shape.coverage), el("span", { class: "muted small" }, sourceOf(shape))),
    shape.reason ? note(shape.coverage, pageWords(shape.reason)) : null,
    warned(about, shape),
    view.root,
    el("div", { class: "line" }, el("label", { for: "magnify" }, "Magnified"), magnification,
      el("button", { type: "button", class: "small", onclick: () => set(1, true) }, "True scale"),
      el("button", { type: "button", class: "small", onclick: () => set(round(natural), true) }, "Initial scale")),
    slider,
    el("div", { class: "line bottom ends" }, choice("colour", "Colour", SHOWN(), "size", (value) => { state.colour = value; drawing?.again(); }), download(about, wrench)),
    measured(shape, sizes, largest, mean));
  set(state.factor, false);
  drawing = await draw(place, (shade) => picture(place, shape, sizes, state, shade, view.camera), signal, said(about, largest));
  view.hold(drawing);
}

const round = (factor) => (factor > 2 ? Number(factor.toPrecision(2)) : Math.round(factor * 100) / 100);
const said = (about, largest) => `The deformed surface of ${about.name}; its largest displacement is ${quantity(largest, "m")}.`;

const isOver = ({ coverage, within_tolerance: within }) => coverage === "covered" && within === false;

function warned(about, { coverage, error_parts: parts, within_tolerance: within }) {
  if (parts && parts.mesh === null) return note("thin", `The error bars lack the discretisation error: ${parts.mesh_basis}.`);
  return isOver({ coverage, within_tolerance: within }) ? note("thin", overTolerance(about, (parts.mesh + (parts.linearity ?? 0)) / about.tolerance.translation)) : null;
}

const CAUSES = { table: "interpolation", mesh: "discretisation", linearity: "linear analysis" };

function sharesOf(parts) {
  if (!parts) return "";
  return Object.entries(CAUSES).filter(([cause]) => cause in parts).map(([cause, name]) => `${name} ${parts[cause] === null ? "not known" : parts[cause] < 1e-3 * Math.max(...Object.keys(CAUSES).map((one) => parts[one] || 0)) ? "negligible" : quantity(parts[cause], "m", 2)}`).join(", ");
}

function sourceOf(shape) {
  if (shape.source === "row") return `a solve of this wrench, row ${shape.rows[0]}`;
  if (shape.source === "linear") return "six unit solves";
  return `interpolated between the surfaces of ${counted(shape.rows.length, "solve")}; the error bars are theirs, not those of Query and Response, which interpolate the displacement of the interface`;
}

// Where the screen is narrow the colour bar is below the part, else it would lie over it.
function picture(place, shape, sizes, { factor, colour, edges }, shade, camera) {
  const narrow = place.clientWidth < NARROW;
  const points = moved(shape.vertices, shape.displacement, factor);
  const values = (colour === "size" ? sizes : column(shape.displacement, Number(colour), 1)).map((one) => one * MM);
  const corners = [0, 1, 2].map((k) => shape.triangles.map((one) => one[k]));
  const moves = values.some((one) => one !== 0);
  const body = {
    type: "mesh3d", x: column(points, 0, MM), y: column(points, 1, MM), z: column(points, 2, MM),
    i: corners[0], j: corners[1], k: corners[2], intensity: values, showscale: moves, ...(moves ? {} : { cmin: 0, cmax: 1 }), colorscale: "Viridis", flatshading: false,
    lighting: { ambient: 0.62, diffuse: 0.55, specular: 0.08, roughness: 0.8 }, hovertemplate: "%{x:.4~g}, %{y:.4~g}, %{z:.4~g} mm<extra></extra>",
    colorbar: { title: { text: colour === "size" ? "|u|, mm" : `u${"xyz"[Number(colour)]}, mm`, side: "top" }, thickness: 12, tickfont: { color: shade.muted }, outlinewidth: 0, ...(narrow ? { orientation: "h", len: 0.9, x: 0.5, y: 0, yanchor: "bottom" } : { len: 0.7, x: 1, xanchor: "right" }) },
  };
  const before = { type: "scatter3d", mode: "lines", ...lines(shape.vertices, edges, MM), line: { color: shade.muted, width: 3 }, hoverinfo: "skip", connectgaps: false };
  const after = { ...before, ...lines(points, edges, MM), line: { color: shade.ink, width: 3 } };
  const axis = (name) => ({ ...measure(name, factor), nticks: 5 });
  const box = boxOf([...points, ...shape.vertices]), domain = narrow ? { x: [0, 1], y: [0.2, 1] } : { x: [0, 0.9], y: [0, 1] };
  place.fit = { box, domain, names: NAMES[factor === 1] };
  const annotations = [mark(farthest(points, sizes), shade)];
  return { data: [body, before, after], layout: { scene: { xaxis: axis("x"), yaxis: axis("y"), zaxis: { ...axis("z"), nticks: narrow ? 2 : 4 }, aspectmode: "manual", aspectratio: box, domain, camera: camera(), annotations }, uirevision: "same" } };
}

// A text, which the part does not hide: half of a marker sinks into the surface on which it lies.
const mark = ([x, y, z], { query }) => ({ x, y, z, text: "●", hovertext: "largest displacement", showarrow: false, font: { size: 15, color: query } });

// Of the points the one that moves most, mm.
const farthest = (points, sizes) => (points[sizes.indexOf(sizes.reduce((most, one) => Math.max(most, one), 0))] || [0, 0, 0]).map((one) => one * MM);

// Ticks are lengths at true scale alone.
const measure = (name, factor) => ({ title: { text: factor === 1 ? `${name}, mm` : name }, showticklabels: factor === 1 });

// Only points are moved: colours and triangles stay as they are.
function redraw(drawing, shape, { factor, edges }) {
  const points = moved(shape.vertices, shape.displacement, factor);
  const after = lines(points, edges, MM), [x, y, z] = farthest(points, lengths(shape.displacement));
  drawing.plotly.update(drawing.place, {
    x: [column(points, 0, MM), after.x], y: [column(points, 1, MM), after.y], z: [column(points, 2, MM), after.z],
  }, { "scene.aspectratio": boxOf([...points, ...shape.vertices]), "scene.annotations[0].x": x, "scene.annotations[0].y": y, "scene.annotations[0].z": z }, [0, 2]);
}

function measured(shape, sizes, largest, mean) {
  const where = shape.vertices[sizes.indexOf(largest)] || [0, 0, 0];
  const bar = shape.error ? shape.error[sizes.indexOf(largest)] : null, size = withBar(largest, bar, "m");
  const found = shape.stress;
  return facts([
    ["Largest displacement", `${size.value}${bar === null ? ", its error bar is not known," : ` ${size.bar}`} at ${at(where)}`],
    ["Interface", mean?.translation ? `u ${triple(beyondBars(mean), "m")} (Query): the motion of the section as a whole; single points of the surface move more or less.` : ""],
    ["Error bar", sharesOf(shape.error_parts)],
    ["Largest von Mises stress", found ? `${stressWithBar(found)} at ${at(found.at)}` : "not known between the rows here"],
    ["Yields", found && found.error === null ? "not known, since the error bar is not known" : found && found.yields !== null ? (found.yields ? "yes" : `no (yield strength ${stress(found.yield_strength)}; the mesh's error is not included)`) : ""],
    ["Points", "In the interface frame: from the interface point, along its axes, undeformed. The mark in the drawing is at the largest displacement."],
    ["Surface", `${shape.vertices.length} points, ${shape.triangles.length} triangles${shape.simplified ? `, simplified from ${shape.simplified.from} points` : ""}`],
  ]);
}

// A translation, m, to three digits, with 0 for what its error bar cannot tell from it.
const beyondBars = ({ translation, error }) => translation.map((one, k) => (one === null ? null : Math.abs(one) < (error?.translation[k] ?? 0) ? 0 : Number(one.toPrecision(3))));

function stressWithBar({ largest, error }) {
  if (error === null) return stress(largest);
  if (error < 1e-3 * largest) return `${stress(largest)} (interpolation error negligible; the mesh's error is not included)`;
  const { value, bar } = rounded(largest / 1e6, error / 1e6);
  return `${value} MPa ± ${bar} MPa (interpolation; the mesh's error is not included)`;
}

const NANO = 1e9;
const at = (point) => `(${point.map((one) => number((Math.round(one * NANO) / NANO) * MM, 3)).join(", ")}) mm`;

function download(about, wrench) {
  const form = select([["gltf", "glTF"], ["vtu", "VTU (ParaView)"], ["json", "JSON"]], "gltf");
  const take = async () => {
    const reply = await send("GET", `${of(about.name)}/deformed?${queryOf(wrench)}&format=${form.value}`);
    save(await reply.blob(), `${about.name}.${form.value === "gltf" ? "glb" : form.value}`);
  };
  return el("div", { class: "line bottom" }, field("As a file", form), el("button", { type: "button", onclick: take }, "Save"));
}
