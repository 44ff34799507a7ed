// The inputs and outputs of a component: loads of each interface, then further ones, by name.

import { get, of } from "./api.js";
import { LOADS, OUTPUTS, number, plain, symbol, unitOfLoad, wrench } from "./format.js";

const ONE = LOADS.map((name) => ({ name, unit: unitOfLoad(name), kind: name.startsWith("f") ? "force" : "moment" }));
const IS_AXIS = /^[fmur][xyz]$/;

const UNITS = { degC: "°C", "m/s^2": "m/s²" };

export const inputsOf = (about) => about.space?.inputs.map((one) => ({ ...one, unit: UNITS[one.unit] || one.unit })) || ONE;
export const outputsOf = (about) => about.space?.outputs.map((one) => one.name) || OUTPUTS;

// Smallest and largest value of each input.
export function spansOf({ range }) {
  const loads = range.loads ? Object.values(range.loads) : [range];
  return [...loads.flatMap((one) => [...one.force, ...one.moment]), ...Object.values(range.inputs || {})];
}

// The loads of a component with one interface whose range is not 0; all six of a range without any.
export function loadsOf(about) {
  const loads = LOADS.filter((_, place) => spansOf(about)[place].some((end) => end));
  return loads.length ? loads : LOADS;
}

export const AXES = { x: ["fx", "my", "mz"], y: ["fy", "mz", "mx"], z: ["fz", "mx", "my"] };

// The axes of which a load has a range.
export const axesOf = (about) => Object.keys(AXES).filter((axis) => AXES[axis].some((load) => loadsOf(about).includes(load)));

// The inputs beyond the load range in a sentence; empty if there are none.
export function beyondRange(about, values) {
  const spans = spansOf(about);
  const outside = inputsOf(about).flatMap(({ name, unit, zero = 0 }, place) => {
    const [low, high] = spans[place], value = values[place];
    const slack = 1e-9 * Math.max(Math.abs(low), Math.abs(high));
    const isBeyond = value < Math.min(low, zero) - slack || value > Math.max(high, zero) + slack;
    if (!isBeyond) return [];
    return [`${label(name)} = ${number(value, 12)} ${unit} is outside the load range, ${number(low)} to ${number(high)} ${unit}.`];
  });
  return outside.join(" ");
}

// What a row there is called, in all views: it answers only its own wrench.
export const OUTSIDE = "outside the range, not used";

// How many times the load range the largest load is; a load on a side where the range is 0 does not count.
export function timesRange(about, values) {
  const times = spansOf(about).map(([low, high], place) => {
    const value = values[place];
    return value / (value < 0 ? Math.min(low, 0) : Math.max(high, 0));
  });
  return Math.max(0, ...times.filter(Number.isFinite));
}

// The values of a job, in the order of the inputs.
export function valuesOf(about, { loads, force, moment, inputs = {} }) {
  return inputsOf(about).map(({ name, kind, interface: at }, place) => {
    if (kind === "scalar") return inputs[name];
    return (at ? loads[at] : { force, moment })[kind][place % 3];
  });
}

// One value an input, in their order, as requests name them.
export function named(about, values) {
  const loads = {}, further = {};
  inputsOf(about).forEach((one, place) => {
    if (one.kind === "scalar") further[one.name] = values[place];
    else (loads[one.interface || ""] ??= { force: [], moment: [] })[one.kind].push(values[place]);
  });
  const wrenches = about.range.loads ? { loads } : loads[""];
  return Object.keys(further).length ? { ...wrenches, inputs: further } : wrenches;
}

// The inputs of a request or a job as a line of text; the units of further inputs are the component's.
export function inputsText({ loads, force, moment, inputs }, about = {}, digits = 5) {
  const parts = Object.entries(loads || {}).map(([name, load]) => {
    const isLoaded = [...load.force, ...load.moment].some((value) => value);
    return `${name}: ${isLoaded ? wrench(load.force, load.moment, digits) : "no load"}`;
  });
  if (force) parts.push(wrench(force, moment, digits));
  const unit = (name) => inputsOf(about).find((input) => input.name === name)?.unit || "";
  const further = Object.entries(inputs || {}).map(([name, value]) => `${name} ${number(value, digits)}\u00a0${unit(name)}`.trim());
  return [...parts, ...further].join("; ");
}

const requests = new Map(); // of components by name, for their units

// The inputs of a job as an element, which requests the component once if a unit is missing.
export function inputsElement(job) {
  const element = document.createElement("span");
  element.textContent = inputsText(job);
  if (!job.inputs) return element;
  if (!requests.has(job.component)) {
    const failed = () => { requests.delete(job.component); return {}; }; // the next job requests it again
    requests.set(job.component, get(of(job.component)).catch(failed));
  }
  requests.get(job.component).then((about) => { element.textContent = inputsText(job, about); });
  return element;
}

// F_x, or left F_x, or temperature.
export function mark(name) {
  const [last, front] = name.split(".").reverse();
  return IS_AXIS.test(last) ? [front ? `${front} ` : null, symbol(last)] : name;
}

export function label(name) {
  const [last, front] = name.split(".").reverse();
  return IS_AXIS.test(last) ? `${front ? `${front} ` : ""}${plain(last)}` : name;
}
