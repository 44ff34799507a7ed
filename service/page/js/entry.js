// A component's entry in the library: notes, name, copies, put away or not, and what was imported.

import { get, of, post, send, trouble } from "./api.js";
import { el, field, note, put, table } from "./dom.js";
import { empty, linkTo } from "./empty.js";
import { editImport } from "./findings.js";
import { actorOf, count, time } from "./format.js";

const goTo = (name) => { location.hash = `#/c/${encodeURIComponent(name)}/entry`; };

export async function show(root, { name }, signal) {
  const [about, { imports }] = await Promise.all([get(of(name), signal), get(`${of(name)}/imports`, signal)]);
  const again = () => show(root, { name }, signal);
  put(root,
    about.renamed_to ? note("thin", el("span", {}, "It was renamed: ", link(about.renamed_to), " is the newer one.")) : null,
    about.copied_from ? el("p", { class: "muted small" }, "Copied from ", link(about.copied_from), ".") : null,
    el("div", { class: "halves" },
      el("div", { class: "stack" },
        el("section", { class: "card" }, el("h2", {}, "Notes"), notes(about, signal)),
        el("section", { class: "card" }, el("h2", {}, about.archived ? "Archived" : "Archive"), away(about, signal, again))),
      el("section", { class: "card" }, el("h2", {}, "Name"), naming(about, signal))),
    el("section", { class: "card" }, el("h2", {}, "Imports and versions"), history(about, imports, signal, again)));
}

const link = (name) => el("a", { href: `#/c/${encodeURIComponent(name)}/entry` }, name);

// A form that says below it what has become of it.
function form(signal, { inputs, action, id, first }, done) {
  const state = el("div", { "aria-live": "polite" });
  const sent = async (event) => {
    event.preventDefault();
    put(state);
    try {
      put(state, (await done()) || "");
    } catch (error) { if (!signal.aborted) put(state, trouble(error)); }
  };
  return el("form", { class: "stack", onsubmit: sent }, inputs, el("div", {}, el("button", { class: first ? "first" : null, id }, action)), state);
}

function notes(about, signal) {
  const text = el("textarea", { value: about.notes, id: "notes", "aria-label": "Notes", placeholder: "For example bolts, gauges, drawings. The search reads it.", maxlength: 10000 });
  return form(signal, { inputs: text, action: "Save the notes", id: "save-notes", first: true }, async () => {
    await send("PUT", `${of(about.name)}/notes`, { json: { text: text.value }, signal });
    return el("span", { class: "muted" }, "Saved.");
  });
}

function naming(about, signal) {
  const name = (id) => el("input", { required: true, autocomplete: "off", id, pattern: "[a-z0-9][a-z0-9_\\-]{0,63}", title: "1 to 64 characters: a-z, 0-9, _ and -; the first is a letter or digit" });
  const copied = name("copy-name"), renamed = name("rename-name"), rows = el("input", { type: "checkbox", checked: true });
  const copy = form(signal, { inputs: [field("Copy it as", copied), el("label", { class: "check" }, rows, "with its rows")], action: "Copy", id: "copy" }, async () => {
    goTo((await post(`${of(about.name)}/copy`, { name: copied.value.trim(), rows: rows.checked }, signal)).name);
  });
  if (about.shipped || about.renamed_to) {
    return el("div", { class: "stack" }, copy, el("p", { class: "muted small" }, about.shipped ? "A shipped component keeps its name." : "It has been renamed."));
  }
  const rename = form(signal, { inputs: [field("Rename it to", renamed)], action: "Rename", id: "rename" }, async () => {
    goTo((await post(`${of(about.name)}/rename`, { name: renamed.value.trim() }, signal)).name);
  });
  return el("div", { class: "stack" }, rename,
    el("p", { class: "muted small" }, "The rows move with it; the old name is archived and still answers."), copy);
}

function away(about, signal, again) {
  const verb = about.archived ? "unarchive" : "archive";
  const words = about.archived ? "The library hides this component; queries still work." : "The library hides an archived component. Queries still work, and it can be restored.";
  return form(signal, { inputs: el("p", { class: "muted" }, words), action: about.archived ? "Restore it" : "Archive it", id: verb }, async () => {
    await post(`${of(about.name)}/${verb}`, {}, signal);
    await again();
    document.getElementById("away").hidden = about.archived;
    document.getElementById(about.archived ? "archive" : "unarchive")?.focus();
  });
}

function history(about, imports, signal, again) {
  const now = el("p", { class: "muted small" }, `Queries are answered from table version ${about.table_version}. To keep this version, save the packed table (.wbt) under Import & export.`);
  if (!imports.length) return [now, empty("Nothing was imported.", linkTo(about, "table", "Import rows"))];
  const shown = imports.slice(0, 100);
  const columns = [
    ["#version", (one) => (one.table_version === null ? "–" : String(one.table_version))],
    ["#rows", (one) => `${count(one.rows)}${one.withdrawn ? `, ${one.withdrawn < one.rows ? `${count(one.withdrawn)} ` : ""}withdrawn` : ""}`],
    ["file", (one) => one.filename || one.format], ["when", (one) => time(one.when)], ["who", (one) => actorOf(one.who || "(anonymous)")],
    ["note", (one) => one.note, shown.some((one) => one.note)],
    ["rig", (one) => (one.rig ? el("details", {}, el("summary", {}, "rig"), el("pre", {}, one.rig)) : ""), shown.some((one) => one.rig)],
    ["", (one) => edits(about, one, signal, again)],
  ].filter(([, , used = true]) => used);
  return [now, table(columns.map(([head]) => head), shown.map((one) => columns.map(([, cell]) => cell(one))), { scrolls: true, class: "imports" })];
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
