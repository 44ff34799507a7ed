// The numbered faces of a mesh, as `wrenchbook check --faces --plot` draws them: a click, or the list, gives a face's TOML.

import { get, of } from "./api.js";
import { el, field, put, select, working } from "./dom.js";
import { number } from "./format.js";
import { draw } from "./plot.js";
import { pressed } from "./pressed.js";
import { snippet } from "./snippet.js";
import { boxOf, extent } from "./surface.js";
import { figure as turning } from "./view3d.js";

export async function show(root, about, signal) {
  put(root, working("The mesh is read and its faces are numbered; this takes seconds …"));
  await facesIn(root, await get(`${of(about.name)}/faces`, signal), signal, about.mesh === "deck");
}

// Shows a reply of `/faces` in a place; the lines are for a component with [mesh], the faces may be a deck's.
export async function facesIn(root, { faces, figure }, signal, ofDeck = false) {
  let chosen = 0;
  const bodies = figure.data.filter((trace) => trace.type === "mesh3d").map(({ x, y, z }) => [x, y, z].map(decoded));
  const place = el("div", { class: "plot", id: "faces" });
  const view = turning(place, "Numbered faces"), lines = snippet("For component.toml");
  const group = el("input", { id: "faces-name", value: "NAME", pattern: "[A-Za-z0-9_\\-]+", autocomplete: "off", spellcheck: "false", oninput: () => choose(chosen) });
  const list = select(faces.map((one) => [one.number, described(one)]), null, (value) => choose(Number(value)));
  list.id = "face";
  const labels = figure.data.filter((trace) => trace.type !== "mesh3d"), apart = 0.05 * extent(labels.map(placeOf));
  const together = []; // labels at one place, as of a thin plate or of bores on one axis, are one text
  for (const label of [...labels].sort((a, b) => b.z[0] - a.z[0])) { // at the upper one: the camera begins above
    const near = together.find(([first]) => Math.hypot(...placeOf(first).map((x, k) => x - placeOf(label)[k])) < apart);
    if (near) near.push(label); else together.push([label]);
  }
  let drawing = null;
  const choose = (face) => {
    if (face !== chosen) { chosen = face; drawing?.again(); }
    list.value = String(face);
    lines.say(`[mesh.groups]\n${group.value || "NAME"} = ${faces.find((one) => one.number === face).toml}`);
  };
  put(root, el("section", { class: "card" }, el("h2", {}, "Faces of the mesh"),
    el("p", { class: "muted" }, ofDeck ? "Faces of the mesh in the deck, which solves this part with its own sets. The lines are for a component of the embedded solver with this mesh. Lengths in component.toml are in m."
      : "Click a face, or choose it in the list. Copy its lines into component.toml; supports and interfaces name the group. Lengths in component.toml are in m."),
    view.root, el("div", { class: "halves" }, field(`Face (1 to ${faces.length})`, list), field("Name of the group", group)), lines.root));
  choose(faces[0].number);
  drawing = await draw(place, (shade) => ({ data: figure.data.map((trace) => painted(trace, chosen, shade, together.find(([first]) => first === trace))), layout: { scene: sceneOf(place, view, bodies, labels) } }), signal, `${faces.length} numbered faces`);
  view.hold(drawing);
  pressed(place, (trace) => choose(numberOf(trace)));
}

const decoded = ({ bdata }) => new Float64Array(Uint8Array.from(atob(bdata), (one) => one.charCodeAt(0)).buffer); // as plotly packs arrays
const placeOf = (trace) => [trace.x[0], trace.y[0], trace.z[0]]; // of a label
const numberOf = (trace) => Number.parseInt(trace.name, 10);

// The chosen face in the colour of links, the others pale; numbers in the colour of text.
function painted(trace, chosen, shade, labels = []) {
  const here = numberOf(trace) === chosen;
  if (trace.type !== "mesh3d") return { ...trace, text: [labels.map(numberOf).sort((a, b) => a - b).join(", ")], textposition: "top center", textfont: { color: shade.ink, size: 13 } };
  return { ...trace, color: here ? shade.accent : shade.part, flatshading: false, lighting: { ambient: 0.7, diffuse: 0.5, specular: 0.05 } };
}

function sceneOf(place, view, bodies, labels) {
  const box = boxOf([...bodies.flatMap(([x, y, z]) => Array.from(x, (one, k) => [one, y[k], z[k]])), ...labels.map(placeOf)]);
  place.fit = { box };
  const isFlat = (name) => box[name] < 0.1; // too short for ticks and a title
  const axis = (name) => ({ title: { text: isFlat(name) ? "" : `${name}, mm` }, nticks: 5, showticklabels: !isFlat(name) });
  return { xaxis: axis("x"), yaxis: axis("y"), zaxis: axis("z"), aspectmode: "manual", aspectratio: box, camera: view.camera() };
}

function described({ number: face, kind, area, radius }) {
  return `${face}: ${kind.toLowerCase()}${radius ? `, radius ${number(1e3 * radius, 4)} mm` : ""}, ${number(1e6 * area, 4)} mm²`;
}
