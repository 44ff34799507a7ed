// Settings of a component in the library: notes, name, copies, archive.

import { get, of, post, send, trouble } from "./api.js";
import { el, field, note, put } from "./dom.js";

const goTo = (name) => { location.hash = `#/c/${encodeURIComponent(name)}/settings`; };

export async function show(root, { name }, signal) {
  const about = await get(of(name), signal);
  const again = () => show(root, { name }, signal);
  put(root,
    about.renamed_to ? note("thin", el("span", {}, "It was renamed: ", link(about.renamed_to), " is the newer one.")) : null,
    about.copied_from ? el("p", { class: "muted small" }, "Copied from ", link(about.copied_from), ".") : null,
    el("div", { class: "halves" },
      el("div", { class: "stack" },
        el("section", { class: "card" }, el("h2", {}, "Notes"), notes(about, signal)),
        el("section", { class: "card" }, el("h2", {}, about.archived ? "Archived" : "Archive"), away(about, signal, again))),
      el("section", { class: "card" }, el("h2", {}, "Name and copies"), naming(about, signal))));
}

const link = (name) => el("a", { href: `#/c/${encodeURIComponent(name)}/settings` }, name);

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
  const copy = form(signal, { inputs: [field("Copy it as", copied), el("label", { class: "check" }, rows, "with its rows")], action: "Copy the component", id: "copy" }, async () => {
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
