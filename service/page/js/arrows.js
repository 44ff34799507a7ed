// A part with arrows of the forces and moments that act at its interfaces.

import { get, of } from "./api.js";
import { el } from "./dom.js";
import { named } from "./inputs.js";
import { draw } from "./plot.js";
import { boxOf, column, extent, lines, outline } from "./surface.js";
import { figure } from "./view3d.js";

const MM = 1e3;
const LONGEST = 0.35; // of the part's extent: the arrow of the largest force, and of the largest moment
const TIP = 0.25; // of the longest arrow

// `read()` gives the inputs; `again()` of the result draws them anew.
export async function picture(root, about, read, signal) {
  const [surface, detail] = await Promise.all([get(`${of(about.name)}/surface`, signal), get(of(about.name), signal)]);
  const interfaces = Object.entries(detail.interfaces || { "": detail.interface }).filter(([, one]) => one?.point);
  const place = el("div", { class: `plot${about.space ? "" : " low"}`, id: "loads" });
  const marks = { force: mark("outside", "force"), moment: mark("query", "moment") };
  const view = figure(place, "The part and its loads", el("ul", { class: "key-of-marks" }, marks.force, marks.moment));
  root.append(view.root, el("p", { class: "muted small" }, interfaces.length ? "Lines x, y and z at the point: the axes of the interface, in which loads and displacements are given." : "The point and the axes of the loads are those of the part's deck."));
  const edges = lines(surface.vertices, outline(surface.vertices, surface.triangles), MM);
  const drawing = await draw(place, (shade) => drawn(place, about, surface, edges, interfaces, read(), shade, view.camera, marks), signal, `${about.name} with its loads`);
  view.hold(drawing);
  return drawing;
}

function mark(colour, text) {
  const square = el("i", { class: "square" });
  square.style.background = `var(--${colour})`;
  return el("li", {}, square, text);
}

function drawn(place, about, { vertices, triangles }, edges, interfaces, values, shade, camera, marks) {
  const corners = [0, 1, 2].map((k) => triangles.map((one) => one[k]));
  const body = { type: "mesh3d", x: column(vertices, 0, MM), y: column(vertices, 1, MM), z: column(vertices, 2, MM), i: corners[0], j: corners[1], k: corners[2], color: shade.accent, opacity: 0.25, hoverinfo: "skip" };
  const middle = [0, 1, 2].map((k) => vertices.reduce((sum, one) => sum + one[k], 0) / vertices.length);
  const rim = { type: "scatter3d", mode: "lines", ...edges, line: { color: shade.muted, width: 2 }, hoverinfo: "skip" };
  const points = { type: "scatter3d", mode: "markers", marker: { size: 4, color: shade.ink }, hoverinfo: "skip" };
  ["x", "y", "z"].forEach((axis, k) => { points[axis] = interfaces.map(([, one]) => one.point[k] * MM); });
  const size = LONGEST * extent(vertices) * MM;
  const arrows = ["force", "moment"].flatMap((kind, which) => {
    const loads = interfaces.map(([name]) => vectorOf(about, values, name, kind));
    const most = Math.max(0, ...loads.map((load) => Math.hypot(...load)));
    marks[kind].hidden = !most;
    return interfaces.flatMap(([, one], k) => (loads[k].some((part) => part) ? arrow(one, loads[k].map((part) => (size * part) / most), size, shade[which ? "query" : "outside"]) : []));
  });
  const data = [body, rim, points, ...interfaces.map(([name, one]) => named_(name, one, middle, 0.75 * size, shade)), ...interfaces.flatMap(([, one]) => frame(one, 0.5 * size, shade)), ...arrows];
  const box = boxOf(data.flatMap((one) => one.x.map((x, k) => [x, one.y[k], one.z[k]])).filter(([x]) => x !== null));
  place.fit = { box };
  const axis = (name) => ({ title: { text: `${name}, mm` }, nticks: 4 });
  return { data, layout: { scene: { xaxis: axis("x"), yaxis: axis("y"), zaxis: axis("z"), aspectmode: "manual", aspectratio: box, camera: camera() }, uirevision: "same" } };
}

const vectorOf = (about, values, name, kind) => {
  const all = named(about, values.map((one) => (Number.isFinite(one) ? one : 0)));
  return (all.loads?.[name] || all)[kind];
};

// The name of an interface, outside the part and beyond the ends of its axes.
function named_(name, { point }, middle, apart, shade) {
  const out = point.map((one, k) => one - middle[k]), length = Math.hypot(...out) || 1;
  const [x, y, z] = point.map((one, k) => [one * MM + (apart * out[k]) / length]);
  return { type: "scatter3d", mode: "text", x, y, z, text: [name], textfont: { color: shade.ink, size: 13 }, hoverinfo: "skip" };
}

// The three axes of an interface, named at their ends.
function frame({ point, axes }, length, shade) {
  return axes.map((direction, row) => {
    const [x, y, z] = [0, 1, 2].map((k) => [point[k] * MM, point[k] * MM + length * direction[k]]);
    return { type: "scatter3d", mode: "lines+text", x, y, z, text: ["", "xyz"[row]], textfont: { color: shade.ink }, line: { color: shade.ink, width: 3 }, hoverinfo: "skip" };
  });
}

// A load in the interface's axes, drawn from its point; the axes are rows in those of the mesh.
function arrow({ point, axes }, load, size, colour) {
  const along = [0, 1, 2].map((k) => load.reduce((sum, part, row) => sum + part * axes[row][k], 0));
  const from = point.map((one) => one * MM), to = from.map((one, k) => one + along[k]), length = Math.hypot(...along);
  const [x, y, z] = [0, 1, 2].map((k) => [from[k], to[k]]);
  const [u, v, w] = along.map((one) => [one / length]);
  return [
    { type: "scatter3d", mode: "lines", x, y, z, line: { color: colour, width: 6 }, hoverinfo: "skip" },
    { type: "cone", x: [to[0]], y: [to[1]], z: [to[2]], u, v, w, anchor: "tip", sizemode: "absolute", sizeref: TIP * Math.min(size, Math.max(length, size / 4)), showscale: false, colorscale: [[0, colour], [1, colour]], hoverinfo: "skip" },
  ];
}
