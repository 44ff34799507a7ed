// Add a component: a bundle's zip, or a table without finite elements.

import { post, send, trouble } from "./api.js";
import { dropPlace, el, field, put, working } from "./dom.js";
import { facesIn } from "./faces.js";
import { sentence, symbol } from "./format.js";
import { snippet } from "./snippet.js";
import { zipped } from "./zip.js";

// A whole bundle: the server generates its mesh.
const EXAMPLE = `name = "cantilever"
title = "Steel bar, 0.5 m, clamped at one end"

[mesh]
generator = "bar"    # or file = "part.inp" and unit = "mm"
length = 0.5         # m
width = 0.02
height = 0.02

[[material]]
region = "all"
youngs_modulus = 210e9    # Pa
poisson_ratio = 0.3
density = 7850.0          # kg/m³

[supports]
fixed = ["start"]         # groups of the mesh

[interface]
section = "end"
coupling = "distributed"   # or "rigid"

[analysis]
nonlinear = true

[range]                   # largest loads, N and N·m
force = [1000, 100, 100]
moment = [20, 20, 20]

[tolerance]               # accepted error, m and rad
translation = 1e-4
rotation = 1e-3
`;

export async function show(root, _, signal) {
  document.title = "Add a component · wrenchbook";
  put(root,
    el("div", { class: "head" }, el("div", {}, el("span", { class: "crumb" }, el("a", { href: "#/" }, "Library"), " /"), el("h1", {}, "Add a component"))),
    el("div", { class: "halves" },
      el("section", { class: "card" }, el("h2", {}, "A bundle, with finite elements"),
        el("p", { class: "muted" }, "The zip of a folder with component.toml and its mesh: materials, supports, interface and load range. Without a mesh file, as with a generator, component.toml alone is enough. For the lines that name faces of the mesh, a component.toml with file and unit under [mesh] is enough: choose Show its faces."), bundle(root, signal), example()),
      el("section", { class: "card" }, el("h2", {}, "A table only"),
        el("p", { class: "muted" }, "For measured rows: the table answers from imported rows; nothing is solved."), tableOnly(signal))));
}

const goTo = (name) => { location.hash = `#/c/${encodeURIComponent(name)}`; };

function bundle(root, signal) {
  const state = el("div", { "aria-live": "polite" }), faces = el("div", { class: "stack" });
  const input = el("input", { type: "file", accept: ".zip,.toml", id: "bundle", required: true, "aria-label": "A bundle's zip, or a component.toml" });
  const choose = (file) => { // a dropped file, as if it had been chosen
    const files = new DataTransfer();
    if (file) files.items.add(file);
    input.files = files.files;
  };
  const add = async (event) => {
    event.preventDefault();
    const body = new FormData(), wantsFaces = event.submitter?.value === "faces";
    const [file] = input.files;
    put(faces);
    try {
      body.append("bundle", file.name.endsWith(".toml") ? await zipped(file, "component.toml") : file);
      put(state, working(wantsFaces ? "The mesh is read and its faces are numbered …" : "The bundle is checked: mesh, groups, supports …"));
      const reply = await (await send("POST", `v1/components${wantsFaces ? "?faces=true" : ""}`, { body, signal })).json();
      put(state);
      if (!wantsFaces) { goTo(reply.name); return; }
      root.append(faces);
      await facesIn(faces, reply, signal);
      faces.scrollIntoView({ block: "nearest" });
    } catch (error) { if (!signal.aborted) put(state, trouble(error)); }
  };
  return el("form", { class: "stack", onsubmit: add }, dropPlace(choose, el("strong", {}, "Drop a zip or a component.toml here, or choose it"), input),
    el("div", { class: "line" }, el("button", { class: "first" }, "Add the bundle"), el("button", { value: "faces" }, "Show its faces")), state);
}

function example() {
  const { root, say } = snippet("component.toml");
  say(EXAMPLE);
  return el("details", {}, el("summary", {}, "An example that works: save it as component.toml and drop it here"), root);
}

function tableOnly(signal) {
  const state = el("div", { "aria-live": "polite" });
  const wrong = el("span", { class: "note outside", id: "name-error", "aria-live": "polite", hidden: true });
  const name = el("input", { required: true, id: "new-name", autocomplete: "off", "aria-describedby": "name-rule name-error" });
  const mark = (message) => { // stands at the field until its name is changed
    wrong.hidden = !message;
    put(wrong, message);
    name.setAttribute("aria-invalid", String(Boolean(message)));
    if (message) name.focus();
  };
  name.addEventListener("input", () => mark(""));
  const title = el("input", { id: "new-title", autocomplete: "off" });
  const size = (label) => el("input", { type: "number", step: "any", min: 0, required: true, "aria-label": label });
  const force = ["x", "y", "z"].map((axis) => size(`Largest force ${axis}`)), moment = ["x", "y", "z"].map((axis) => size(`Largest moment ${axis}`));
  const add = async (event) => {
    event.preventDefault();
    put(state);
    const range = { force: force.map(({ value }) => Number(value)), moment: moment.map(({ value }) => Number(value)) };
    try {
      goTo((await post("v1/components", { name: name.value.trim(), title: title.value.trim() || name.value.trim(), range }, signal)).name);
    } catch (error) {
      if (signal.aborted) return;
      const { errors = [], type = "" } = error.body || {};
      const ofName = type.endsWith(":component-exists") ? error.message : errors.find(({ loc }) => loc === "name")?.msg;
      mark(ofName ? sentence(ofName) : "");
      if (!ofName || errors.length > 1) put(state, trouble(error)); // further mistakes are listed
    }
  };
  const three = (inputs, kind) => el("div", { class: "three" }, inputs.map((input, axis) => field(symbol(kind + "xyz"[axis]), input)));
  return el("form", { class: "stack", onsubmit: add },
    el("div", { class: "stack tight" }, field("Name", name), el("span", { class: "muted small", id: "name-rule" }, "1 to 64 characters: a-z, 0-9, _ and -; the first is a letter or digit"), wrong), field("Title", title),
    el("fieldset", {}, el("legend", {}, "Largest force in either direction, N"), three(force, "f")),
    el("fieldset", {}, el("legend", {}, "Largest moment in either direction, N·m"), three(moment, "m")),
    el("div", {}, el("button", { class: "first" }, "Add the table")), state);
}
