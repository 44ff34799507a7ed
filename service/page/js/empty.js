// What a view shows of a table without rows, with the button that ends it.

import { of, post } from "./api.js";
import { el, notify } from "./dom.js";
import { count } from "./format.js";

const FIRST = 24; // solves: what the overview's form proposes

// `what` is why the view is empty.
export function emptyTable(about, what = "The table has no rows yet.") {
  if (about.pending_rows) return empty(`${beingBuilt(about.pending_rows)}: the table answers from them soon.`);
  return empty(what, about.has_fea ? fillButton(about) : linkTo(about, "table", "Import rows"));
}

export const beingBuilt = (rows) => (rows === 1 ? "1 row is being built" : `${count(rows)} rows are being built`);

export function empty(what, ...actions) {
  return el("div", { class: "empty line" }, el("span", {}, what), ...actions);
}

export function linkTo(about, view, text) {
  return el("a", { class: "button", href: `#/c/${encodeURIComponent(about.name)}/${view}` }, text);
}

function fillButton(about) {
  const fill = async () => {
    try {
      const reply = await post(`${of(about.name)}/fill`, { budget: FIRST });
      notify(reply.jobs.length ? `${reply.jobs.length} solves are queued. ${reply.reason || ""}` : reply.reason || "Nothing to solve.");
      location.hash = `#/c/${encodeURIComponent(about.name)}/jobs`;
    } catch (error) { notify(error.message, "wrong"); }
  };
  return el("button", { type: "button", class: "first", onclick: fill }, "Fill the table");
}
