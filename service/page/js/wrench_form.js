// Six loads to type, kept for the component while the tab is open.

import { el, id } from "./dom.js";
import { LOADS, number, symbol, unitOfLoad } from "./format.js";

const kept = (name) => `wrenchbook-wrench-${name}`;

export function lastWrench(about) {
  try {
    const found = JSON.parse(sessionStorage.getItem(kept(about.name)));
    if (Array.isArray(found) && found.length === 6 && found.every(Number.isFinite)) return found;
  } catch { /* what is kept is not ours: start anew */ }
  return usual(about);
}

// A load that tells something: the largest force downwards, half of it.
function usual(about) {
  const spans = [...about.range.force, ...about.range.moment];
  const strongest = [2, 1, 0].find((place) => spans[place][0] < 0) ?? 2;
  return spans.map((span, place) => (place === strongest ? Number((span[0] / 2).toPrecision(3)) || span[1] / 2 : 0));
}

// `asked(wrench)` is called on submit, `changed(wrench)` at each edit.
export function wrenchForm(about, { action, asked, changed, more = [] }) {
  const start = lastWrench(about);
  const spans = [...about.range.force, ...about.range.moment];
  const inputs = LOADS.map((load, place) => el("input", {
    type: "number", step: "any", required: true, value: String(start[place]), name: load, id: id(load),
    "aria-label": `${load} in ${unitOfLoad(load)}`,
    title: `${number(spans[place][0])} to ${number(spans[place][1])} ${unitOfLoad(load)}`,
    oninput: () => changed?.(read()),
  }));
  const read = () => inputs.map((input) => (input.value === "" ? NaN : Number(input.value)));
  const group = (text, from) => el("fieldset", {},
    el("legend", {}, text),
    el("div", { class: "three" }, [0, 1, 2].map((place) =>
      el("label", {}, symbol(LOADS[from + place]), inputs[from + place]))));
  const form = el("form", {
    class: "stack",
    onsubmit: (event) => {
      event.preventDefault();
      const wrench = read();
      sessionStorage.setItem(kept(about.name), JSON.stringify(wrench));
      asked(wrench);
    },
  }, group("Force, N", 0), group("Moment, N·m", 3), more,
    el("div", {}, el("button", { class: "first" }, action)));
  return { form, read, inputs };
}
