// One component: its heading, its views in at most six groups, and the view. Measured ones have no solves.

import { get, listed, of } from "./api.js";
import { el, note, pill, put } from "./dom.js";
import { listenToTable } from "./events.js";
import { titleOf } from "./format.js";
import { trouble } from "./api.js";

const BUILDING_MS = 3000; // between tries of a table that is being built
// Views that new rows make stale, and that do not follow them on their own.
const FOLLOW = ["shape", "coverage", "response", "checks", "compare"];
// Views of one wrench at one interface, without further inputs.
const OF_ONE = ["shape", "coverage", "response", "checks", "compare", "report", "demand"];
// View, its name, file, group, and what the component needs for it.
const TABS = [
  ["overview", "Overview", "overview.js"],
  ["query", "Query", "query.js", "Query"],
  ["response", "Response", "response.js", "Query"],
  ["shape", "Shape", "shape.js", "Query", "has_fea"],
  ["rows", "Rows", "rows.js", "Table"],
  ["coverage", "Coverage", "coverage.js", "Table"],
  ["checks", "Checks", "checks.js", "Table"],
  ["compare", "Compare", "compare.js", "Table"],
  ["report", "Report", "report.js", "Table", "has_fea"],
  ["table", "Import & export", "table.js"],
  ["jobs", "Jobs", "component_jobs.js", "Jobs & demand", "has_fea"],
  ["demand", "Demand", "demand.js", "Jobs & demand"],
  ["faces", "Faces", "faces.js", "Part", "mesh"],
  ["settings", "Settings", "settings.js", "Part"],
];

// Loads the files of all views.
export const preload = () => Promise.all(TABS.map(([, , file]) => import(`./${file}`)));

export async function show(root, [name, tab = "overview", query], signal) {
  // The library's entry is reply at once; all there is to say of a large table takes seconds.
  const { components } = await listed(signal);
  const about = components.find((one) => one.name === name) || await get(of(name), signal);
  const there = TABS.filter(([view, , , , needs]) => (!needs || about[needs]) && !(about.space && OF_ONE.includes(view)));
  const [chosenTab, text, file] = there.find(([one]) => one === tab) || there[0];
  const absent = TABS.find(([one]) => one === tab && one !== chosenTab);
  document.title = `${name}: ${text} · wrenchbook`;
  const changed = el("div", { "aria-live": "polite" }), body = el("div", { class: "stack" }), byTab = document.activeElement?.closest(".tabs");
  put(root,
    el("div", { class: "head" },
      el("div", {},
        el("span", { class: "crumb" }, el("a", { href: "#/" }, "Library"), " /"),
        el("h1", {}, name),
        titleOf(about) ? el("p", { class: "muted" }, titleOf(about)) : null),
      el("div", { class: "line" }, awayPill(about.archived), pill(about.has_fea ? (about.linear ? "finite elements, linear" : "finite elements") : "measured", ""))),
    tabs(name, chosenTab, there),
    absent ? note("", `This component has no view ${absent[1]}: it needs ${about.space ? "a component with one interface and no further inputs" : absent[4] === "mesh" ? "a mesh" : "finite elements"}. The overview is shown.`) : null,
    changed, body);
  if (byTab) document.querySelector(".tabs [aria-current=page]")?.focus({ preventScroll: true });
  const part = await import(`./${file}`);
  if (signal.aborted) return;
  const ended = new AbortController(), own = AbortSignal.any([signal, ended.signal]);
  let drawn = new AbortController(), now = about;
  const draw = async () => {
    try {
      await part.show(body, now, AbortSignal.any([own, drawn.signal]), new URLSearchParams(query));
    } catch (error) {
      if (own.aborted || error.name === "AbortError") return;
      put(body, trouble(error));
      if (error.status !== 503) return;
      ended.abort();
      setTimeout(() => { if (!signal.aborted) show(root, [name, tab, query], signal); }, BUILDING_MS);
    }
  };
  const again = async () => {
    drawn.abort();
    drawn = new AbortController();
    put(changed);
    now = (await listed(own)).components.find((one) => one.name === name) || now;
    await draw();
  };
  const stale = () => put(changed, note("", el("div", { class: "line" }, "The table has changed since this view was drawn.", el("button", { type: "button", class: "small", id: "draw-again", onclick: again }, "Draw it again"))));
  if (FOLLOW.includes(chosenTab)) listenToTable(name, about.table_version ?? 0, own, () => (now.rows ? stale : again)());
  await draw();
}

function awayPill(archived) {
  const made = pill("archived", "thin");
  made.id = "away";
  made.hidden = !archived;
  return made;
}

// The groups, and below them the views of the chosen one; a group of one view has its name.
function tabs(name, chosen, there) {
  const groups = Map.groupBy(there, ([, text, , group]) => group || text);
  const link = ([view], text, current) => el("a", { href: `#/c/${encodeURIComponent(name)}/${view}`, "aria-current": current }, text);
  let row = null;
  const heads = [...groups].map(([group, views]) => {
    const here = views.some(([view]) => view === chosen), one = views.length === 1;
    if (here && !one) row = el("div", { class: "views" }, views.map((view) => link(view, view[1], view[0] === chosen ? "page" : null)));
    return link(views[0], one ? views[0][1] : group, here ? (one ? "page" : "true") : null);
  });
  return el("nav", { class: "tabs", "aria-label": `Views of ${name}` }, el("div", {}, heads), row);
}
