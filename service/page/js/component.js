// One component: its heading, and a tab for each thing to do with it. Measured ones have no solves.

import { get, listed, of } from "./api.js";
import { el, pill, put } from "./dom.js";
import { trouble } from "./api.js";

const BUILDING_MS = 3000; // between tries of a table that is being built
const TABS = [
  ["overview", "Overview", "overview.js"],
  ["query", "Query", "query.js"],
  ["shape", "Shape", "shape.js", "solved"],
  ["rows", "Rows", "rows.js"],
  ["response", "Response", "response.js"],
  ["checks", "Checks", "checks.js"],
  ["report", "Report", "report.js", "solved"],
  ["jobs", "Jobs", "component_jobs.js", "solved"],
  ["table", "Import & export", "table.js"],
  ["demand", "Demand", "demand.js"],
  ["entry", "Entry", "entry.js"],
];

export async function show(root, [name, tab = "overview"], signal) {
  // The library's entry is told at once; all there is to say of a large table takes seconds.
  const { components } = await listed(signal);
  const about = components.find((one) => one.name === name) || await get(of(name), signal);
  const there = TABS.filter(([, , , needs]) => !needs || about.has_fea);
  const [chosenTab, text, file] = there.find(([one]) => one === tab) || there[0];
  document.title = `${name}: ${text} · wrenchbook`;
  const body = el("div", { class: "stack" }), byTab = document.activeElement?.closest(".tabs");
  put(root,
    el("div", { class: "head" },
      el("div", {},
        el("span", { class: "crumb" }, el("a", { href: "#/" }, "Library"), " /"),
        el("h1", {}, name),
        el("p", { class: "muted" }, about.title)),
      el("div", { class: "line" }, awayPill(about.archived), pill(about.has_fea ? (about.linear ? "linear" : "finite elements") : "measured", ""))),
    tabs(name, chosenTab, there),
    body);
  const chosen = document.querySelector(".tabs [aria-current]");
  chosen?.scrollIntoView({ block: "nearest", inline: "center" });
  if (byTab) chosen?.focus({ preventScroll: true });
  try {
    const part = await import(`./${file}`);
    if (!signal.aborted) await part.show(body, about, signal);
  } catch (error) {
    if (signal.aborted) return;
    put(body, trouble(error));
    if (error.status === 503) setTimeout(() => { if (!signal.aborted) show(root, [name, tab], signal); }, BUILDING_MS);
  }
}

function awayPill(archived) {
  const made = pill("archived", "thin");
  made.id = "away";
  made.hidden = !archived;
  return made;
}

function tabs(name, chosen, there) {
  const links = there.map(([one, text]) => el("a", {
    href: `#/c/${encodeURIComponent(name)}/${one}`, "aria-current": one === chosen ? "page" : null,
  }, text));
  return el("nav", { class: "tabs", "aria-label": `Views of ${name}` }, links);
}
