// The imports of a component, newest first, with buttons that withdraw and restore their rows.

import { get, of, trouble } from "./api.js";
import { el, put, table } from "./dom.js";
import { empty } from "./empty.js";
import { editImport } from "./findings.js";
import { actorOf, count, time } from "./format.js";

export async function history(root, about, signal) {
  const again = () => history(root, about, signal);
  const [{ imports }, { rows, table_version: version }] = await Promise.all([get(`${of(about.name)}/imports`, signal), get(of(about.name), signal)]);
  put(root, el("h2", {}, "Imports"), contents(about, imports, rows ? version : null, signal, again));
}

function contents(about, imports, version, signal, again) {
  const now = version === null ? null : el("p", { class: "muted small" }, `Queries are answered from table version ${version}. To keep this version, export the packed table, a .wbt file.`);
  if (!imports.length) return [now, empty("Nothing was imported yet. Each import stands here with its rows, and can be withdrawn.")];
  const shown = imports.slice(0, 100);
  const columns = [
    ["file", (one) => el("a", { href: `#/c/${encodeURIComponent(about.name)}/rows?import=${one.id}`, title: `Rows of import ${one.id}` }, one.filename || one.format)],
    ["#rows", (one) => `${count(one.rows)}${one.withdrawn ? `, ${one.withdrawn < one.rows ? `${count(one.withdrawn)} ` : ""}withdrawn` : ""}`],
    ["", (one) => edits(about, one, signal, again)],
    ["when", (one) => time(one.when)],
    ["#version", (one) => (one.table_version === null ? "–" : String(one.table_version))], ["who", (one) => actorOf(one.who || "(anonymous)")],
    ["note", (one) => one.note, shown.some((one) => one.note)],
    ["rig", (one) => (one.rig ? el("details", {}, el("summary", {}, "rig"), el("pre", {}, one.rig)) : ""), shown.some((one) => one.rig)],
  ].filter(([, , used = true]) => used);
  return [now, table(columns.map(([head]) => head), shown.map((one) => columns.map(([, cell]) => cell(one))), { scrolls: true, class: "imports folds named" })];
}

// Buttons that withdraw an import's rows, and restore those that are withdrawn.
function edits(about, one, signal, again) {
  const button = (text, restored, rows) => el("button", { type: "button", class: "small", "aria-label": `${text} import ${one.id}`, onclick: () => ask(text, restored, rows) }, text);
  const ask = (text, restored, rows) => {
    const what = `${count(rows)} ${rows === 1 ? "row" : "rows"} of ${one.filename || `import ${one.id}`}`;
    const state = el("div", { "aria-live": "polite" });
    const confirmed = async (event) => {
      event.preventDefault();
      try {
        await editImport(about.name, one.id, { restored }, signal);
        dialog.close();
        await again();
      } catch (error) { if (!signal.aborted) put(state, trouble(error)); }
    };
    const dialog = el("dialog", { "aria-label": `${text} import ${one.id}`, onclose: () => dialog.remove() },
      el("form", { class: "stack", onsubmit: confirmed }, el("h2", {}, `${text} ${what}?`),
        el("p", {}, restored ? "The table answers from them again." : "The table no longer answers from them. They stay in the ledger and can be restored here."),
        el("div", { class: "line" }, el("button", { class: "first" }, text), el("button", { type: "button", class: "quiet", onclick: () => dialog.close() }, "Cancel")), state));
    document.body.append(dialog);
    dialog.showModal();
  };
  const left = one.rows - one.withdrawn;
  return el("div", { class: "line" }, left > 0 ? button("Withdraw", false, left) : null, one.withdrawn ? button("Restore", true, one.withdrawn) : null);
}
