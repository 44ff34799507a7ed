// The rows of a component, newest first: filters, a page at a time, withdrawal and restoring of a row.

import { get, of, post, send, trouble } from "./api.js";
import { el, field, notify, pill, put, select } from "./dom.js";
import { empty, emptyTable, linkTo } from "./empty.js";
import { counted, largestOf, number as written, prefixOf, time, triple } from "./format.js";
import { OUTSIDE, beyondRange, inputsText, named, outputsOf } from "./inputs.js";

const SHOWN = 25; // rows of a page, each a call
const MOST_READ = 500; // rows that are read for a page: those of other states are left out
const SOURCES = [["", "all"], ["solves", "solved here"], ["imports", "imported"]];
const STATES = [["", "all"], ["in the table", "in the table"], ["withdrawn", "withdrawn"], ["other files", "solved with other files"], [OUTSIDE, OUTSIDE]];

export const rowLink = (name, row, text = String(row)) => el("a", { href: `#/c/${encodeURIComponent(name)}/rows?row=${row}` }, text);

// Row numbers with the word "row" before them, as links, at most `most`.
export const rowLinks = (name, rows, most) => [rows.length === 1 ? "row " : "rows ", rows.slice(0, most).flatMap((row, k) => [k ? ", " : "", rowLink(name, row)])];

export async function show(root, about, signal, query = new URLSearchParams()) {
  const { imports } = await get(`${of(about.name)}/imports`, signal);
  const body = el("tbody", {}), state = el("div", { "aria-live": "polite" }), older = el("button", { type: "button", hidden: true }, "Older rows");
  const number = el("input", { type: "number", min: 1, step: 1, value: query.get("row") || "", placeholder: "all" });
  const source = select(SOURCES, query.get("source") || ""), status = select(STATES, query.get("state") || "");
  const from = select([["", "all"], ...imports.map((one) => [String(one.id), `${one.id}${one.filename ? `: ${one.filename}` : ""}`])], query.get("import") || "");
  let walk = null, latest = 0, sizes = [0, 0]; // of translations and rotations: one unit for all rows
  const load = async (fresh) => {
    const mine = latest += 1; // of two at once the later one counts
    older.hidden = true;
    put(state, el("p", { class: "muted" }, "Reading rows …"));
    try {
      if (fresh) {
        const now = (await get(`${of(about.name)}/imports`, signal)).imports.filter(({ id }) => !from.value || String(id) === from.value); // withdrawals change them
        if (mine !== latest) return;
        walk = walkOf(about.name, number.value, source.value, status.value, now, Boolean(from.value), signal);
        put(body);
      }
      let shown = 0, read = 0, more = true;
      while (more && shown < SHOWN && read < MOST_READ) {
        const numbers = await walk.next();
        const rows = (await Promise.all(numbers.map((one) => read_(about.name, one, signal)))).filter(Boolean);
        if (mine !== latest) return;
        more = numbers.length > 0;
        read += numbers.length;
        const chosen = rows.filter((row) => walk.has(row) && (!status.value || stateOf(about, row) === status.value));
        if (!body.children.length) sizes = ["u", "r"].map((kind) => largestOf(chosen.flatMap((row) => (row.displacement || []).filter((_, k) => isOf(outputsOf(about)[k], kind)))));
        body.append(...chosen.map((row) => line(about, row, sizes)));
        shown += chosen.length;
      }
      older.hidden = !more;
      list.hidden = !body.children.length;
      put(state, !list.hidden ? null : more ? el("p", { class: "muted" }, `None among the newest ${counted(read, "row")}.`) : filters().length ? empty("No row fits these filters.", linkTo(about, "rows", "Show all rows")) : emptyTable(about));
    } catch (error) { if (!signal.aborted && mine === latest) put(state, trouble(error)); }
  };
  older.addEventListener("click", () => load(false));
  const filters = () => Object.entries({ row: number.value, source: source.value, state: status.value, import: from.value }).filter(([, value]) => value);
  const chosen = () => {
    const kept = filters();
    history.replaceState(null, "", `#/c/${encodeURIComponent(about.name)}/rows${kept.length ? `?${new URLSearchParams(kept)}` : ""}`); // a reload keeps them
    load(true);
  };
  for (const input of [number, source, status, from]) input.addEventListener("change", chosen);
  const head = ["#Row", "State", "Wrench", "Displacement", "Source", ""];
  const list = el("table", { class: "folds rows" }, el("thead", {}, el("tr", {}, head.map((one) => el("th", { scope: "col", class: one[0] === "#" ? "number" : null }, one.replace("#", ""))))), body);
  put(root, el("section", { class: "card" },
    el("form", { class: "few", onsubmit: (event) => { event.preventDefault(); chosen(); } }, field("Source", source), field("State", status), imports.length ? field("Import", from) : null, field("Row number", number)),
    el("p", { class: "muted small" }, "Newest first. The table no longer answers from a withdrawn row; it stays in the ledger and can be restored. All rows of an import are withdrawn and restored under ", el("a", { href: `#/c/${encodeURIComponent(about.name)}/table` }, "Import & export"), "."),
    el("div", { class: "wide", tabindex: "0" }, list), state, el("div", {}, older)));
  await load(true);
}

