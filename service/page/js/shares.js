// What part of the load range is covered, thin and outside, as a bar with its figure.

import { el } from "./dom.js";

const NAMES = ["covered", "thin", "outside"];

export function sharesBar(shares) {
  const said = NAMES.map((name, place) => `${Math.round(100 * shares[place])} % ${name}`).join(", ");
  const parts = NAMES.map((name, place) => {
    const part = el("i", { class: name });
    part.style.flex = String(shares[place]);
    return shares[place] > 0 ? part : null;
  });
  return el("span", { class: "bar", role: "img", "aria-label": said, title: said }, parts);
}

export function sharesOf(glance, withAxes = true) {
  const lines = [["all loads", glance.whole]];
  if (withAxes) lines.push(...Object.entries(glance.axes).map(([axis, shares]) => [`axis ${axis}`, shares]));
  return el("div", { class: "shares" }, lines.map(([name, shares]) => [
    el("span", {}, name), sharesBar(shares), el("span", {}, `${Math.round(100 * shares[0])} %`),
  ]));
}
