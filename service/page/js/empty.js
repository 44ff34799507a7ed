// What a view shows of a table without rows, with the button that ends it.

import { el } from "./dom.js";
import { count } from "./format.js";

// `what` is why the view is empty.
export function emptyTable(about, what = "The table has no rows yet.") {
  if (about.pending_rows) return empty(`${beingBuilt(about.pending_rows)}: the table answers from them soon.`);
  return empty(what, about.has_fea ? linkTo(about, "overview?fill", "Go to Fill the table") : linkTo(about, "table", "Import rows"));
}

export const beingBuilt = (rows) => (rows === 1 ? "1 row is being built" : `${count(rows)} rows are being built`);

export function empty(what, ...actions) {
  return el("div", { class: "empty line" }, el("span", {}, what), ...actions);
}

export function linkTo(about, view, text) {
  return el("a", { class: "button", href: `#/c/${encodeURIComponent(about.name)}/${view}` }, text);
}
