// The numbered faces of a mesh, as `wrenchbook check --faces --plot` draws them: a click, or the list, gives a face's TOML.

import { get, of } from "./api.js";
import { el, field, put, select } from "./dom.js";
import { number } from "./format.js";
import { draw } from "./plot.js";
import { snippet } from "./snippet.js";
import { figure as turning } from "./view3d.js";

export async function show(root, about, signal) {
  put(root, el("p", { class: "muted" }, "The faces are read from the mesh …"));
  await facesIn(root, await get(`${of(about.name)}/faces`, signal), signal);
}

// Shows a reply of `/faces` in a place.
export async function facesIn(root, { faces, figure }, signal) {
  let chosen = 0;
  const place = el("div", { class: "plot", id: "faces" });
  const view = turning(place, "Numbered faces"), lines = snippet("For component.toml");
  const group = el("input", { value: "NAME", pattern: "[A-Za-z0-9_\\-]+", autocomplete: "off", spellcheck: "false", oninput: () => choose(chosen) });
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
    view.root, el("div", { class: "few" }, field(`Face, of ${faces.length}`, list), field("Name of the group", group)), lines.root));
  choose(faces[0].number);
  drawing = await draw(place, (shade) => ({ data: figure.data.map((trace) => painted(trace, chosen, shade)), layout: { scene: sceneOf(view) } }), signal, `${faces.length} numbered faces`);
  view.hold(drawing);
  place.on("plotly_click", ({ points }) => choose(numberOf(points[0].data)));
}

const numberOf = (trace) => Number.parseInt(trace.name, 10);

// The chosen face in the colour of links, the others pale; numbers in the colour of text.
function painted(trace, chosen, shade) {
  const here = numberOf(trace) === chosen;
  if (trace.type !== "mesh3d") return { ...trace, textfont: { color: shade.ink, size: here ? 18 : 13 } };
  return { ...trace, color: here ? shade.accent : shade.muted, flatshading: true, lighting: { ambient: 0.6, diffuse: 0.6, specular: 0.05 } };
}

function sceneOf(view) {
  const axis = (name) => ({ title: { text: `${name}, mm` }, nticks: 5 });
  return { xaxis: axis("x"), yaxis: axis("y"), zaxis: axis("z"), aspectmode: "data", camera: view.camera() };
}

function described({ number: face, kind, area, radius }) {
  return `${face}: ${kind.toLowerCase()}${radius ? `, radius ${number(1e3 * radius, 4)} mm` : ""}, ${number(1e6 * area, 4)} mm²`;
}
