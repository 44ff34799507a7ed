// The inputs of a component to type, kept for the component while the tab is open.

import { el, id } from "./dom.js";
import { number } from "./format.js";
import { inputsOf, mark, spansOf } from "./inputs.js";

const A_WRENCH = 6;

const kept = (name) => `wrenchbook-wrench-${name}`;
export const keepWrench = (name, wrench) => sessionStorage.setItem(kept(name), JSON.stringify(wrench));

export function lastWrench(about) {
  try {
    const found = JSON.parse(sessionStorage.getItem(kept(about.name)));
    if (Array.isArray(found) && found.length === inputsOf(about).length && found.every(Number.isFinite)) return found;
  } catch { /* what is kept is not ours: start anew */ }
  return usual(about);
}

// A load that tells something: the largest force downwards, half of it.
function usual(about) {
  const spans = spansOf(about), inputs = inputsOf(about);
  const loaded = Math.max(0, spans.findIndex(([low, high]) => low < high)), first = loaded - (loaded % A_WRENCH);
  const strongest = [2, 1, 0].map((k) => first + k).find((place) => spans[place]?.[0] < 0) ?? first + 2;
  return spans.map((span, place) => (place === strongest ? Number((span[0] / 2).toPrecision(3)) || span[1] / 2 : inputs[place].zero || 0));
}

// `asked(wrench)` is called on submit, `changed(wrench)` at each edit.
export function wrenchForm(about, { action, asked, changed, more = [] }) {
  const start = lastWrench(about);
  const spans = spansOf(about), known = inputsOf(about);
  const inputs = known.map(({ name, unit }, place) => el("input", {
    type: "number", step: "any", required: true, value: String(start[place]), name, id: id(name),
    "aria-label": `${name} in ${unit}`,
    title: `${number(spans[place][0])} to ${number(spans[place][1])} ${unit}`,
    oninput: (event) => { mind(event.target, place); changed?.(read()); },
  }));
  // A load beyond its range is marked as it is typed: its answer is extrapolated.
  const mind = (input, place) => {
    const [low, high] = spans[place], value = Number(input.value);
    input.classList.toggle("beyond", value < low || value > high);
  };
  inputs.forEach(mind);
  const read = () => inputs.map((input) => (input.value === "" ? NaN : Number(input.value)));
  const rangeOf = ([low, high]) => (low === high ? "" : `${number(low)} to ${number(high)}`);
  const labelled = (places) => el("div", { class: known[places[0]].kind === "scalar" ? "stack tight" : "three" }, places.map((place) =>
    el("label", {}, known[place].kind === "scalar" ? `${known[place].name}, ${known[place].unit} (${number(spans[place][0])} to ${number(spans[place][1])})` : el("span", {}, mark(known[place].name.split(".").at(-1)), el("span", { class: "range" }, rangeOf(spans[place]))), inputs[place])));
  const groups = [];
  known.forEach((one, place) => {
    const title = one.kind === "scalar" ? "Further inputs" : `${one.kind[0].toUpperCase() + one.kind.slice(1)}${one.interface ? ` at ${one.interface}` : ""}, ${one.unit}`;
    if (groups.at(-1)?.title === title) groups.at(-1).places.push(place); else groups.push({ title, places: [place], own: one });
  });
  const idle = ({ places }) => about.space && places.every((place) => spans[place].every((end) => !end));
  const unloaded = [...new Set(groups.filter(idle).map(({ own }) => own.interface))].filter((name) => groups.every((one) => one.own.interface !== name || idle(one)));
  const shown = groups.filter((one) => !idle(one)).map(({ title, places }) => el("fieldset", {}, el("legend", {}, title), labelled(places)));
  const form = el("form", {
    class: "stack",
    onsubmit: (event) => {
      event.preventDefault();
      const wrench = read();
      keepWrench(about.name, wrench);
      asked(wrench);
    },
  }, shown, unloaded.length ? el("p", { class: "muted small" }, `No loads at ${unloaded.join(", ")}: the range there is 0.`) : null, more,
    el("div", {}, el("button", { class: "first" }, action)));
  return { form, read, inputs };
}