// A row with its provenance; null if the number is none of this component, the message if it is damaged.
const read_ = (name, row, signal) => get(`${of(name)}/table/${row}`, signal).catch((error) => {
  if (signal.aborted || ![404, 500].includes(error.status)) throw error;
  return error.status === 404 ? null : { row, error };
});

// The numbers of rows, newest first: those of solves are in the list of jobs, those of an import end with its version.
function walkOf(name, row, source, status, imports, one, signal) {
  let more = row || one || source === "imports" ? null : `v1/jobs?component=${encodeURIComponent(name)}&status=done&limit=${4 * SHOWN}`;
  const spans = row || source === "solves" ? [] : imports.filter(({ rows, withdrawn, table_version: last }) => last && (status === "withdrawn" ? withdrawn : status === "in the table" ? withdrawn < rows : ["", OUTSIDE].includes(status))).map(({ id, rows, table_version: last }) => ({ id, left: rows, at: last }));
  const seen = new Set(), jobs = row ? [Number(row)] : [], from = new Map();
  const next = async () => {
    const numbers = [];
    while (numbers.length < SHOWN) {
      if (!jobs.length && more) {
        const page = await get(more, signal);
        jobs.push(...page.jobs.flatMap((job) => job.row ?? []).sort((a, b) => b - a));
        more = page.next?.slice(1);
        continue;
      }
      const span = spans.filter(({ left, at }) => left > 0 && at > 0).sort((a, b) => b.at - a.at)[0];
      if (!span && !jobs.length) break;
      const solved = !span || jobs[0] > span.at, number = solved ? jobs.shift() : span.at;
      if (!solved) { span.at -= 1; span.left -= 1; from.set(number, span); }
      if (!seen.has(number)) numbers.push(number);
      seen.add(number);
    }
    return numbers;
  };
  // Between the rows that were appended to an import others may lie: they do not count as its own.
  const has = ({ row: number, provenance }) => {
    const span = from.get(number), own = !span || provenance?.import?.id === span.id;
    if (!own) span.left += 1;
    return own || !one;
  };
  return { next, has };
}

const stateOf = (about, { withdrawn, error, provenance, wrench }) => (error ? "damaged" : withdrawn ? "withdrawn" : provenance.setup && !provenance.setup.present ? "other files" : beyondRange(about, wrench) ? OUTSIDE : "in the table");

function line(about, row, sizes) {
  const root = el("tr", { id: `row-${row.row}` });
  draw(root, about, row, sizes);
  return root;
}

