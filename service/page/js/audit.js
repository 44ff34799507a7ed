// The audit: writes with their actors, newest first, a page at a time.

import { get } from "./api.js";
import { el, field, put, select } from "./dom.js";
import { actorOf, sentence, time } from "./format.js";
import { kindWords } from "./job_list.js";

const SHOWN = 50;
const HEADS = ["Time", "Actor", "Action", "Component", "Object", "Before and after"];
// Each action the service writes, by its object.
const ACTIONS = {
  job: ["accept", "fail", "cancel", "retry", "reopen", "priority"], row: ["solve", "insert", "rewrite", "withdraw", "restore"],
  import: ["load", "append", "withdraw", "restore"], component: ["add", "edit"], key: ["add", "rotate", "revoke"],
  rig: ["store", "remove"], report: ["make"], demand: ["forget"], recording: ["clear"], envelope: ["clear"],
};

export async function show(root, _, signal) {
  document.title = "Audit · wrenchbook";
  const action = select([["", "all"]], "");
  action.name = "action";
  action.append(...Object.entries(ACTIONS).map(([kind, verbs]) => el("optgroup", { label: sentence(kind) }, verbs.length > 1 ? el("option", { value: `${kind}.*` }, `${sentence(kind)}s: all`) : null,
    verbs.map((verb) => el("option", { value: `${kind}.${verb}` }, sentence(actionOf(`${kind}.${verb}`)))))), el("option", { value: "settings" }, "Settings"));
  action.addEventListener("change", () => fresh());
  const inputs = [...["actor", "component"].map((name) => el("input", { name, placeholder: "all" })), action];
  const body = el("tbody", {}), older = el("button", { type: "button", hidden: true }, "Older entries");
  let next = null;
  const load = async (path, fresh) => {
    const page = await get(path, signal);
    if (fresh) put(body);
    for (const one of page.entries) {
      const cells = [time(one.time, { second: "2-digit" }), actorOf(one.actor) || "–", actionOf(one.action), one.component ? el("a", { href: `#/c/${encodeURIComponent(one.component)}` }, one.component) : "", objectOf(one)];
      body.append(el("tr", { id: `entry-${one.id}` }, cells.map((text, k) => el("td", { "data-head": HEADS[k] }, text)), el("td", { class: "small whole" }, states(one))));
    }
    next = page.next;
    older.hidden = !next;
  };
  const fresh = () => {
    const chosen = inputs.filter((input) => input.value.trim()).map((input) => [input.name, input.value.trim()]);
    return load(`v1/audit?${new URLSearchParams([...chosen, ["limit", SHOWN]])}`, true);
  };
  older.addEventListener("click", () => load(next.replace(/^\//, ""), false));
  const form = el("form", { class: "few", onsubmit: (event) => { event.preventDefault(); fresh(); } },
    inputs.map((input) => field(sentence(input.name), input)), el("div", {}, el("button", {}, "Show")));
  await fresh();
  put(root, el("div", { class: "head" }, el("div", {}, el("h1", {}, "Audit"), el("p", { class: "muted" }, "All writes to this server with their actors, newest first."))), el("section", { class: "card" }, form,
    el("div", { class: "wide", tabindex: "0" }, el("table", { class: "folds audit" }, el("thead", {}, el("tr", {}, HEADS.map((one) => el("th", { scope: "col" }, one)))), body)), older));
}

const DONE = { accept: "accepted", add: "added", append: "appended", cancel: "cancelled", clear: "cleared", edit: "edited", fail: "failed", forget: "forgotten", insert: "added", load: "loaded", make: "begun", priority: "priority changed", reopen: "reopened", remove: "removed", restore: "restored", retry: "retried", revoke: "revoked", rewrite: "rewritten", rotate: "rotated", solve: "solved", store: "stored", withdraw: "withdrawn" };

function actionOf(name) {
  const [kind, verb] = name.split(".");
  return verb ? `${kind} ${DONE[verb] || verb.replaceAll("_", " ")}` : name;
}

// An object with its word, as "row 67"; jobs, rows and imports are links. Of a component's own writes the word alone: its name is beside it.
function objectOf({ action, component, object }) {
  const kind = action.split(".")[0], name = encodeURIComponent(component || ""), words = [component, "None"].includes(object) ? kind : kind === action ? object : `${kind} ${object}`; // None: an import of known rows alone
  const view = component && words !== kind && { row: `rows?row=${object}`, import: `rows?import=${object}` }[kind];
  if (view) return el("a", { href: `#/c/${name}/${view}` }, words);
  return kind === "job" ? el("a", { href: `#/jobs/${object}` }, words) : words;
}

// Of settings whose names do not hold their units, as in service/settings.py.
const UNITS = { table_memory: "MB", replicate_interval: "s", backup_every: "h" };
const TIMES = ["created", "expires"]; // of keys: seconds since 1970
const withUnit = (name, value) => `${wordsOf(value, name)}${name in UNITS && typeof value === "number" ? ` ${UNITS[name]}` : ""}`;

// A state as words: "status waiting, priority 0".
function wordsOf(state, name) {
  if (typeof state === "number" && TIMES.includes(name)) return time(1e3 * state);
  if (name === "kind") return kindWords(state);
  if (state === null || typeof state !== "object") return String(state).replace(/^([0-9a-f]{12})[0-9a-f]{52}$/, "$1"); // a digest, shortened
  return Object.entries(state).filter(([, value]) => value !== null && value !== "").map(([name, value]) => (Array.isArray(state) ? wordsOf(value) : `${name.replaceAll("_", " ")} ${withUnit(name, value)}`)).join(", ");
}

// Of two states what differs, else the one there is.
function states({ before, after }) {
  if (![before, after].every((one) => one && typeof one === "object")) return [before, after].filter((one) => one !== null).map(wordsOf).join(" → ");
  const changed = [...new Set([...Object.keys(before), ...Object.keys(after)])].filter((name) => JSON.stringify(before[name] ?? null) !== JSON.stringify(after[name] ?? null));
  return changed.map((name) => `${name.replaceAll("_", " ")} ${withUnit(name, before[name] ?? "none")} → ${withUnit(name, after[name] ?? "none")}`).join(", ");
}
