// The rig's profile of an import, remembered by component, and the cycles of its main load.

import { get } from "./api.js";
import { el, field, select } from "./dom.js";

const REMEMBERED = "wrenchbook-rig-";

// `changed()` is called when another profile is chosen.
export function profileChoice(name, changed, signal) {
  const key = REMEMBERED + name, last = localStorage.getItem(key) || "";
  const chosen = select([["", "none"], ...(last ? [[last, last]] : [])], last, (value) => {
    if (value) localStorage.setItem(key, value);
    else localStorage.removeItem(key);
    changed();
  });
  chosen.id = "rig-profile";
  get("v1/rigs", signal).then(({ rigs }) => {
    const now = rigs.some((one) => one.name === chosen.value) ? chosen.value : "";
    chosen.replaceChildren(...["", ...rigs].map((one) => el("option", { value: one && one.name, title: one && one.title, selected: (one && one.name) === now },
      one ? `${one.name}${one.origin === "shipped" ? " (shipped)" : ""}` : "none")));
    if (last && !now) { localStorage.removeItem(key); changed(); } // it was removed on the server
  }).catch(() => {}); // an import without a profile needs no list
  return chosen;
}

export function cycleOptions(changed) {
  const skip = el("input", { type: "number", min: 0, step: 1, value: 0, onchange: changed, id: "skip-cycles" });
  const branch = select([["", "both"], ["loading", "loading"], ["unloading", "unloading"]], "", changed);
  branch.id = "branch";
  const thin = el("input", { type: "number", min: 0, max: 0.5, step: "any", placeholder: "every row", onchange: changed, id: "thin" });
  const mean = el("input", { type: "checkbox", onchange: changed, id: "mean-cycles" });
  const root = el("details", { id: "cycle-options" }, el("summary", {}, "Cycles of the main load"),
    el("div", { class: "stack" },
      el("div", { class: "few" }, field("First cycles to leave out", skip), field("Branch to load", branch),
        field("Rows within this part of the load range become their mean, such as 0.02", thin)),
      el("label", { class: "check" }, mean, "Repeated cycles become their mean, with its 95 % half width as uncertainty")));
  const tell = (asked) => {
    if (Number(skip.value) > 0) asked.set("skip_cycles", skip.value);
    if (branch.value) asked.set("branch", branch.value);
    if (thin.value.trim()) asked.set("thin", thin.value.trim());
    if (mean.checked) asked.set("mean_cycles", "true");
  };
  return { root, tell };
}
