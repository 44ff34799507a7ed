// What part of the load range is covered, thin and outside, as a bar with its figure.

import { el } from "./dom.js";
import { quantity } from "./format.js";
import { axesOf, outputsOf } from "./inputs.js";

const NAMES = ["covered", "thin", "outside"];
const WHOLE = ["within the tolerance", "over it or not known", "outside"];

// A covered answer without some output or error bar cannot be compared with the tolerance.
export const namesOf = (glance) => (glance.within_tolerance === null ? NAMES : WHOLE);

const IS_TRANSLATION = /(^|\.)u[xyz]$/;

export function sharesBar(shares, names = NAMES) {
  const said = names.map((name, place) => `${Math.round(100 * shares[place])} % ${name}`).join(", ");
  const parts = NAMES.map((_, place) => {
    const part = el("i", { class: NAMES[place] });
    part.style.flex = String(shares[place]);
    return shares[place] > 0 ? part : null;
  });
  return el("span", { class: "bar", role: "img", "aria-label": said, title: said }, parts);
}

// The colours of the bars.
export const legend = (names = NAMES) => el("p", { class: "legend muted small" }, NAMES.map((kind, place) => el("span", {}, el("i", { class: kind }), ` ${names[place]}`)));

export function sharesOf(glance, about) {
  const axes = Object.entries(glance.axes).filter(([axis]) => about.space || axesOf(about).includes(axis)); // others have nothing to cover
  const lines = [["all loads", glance.whole], ...axes.map(([axis, shares]) => [`axis ${axis}`, shares])];
  return el("div", { class: "shares" }, lines.map(([name, shares]) => [
    el("span", {}, name), sharesBar(shares), el("span", {}, `${Math.round(100 * shares[0])} %`),
  ]));
}

// What the rest of an error bar is, after interpolation: a linear analysis errs too, and so does a rig.
export const solverError = (about) => (!about.has_fea ? "hysteresis and drift" : about.linear ? "discretisation and linearity" : "discretisation");

// The interpolation error of measured rows contains their noise.
export const tableError = (about) => (about.has_fea ? "interpolation" : "interpolation and noise");

// Why an error bar exceeds the tolerance, and whether more solves help; `rest` is the bar without interpolation, over the tolerance.
export const overTolerance = (about, rest) => (rest > 1 ? `An error bar exceeds the tolerance because of ${solverError(about)}. ${about.has_fea ? "More solves do not help; the component's overview says what does." : "Only readings with less of them lower it."}`
  : `An error bar exceeds the tolerance by ${tableError(about)} and ${solverError(about)} together. Rows near this wrench lower the first.`);

// The solves of a component that have not ended: "3 waiting, 2 running".
export const openJobs = ({ jobs = {} }) => ["waiting", "running"].filter((status) => jobs[status]).map((status) => `${jobs[status]} ${status}`).join(", ");
export const isAtWork = (about) => openJobs(about) !== "";

// The share of the load range whose whole error bar is within the tolerance, and that bar's parts.
export function wholeError(glance, about) {
  const outputs = outputsOf(about);
  const [covered, , outside] = glance.whole, within = glance.within_tolerance ?? covered;
  const known = !about.has_fea || glance.bars_are_whole, errors = glance.error.map((one, place) => (IS_TRANSLATION.test(outputs[place]) ? one : 0));
  const k = errors.reduce((best, one, place) => ((one ?? 0) > (errors[best] ?? 0) ? place : best), 0);
  const exactly = (value) => quantity(value, "m", 2);
  const bar = (value) => (value > 0 && value < errors[k] / 1000 ? "negligible" : exactly(value));
  if (errors[k] === null && !within) {
    return el("div", { class: "stack tight" }, el("div", { class: "shares" }, el("span", {}, "within tolerance"), el("span", { class: "bar" }), el("span", {}, "–")),
      el("span", { class: "muted small" }, "Not known: the rows are too few for an error bar. ", isAtWork(about) ? [el("a", { href: `#/c/${encodeURIComponent(about.name)}/jobs` }, openJobs(about)), ": the bar is shown after them."] : about.has_fea ? "Fill the table." : "Import more rows."));
  }
  const rest = Math.max(0, errors[k] - glance.interpolation[k]);
  const parts = known ? [`${tableError(about)} ${bar(glance.interpolation[k])}`, ...(rest > 0 || about.has_fea ? [`${solverError(about)} ${bar(rest)}`] : [])].join(" + ")
      : "interpolation; the discretisation error is not known";
  return el("div", { class: "stack tight" },
    el("div", { class: "shares" }, el("span", {}, glance.within_tolerance === null ? "covered" : "within tolerance"), sharesBar([within, Math.max(0, 1 - within - outside), outside], namesOf(glance)), el("span", {}, `${Math.round(100 * within)} %`)),
    errors[k] === null ? el("span", { class: "muted small" }, "The error bar is not known for half of the load range or more, most often beyond the rows.") : el("span", { class: "muted small" }, `Median error bar ± ${bar(errors[k])}: ${parts}${about.tolerance ? `; tolerance ${exactly(about.tolerance.translation)}` : ""}`));
}
