// The frame and the reference points of the readings of an import, with a picture of them.

import { profileChoice } from "./cycle_options.js";
import { el, field, put, select } from "./dom.js";
import { pointsOf, rigPicture } from "./rig_picture.js";

const AXES = ["x", "y", "z"];
const PLAIN = "x=x,y=y,z=z";

// `changed()` is called when one of them is another.
export function rigOptions(name, changed, signal) {
  const picture = el("div", { class: "stack", id: "rig-picture" });
  const input = (id, placeholder) => el("input", { id, placeholder, autocomplete: "off", spellcheck: "false", maxlength: 1000, oninput: () => draw(), onchange: changed });
  const frame = input("rig-frame", PLAIN), load = input("rig-load-point", "0,0,0"), moved = input("rig-displacement-point", "0,0,0");
  const parts = { frame, load_point: load, displacement_point: moved };
  const cell = select([["", "not specified"], ["moving", "moves with the interface"], ["fixed", "stays on the ground"]], "", changed);
  cell.id = "load-cell";
  const state = { toml: "" }, profile = profileChoice(name, () => { draw(); changed(); }, signal);
  const file = el("input", { type: "file", id: "rig-file", accept: ".toml", onchange: () => take(file.files[0]) });
  const remove = el("button", { type: "button", class: "small", hidden: true, onclick: () => { file.value = ""; take(null); } }, "Remove the file");
  const take = async (chosen) => {
    state.toml = chosen ? await chosen.text() : "";
    for (const one of [profile, ...Object.values(parts)]) one.disabled = Boolean(state.toml);
    remove.hidden = !state.toml;
    draw();
    changed();
  };
  const draw = () => put(picture, state.toml || profile.value ? el("p", { class: "muted small" }, "The rig of the profile is drawn once a table is checked.") : drawn(read(frame, load, moved)));
  const root = el("details", { id: "rig-options" }, el("summary", {}, "Rig: profile, frame and points of the readings"),
    el("div", { class: "halves" },
      el("div", { class: "stack" },
        field("Profile of the rig: columns, zero, frame and cycles of its files; what is set on this page wins", profile),
        el("p", { class: "muted small" }, "Leave these empty where loads and displacements are those of the interface’s point in its axes. Points are in metres, from the interface’s point, in the interface’s frame. They are applied after units and tare."),
        field("Where the rig’s axes point in the interface’s frame, such as x=-y,y=x,z=z, or nine numbers", frame),
        field("Load point: the point that moments are about, x,y,z in m", load),
        field("Displacement point: the point whose translation was measured, x,y,z in m", moved),
        field("Load cell: the point of the moments", cell),
        field("Or a profile as a file (TOML)", file), el("div", {}, remove)),
      picture));
  const tell = (asked) => {
    if (state.toml || profile.value) asked.set("rig", state.toml || profile.value);
    if (!state.toml) for (const [name, one] of Object.entries(parts)) if (one.value.trim()) asked.set(name, one.value.trim());
    if (cell.value) asked.set("load_cell", cell.value);
  };
  // `rig` of the reply of a check: what the server has read.
  const show = (rig) => { if ((state.toml || profile.value) && rig) put(picture, drawn({ rig })); };
  // The buttons that a finding of a lever offers; a point is added to the one that is given.
  const corrections = (lever) => {
    const one = (text, input, sign) => el("button", { type: "button", class: "small", onclick: () => {
      const before = numbers(input.value, 3) || [0, 0, 0];
      input.value = before.map((each, k) => Number((each + sign * lever[k]).toPrecision(4))).join(",");
      root.open = true;
      draw();
      changed();
    } }, text);
    return state.toml ? null : el("div", { class: "turn" }, one("Use as load point", load, -1), one("Use as displacement point", moved, 1));
  };
  draw();
  return { root, tell, show, corrections };
}

function drawn({ rig, problem }) {
  if (problem) return el("p", { class: "muted small" }, problem);
  const left = rig.left_handed ?? handed(rig.frame) < 0;
  const away = (at) => `${Number(Math.hypot(...at).toPrecision(3))} m from the interface’s point`;
  const marks = pointsOf(rig).map(([name, at]) => el("li", {}, el("i", { class: name === "load" ? "point" : "point square" }), `${name} point, ${away(at)}`));
  return [rigPicture(rig), marks.length ? el("ul", { class: "key-of-marks" }, marks) : null, el("p", { class: left ? "note thin" : "muted small" }, left ? "These axes are left-handed: moments and rotations change their sign." : "The rig’s axes are right-handed.")];
}

function read(frame, load, moved) {
  const axes = axesOf(frame.value), points = [load, moved].map((one) => (one.value.trim() ? numbers(one.value, 3) : [0, 0, 0]));
  if (!axes) return { problem: "Axes are written as x=-y,y=x,z=z: each axis of the rig along another one of the interface; or as nine numbers." };
  if (!points.every(Boolean)) return { problem: "Points are three numbers in metres, such as 0,0,0.05." };
  return { rig: { frame: axes, load_point: points[0], displacement_point: points[1] } };
}

function axesOf(text) {
  if (text.trim() && !text.includes("=")) {
    const nine = numbers(text, 9);
    return nine && Math.abs(Math.abs(handed(rows(nine))) - 1) < 0.01 ? rows(nine) : null;
  }
  const named = new Map((text.trim() || PLAIN).toLowerCase().split(",").map((one) => one.match(/^\s*([xyz])\s*=\s*([+-]?)\s*([xyz])\s*$/)).filter(Boolean).map((one) => [one[1], one]));
  if (named.size !== 3 || new Set([...named.values()].map((one) => one[3])).size !== 3) return null;
  return AXES.map((axis) => AXES.map((one) => (named.get(axis)[3] === one ? (named.get(axis)[2] === "-" ? -1 : 1) : 0)));
}

const rows = (nine) => [nine.slice(0, 3), nine.slice(3, 6), nine.slice(6)];

function numbers(text, count) {
  const found = text.trim().split(/[,;\s]+/).map(Number);
  return found.length === count && found.every(Number.isFinite) ? found : null;
}

// The determinant: 1 of right-handed axes, -1 of left-handed ones.
function handed([a, b, c]) {
  return a[0] * (b[1] * c[2] - b[2] * c[1]) - a[1] * (b[0] * c[2] - b[2] * c[0]) + a[2] * (b[0] * c[1] - b[1] * c[0]);
}
