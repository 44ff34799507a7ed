// The numbered faces of a mesh, as `wrenchbook check --faces --plot` draws them: a click, or the list, gives a face's TOML.

import { get, of } from "./api.js";
import { el, field, put, select } from "./dom.js";
import { number } from "./format.js";
import { draw } from "./plot.js";
import { snippet } from "./snippet.js";
import { awayFrom } from "./surface.js";
import { figure as turning } from "./view3d.js";

export async function show(root, about, signal) {
  put(root, el("p", { class: "muted" }, "The faces are read from the mesh …"));
  await facesIn(root, await get(`${of(about.name)}/faces`, signal), signal);
}

// Shows a reply of `/faces` in a place.
export async function facesIn(root, { faces, figure }, signal) {
  let chosen = 0;
  const bodies = figure.data.filter((trace) => trace.type === "mesh3d").map(({ x, y, z }) => [x, y, z].map(decoded));
  const place = el("div", { class: "plot", id: "faces", "data-away": 1.1 * awayFrom(bodies.flatMap(([x, y, z]) => Array.from(x, (one, k) => [one, y[k], z[k]]))) });
  const view = turning(place, "Numbered faces"), lines = snippet("For component.toml");
  const group = el("input", { id: "faces-name", value: "NAME", pattern: "[A-Za-z0-9_\\-]+", autocomplete: "off", spellcheck: "false", oninput: () => choose(chosen) });
  const list = select(faces.map((one) => [one.number, described(one)]), null, (value) => choose(Number(value)));
  list.id = "face";
  let drawing = null;
  const choose = (face) => {
    if (face !== chosen) { chosen = face; drawing?.again(); }
    list.value = String(face);
    lines.say(`[mesh.groups]\n${group.value || "NAME"} = ${faces.find((one) => one.number === face).toml}`);
  };
  put(root, el("section", { class: "card" },
    el("p", { class: "muted" }, "Click a face, or choose it in the list. Copy its lines into component.toml; supports and interfaces name the group. Lengths are in m."),
    view.root, el("div", { class: "halves" }, field(`Face, of ${faces.length}`, list), field("Name of the group", group)), lines.root));
  choose(faces[0].number);
  drawing = await draw(place, (shade) => ({ data: figure.data.map((trace) => painted(trace, chosen, shade)), layout: { scene: sceneOf(view) } }), signal, `${faces.length} numbered faces`);
  view.hold(drawing);
  pressed(place, choose);
}

// Calls `choose` with the face under a press that does not turn the part. (plotly_click comes only if a frame falls into the press.)
function pressed(place, choose) {
  let over = null, from = null;
  place.on("plotly_hover", ({ points }) => { over = numberOf(points[0].data); });
  place.on("plotly_unhover", () => { over = null; });
  place.addEventListener("pointerdown", ({ clientX, clientY }) => { from = [clientX, clientY]; }, true);
  place.addEventListener("click", ({ clientX, clientY }) => {
    if (from && Math.hypot(clientX - from[0], clientY - from[1]) < STILL) setTimeout(() => { if (over) choose(over); }, FRAME_MS);
  }, true);
}

const decoded = ({ bdata }) => new Float64Array(Uint8Array.from(atob(bdata), (one) => one.charCodeAt(0)).buffer); // as plotly packs arrays
const numberOf = (trace) => Number.parseInt(trace.name, 10);

const STILL = 5; // px: a press that moves farther turns the part
const FRAME_MS = 100; // after a touch plotly has found the face by then
// The chosen face in the colour of links, the others pale; numbers in the colour of text.
function painted(trace, chosen, shade) {
  const here = numberOf(trace) === chosen;
  if (trace.type !== "mesh3d") return { ...trace, textfont: { color: shade.ink, size: here ? 18 : 13 } };
  return { ...trace, color: here ? shade.accent : shade.part, flatshading: false, lighting: { ambient: 0.7, diffuse: 0.5, specular: 0.05 } };
}

function sceneOf(view) {
  const axis = (name) => ({ title: { text: `${name}, mm` }, nticks: 5 });
  return { xaxis: axis("x"), yaxis: axis("y"), zaxis: axis("z"), aspectmode: "data", camera: view.camera() };
}

function described({ number: face, kind, area, radius }) {
  return `${face}: ${kind.toLowerCase()}${radius ? `, radius ${number(1e3 * radius, 4)} mm` : ""}, ${number(1e6 * area, 4)} mm²`;
}