function draw(root, about, row, sizes) {
  const state = stateOf(about, row);
  const number = el("td", { class: "number" }, String(row.row));
  if (row.error) { put(root, number, el("td", {}, pill(state, "wrong")), el("td", { class: "small whole", colspan: 4 }, row.error.message)); return; }
  const edit = async (event) => {
    event.target.disabled = true;
    const path = `${of(about.name)}/table/${row.row}`;
    try {
      await (row.withdrawn ? post(`${path}/restore`, {}) : send("DELETE", path));
      notify(row.withdrawn ? `Row ${row.row} is in the table again.` : `Row ${row.row} is withdrawn. It can be restored here.`);
      draw(root, about, await get(path), sizes);
      root.querySelector("button").focus();
    } catch (error) {
      event.target.disabled = false;
      notify(error.message, "wrong");
    }
  };
  const verb = row.withdrawn ? "Restore" : "Withdraw";
  put(root, number,
    el("td", {}, pill(state, { "in the table": "ok", withdrawn: "thin", [OUTSIDE]: "outside" }[state] || "")),
    el("td", { class: "small whole", "data-head": "Wrench" }, about.space ? inputsText(named(about, row.wrench), about, 4) : six(["F", "M"], row.wrench.map((value) => written(value)), ["N", "N·m"])),
    el("td", { class: "small whole", "data-head": "Displacement" }, displacement(about, row.displacement, sizes)),
    el("td", { class: "small", "data-head": "Source" }, origin(about, row), el("div", { class: "muted" }, time(row.provenance.when))),
    el("td", {}, el("button", { type: "button", class: "small", "aria-label": `${verb} row ${row.row}`, onclick: edit }, verb)));
}

const isOf = (output, kind) => output.split(".").at(-1).startsWith(kind);

// Six numbers in two lines, whose columns are below each other in all rows.
const six = (names, texts, units) => el("div", { class: "six" }, names.map((name, k) => [el("span", { class: "muted" }, name), texts.slice(3 * k, 3 * k + 3).map((text) => el("span", {}, text)), el("span", { class: "muted" }, units[k])]));

const DIGITS = 5; // of the largest number of all rows

// Three outputs a group: translations, then rotations, of each interface.
function displacement(about, values, sizes) {
  const names = outputsOf(about), units = sizes.map((size, k) => [...prefixOf(size), k ? "rad" : "m"]);
  if (!about.space) {
    const text = (value, k) => {
      const [scale] = units[Math.floor(k / 3)], size = sizes[Math.floor(k / 3)] / scale, shown = value === null ? "–" : value ? (value / scale).toFixed(Math.max(0, DIGITS - 1 - Math.floor(Math.log10(size)))) : "0";
      return value && !Number(shown) ? "≈ 0" : shown.replace("-", "\u2212");
    };
    return six(["u", "r"], values.map(text), units.map(([, prefix, unit]) => `${prefix}${unit}`));
  }
  let text = "";
  for (let k = 0; k < names.length; k += 3) {
    const [last, front] = names[k].split(".").reverse(), kind = last.startsWith("u") ? 0 : 1;
    text += `${front && !kind ? `${k ? "; " : ""}${front}: ` : k ? ", " : ""}${kind ? "r" : "u"}\u00a0${triple(values.slice(k, k + 3), units[kind][2], sizes[kind])}`;
  }
  return text;
}

// Where a row is from: its job, or its import.
function origin(about, { source, provenance: { job, import: sent } }) {
  if (job) return el("a", { href: `#/jobs/${job.id}` }, `job ${job.id}`);
  if (!sent) return source;
  const known = [sent.filename, sent.who, source === "fea" ? "solved" : source.startsWith("measured") ? "" : source].filter(Boolean);
  return [el("a", { href: `#/c/${encodeURIComponent(about.name)}/rows?import=${sent.id}` }, `import ${sent.id}`), known.map((one) => `, ${one}`)];
}
