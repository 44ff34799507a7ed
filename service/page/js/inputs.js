// The inputs and outputs of a component: loads of each interface, then further ones, by name.

import { LOADS, OUTPUTS, number, plain, symbol, unitOfLoad, wrench } from "./format.js";

const ONE = LOADS.map((name) => ({ name, unit: unitOfLoad(name), kind: name.startsWith("f") ? "force" : "moment" }));
const IS_AXIS = /^[fmur][xyz]$/;

export const inputsOf = (about) => about.space?.inputs || ONE;
export const outputsOf = (about) => about.space?.outputs.map((one) => one.name) || OUTPUTS;

// Smallest and largest value of each input.
export function spansOf({ range }) {
  const loads = range.loads ? Object.values(range.loads) : [range];
  return [...loads.flatMap((one) => [...one.force, ...one.moment]), ...Object.values(range.inputs || {})];
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

// The inputs of a request or a job as a line of text.
export function said({ loads, force, moment, inputs }) {
  const parts = Object.entries(loads || {}).map(([name, load]) => `${name}: ${wrench(load.force, load.moment)}`);
  if (force) parts.push(wrench(force, moment));
  return [...parts, ...Object.entries(inputs || {}).map(([name, value]) => `${name} ${number(value)}`)].join("; ");
}

// F_x, or left F_x, or temperature.
export function mark(name) {
  const [last, front] = name.split(".").reverse();
  return IS_AXIS.test(last) ? [front ? `${front} ` : null, symbol(last)] : name;
}

export const label = (name) => (IS_AXIS.test(name) ? plain(name) : name);
