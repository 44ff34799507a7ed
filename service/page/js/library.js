// The library: each component with its picture and the share of its range within the tolerance.

import { get, listed, of } from "./api.js";
import { el, pill, put, note } from "./dom.js";
import { beingBuilt, empty } from "./empty.js";
import { listen } from "./events.js";
import { count, titleOf } from "./format.js";
import { paint, pictured } from "./picture.js";
import { insideBars, reportOf } from "./report.js";
import { wholeError } from "./shares.js";
import { tour } from "./tour.js";

const AT_ONCE = 4; // glances asked for at a time
const BUILDING_MS = 3000; // between looks at a table that is being built

export async function show(root, _, signal, archived = false) {
  const { components, broken } = await listed(signal, archived);
  const cards = new Map(components.map((one) => [one.name, card(one)]));
  const list = el("div", { class: "cards" }, [...cards.values()].map((one) => one.root));
  const search = el("input", {
    type: "search", placeholder: "Search", "aria-label": "Search the library",
    oninput: () => { none.hidden = filter(components, cards, search.value) > 0 || !components.length; },
  });
  const none = empty("No component matches.", el("button", { type: "button", onclick: () => { search.value = ""; search.dispatchEvent(new Event("input")); } }, "Clear the search"));
  none.hidden = true;
  const box = el("input", { type: "checkbox", checked: archived, id: "archived", onchange: async () => {
    await show(root, _, signal, box.checked);
    document.getElementById("archived")?.focus();
  } });
  const away = el("label", { class: "check" }, box, "Show archived");
  put(root,
    el("div", { class: "head" },
      el("div", {}, el("h1", {}, "Library")),
      el("div", { class: "line" }, el("div", { class: "search" }, search), away, el("button", { type: "button", class: "quiet", onclick: () => tour(components, true) }, "Tour"), el("a", { class: "button", href: "#/add" }, "Add a component"))),
    el("p", { class: "muted" }, "Deformable components and their tables. A bar shows the part of the load range that is answered within the tolerance. A first query, a fill or an import adds rows to an empty table."),
    broken.length ? note("outside", el("strong", {}, "Not usable"), broken.map((one) => el("span", {}, `${one.name}: ${one.reason}`)), el("span", {}, "Mend its files in the data directory, and reload this page; its rows and jobs are kept.")) : null,
    components.length ? list : empty("No components yet.", el("a", { class: "button first", href: "#/add" }, "Add a component")), none);
  if (!archived) tour(components);
  listen(null, signal, (kind, body) => {
    if (kind === "table" && cards.has(body.component)) refresh(body.component, cards, signal, body.rows);
    if (kind !== "hello") return;
    for (const [name, version] of Object.entries(body.tables || {})) { // versions before this page listened
      if (version > cards.get(name)?.about.table_version) readAgain(name, cards, signal);
    }
  });
  const names = [...cards.keys()];
  const workers = Array.from({ length: AT_ONCE }, async () => {
    for (let name = names.shift(); name; name = names.shift()) await refresh(name, cards, signal);
  });
  const drawn = [...components].sort((one, other) => one.has_fea - other.has_fea); // symbols need no mesh
  workers.push(...[0, 1].map(async () => { // two at once: the server builds each mesh in a process
    for (let part = drawn.shift(); part && !signal.aborted; part = drawn.shift()) await paint(cards.get(part.name).picture, part, signal);
  }));
  await Promise.all(workers);
}

function card(one) {
  const kind = !one.has_fea ? "measured" : one.linear ? "finite elements, linear" : "finite elements";
  const rows = el("span", { class: "muted small" }, rowsText(one.rows));
  const covered = el("div", { class: "muted small" }, "…");
  const picture = pictured(one.name);
  const root = el("article", { class: "card library" },
    el("div", { class: "line ends" }, el("h2", {}, el("a", { href: `#/c/${encodeURIComponent(one.name)}` }, one.name)), el("span", { class: "line" }, one.archived ? pill("archived", "thin") : null, pill(kind, ""))),
    picture, el("p", { class: "small" }, titleOf(one)),
    covered, rows);
  return { root, rows, covered, picture: picture.firstChild, about: one, all: one.rows, has_fea: one.has_fea };
}

const rowsText = (rows) => (!rows ? "" : rows === 1 ? "1 row" : `${count(rows)} rows`);

async function readAgain(name, cards, signal) {
  try {
    const about = await get(of(name), signal);
    cards.get(name).about = about;
    await refresh(name, cards, signal, about.rows);
  } catch { /* the card stays until the next version */ }
}

async function refresh(name, cards, signal, rows) {
  const shown = cards.get(name), turn = shown.turn = (shown.turn || 0) + 1;
  const late = () => signal.aborted || shown.turn !== turn; // a later call shows a newer table
  if (rows !== undefined) { shown.rows.textContent = rowsText(rows); shown.all = rows; }
  if (!shown.all) { // none, or none yet
    const to = (view, text) => el("a", { href: `#/c/${encodeURIComponent(name)}/${view}` }, text);
    put(shown.covered, shown.about.pending_rows ? `${beingBuilt(shown.about.pending_rows)} …` : ["empty table: ", shown.has_fea ? [to("query", "ask a query"), ", or ", to("overview?fill", "fill it")] : to("table", "import rows")]);
    return;
  }
  try {
    const glance = await get(`${of(name)}/glance`, signal), unknown = shown.has_fea && glance.error.includes(null);
    const about = unknown ? await get(of(name), signal) : shown.about; // with its open jobs, of few rows
    if (late()) return;
    put(shown.covered, wholeError(glance, about));
    shown.covered.className = "";
    const bars = insideBars(await reportOf({ ...about, rows: shown.all }, signal).catch(() => null));
    if (bars?.tooFew && !late()) shown.covered.append(el("a", { class: "small", href: `#/c/${encodeURIComponent(name)}/report` }, "The latest report warns of the error bars."));
  } catch (error) {
    if (late()) return;
    const building = error.status === 503;
    put(shown.covered, building ? "The table is being built …" : error.message);
    if (building) setTimeout(() => { if (!signal.aborted) refresh(name, cards, signal, rows); }, BUILDING_MS);
  }
}

function filter(components, cards, text) {
  let found = 0;
  const words = text.toLowerCase().split(/\s+/).filter(Boolean);
  for (const one of components) {
    const said = `${one.name} ${one.title} ${one.notes}`.toLowerCase();
    cards.get(one.name).root.hidden = !words.every((word) => said.includes(word));
    found += cards.get(one.name).root.hidden ? 0 : 1;
  }
  return found;
}
