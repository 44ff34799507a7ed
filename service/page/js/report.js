// Error against run time: the report, made on demand, drawn from its figures.

import { Problem, get, of, send, trouble } from "./api.js";
import { el, field, note, notify, put, save, table } from "./dom.js";
import { empty, emptyTable, linkTo } from "./empty.js";
import { count, percent, time } from "./format.js";
import { PLOTS, show as plot } from "./report_plots.js";

const LOOK_MS = 1000; // between looks at how far it is

export async function show(root, about, signal) {
  if (!about.rows) {
    put(root, emptyTable(about));
    return;
  }
  const body = el("div", { class: "stack" }), state = el("div", { class: "stack", "aria-live": "polite", id: "making" });
  put(root, el("section", { class: "card" }, requestForm(about, state, body, signal), state), body);
  await followAndShow(about, state, body, signal);
}

// Follows a report to its end; the one before it stays meanwhile. Until there is a first one, the body says whether it is being made.
async function followAndShow(about, state, body, signal) {
  const first = () => !body.firstElementChild || body.firstElementChild.matches(".empty");
  if (first()) await showReport(body, about, signal);
  if (await showProgress(about, state, signal) || first()) await showReport(body, about, signal);
}

function requestForm(about, state, body, signal) {
  const wrenches = el("input", { type: "number", min: 3, max: 1000, value: 24 });
  const make = async (event) => {
    event.preventDefault();
    try {
      await send("POST", `${of(about.name)}/report?wrenches=${wrenches.value}`, { signal });
      await followAndShow(about, state, body, signal);
    } catch (error) { if (!signal.aborted) put(state, trouble(error)); }
  };
  return el("form", { class: "line bottom", onsubmit: make },
    field("Wrenches to compare", wrenches), el("button", { class: "first" }, "Make the report"),
    el("span", { class: "muted small" }, "Each wrench is solved on three meshes; this takes minutes."));
}

// Shows how far a report is until it is made; returns whether a new one is there.
async function showProgress(about, state, signal) {
  let now = await get(`${of(about.name)}/report?format=state`, signal);
  const ran = now.state === "running";
  const bar = el("progress", { max: "1", "aria-label": "The report" }), message = el("span", { class: "muted small" });
  const cancel = el("button", { type: "button", class: "small", id: "cancel-report", onclick: async () => {
    cancel.disabled = true;
    try { await send("DELETE", `${of(about.name)}/report`, { signal }); } catch (error) {
      cancel.disabled = false;
      if (!signal.aborted) notify(error.message, "wrong");
    }
  } }, "Cancel");
  const make = state.parentElement.querySelector("form button");
  if (ran && now.wrenches) state.parentElement.querySelector("form input").value = now.wrenches;
  make.disabled = ran;
  if (ran) put(state, bar, el("div", { class: "line ends" }, message, cancel));
  while (now.state === "running") {
    if (now.fraction) bar.value = now.fraction; // until then it moves
    message.textContent = cancel.disabled ? "cancelling" : now.message;
    await new Promise((done) => setTimeout(done, LOOK_MS));
    if (signal.aborted) return false;
    now = await get(`${of(about.name)}/report?format=state`, signal);
  }
  make.disabled = false;
  put(state, now.state === "failed" ? note("outside", "The report could not be made: ", now.message) : null);
  return ran && now.state === "done";
}

async function showReport(body, about, signal) {
  try {
    const [report, now] = await Promise.all([get(`${of(about.name)}/report`, signal), get(of(about.name), signal)]);
    render(body, about, report, now.table_version);
  } catch (error) {
    if (signal.aborted) return;
    if (error instanceof Problem && error.status === 404) put(body, empty("No report yet. It compares the table, in error and run time, with solves on three meshes."));
    else put(body, trouble(error));
  }
}

// The table's version now may be newer than that of the report.
export const madeOf = ({ made, table_version: version }, now) => (version === now ? `Made ${time(made)} with table version ${version}, the newest.` : `Made ${time(made)} with table version ${version}; the table is now ${now}: make it again.`);

// How many true errors a report found within the error bars of the table's own method; null if it compared none.
export function insideBars(report) {
  const { missed, of: all } = report?.tables?.find((one) => one.method === report.default.method && one.rows === report.rows)?.beyond_error_bar || {};
  return all ? { inside: all - missed, all, tooFew: report.bars_too_small } : null;
}

export const insideWords = ({ inside, all }) => `${percent(inside / all)} of ${count(all)} true errors lay within the error bars (nominal 95 %)`;

// The latest report, null without one.
export async function reportOf(about, signal) {
  const path = `${of(about.name)}/report`;
  if (!about.has_fea || about.space || !about.rows || (await get(`${path}?format=state`, signal)).state === "none") return null;
  return get(path, signal).catch(() => null); // the first one has failed
}

function render(body, about, report, now) {
  if (!report.tables) { // the first one is being made
    put(body, el("p", { class: "empty" }, "The first report is being made."));
    return;
  }
  if (!report.sections) {
    put(body, el("p", { class: "empty" }, "An earlier version of the program made the latest report: save it, or make a new one."), files(about));
    return;
  }
  const places = Object.entries(PLOTS).map(([name, [title]]) => [name, title, el("div", { id: `plot-${name}` })]);
  const card = (title, ...content) => el("section", { class: "card" }, el("h2", {}, title), content);
  put(body,
    el("section", { class: "card" }, el("p", {}, el("strong", {}, report.advice)), el("p", { class: report.table_version === now ? "muted small" : "small" }, madeOf(report, now)), el("p", { class: "muted small" }, report.summary), report.needs_rows ? el("div", {}, linkTo(about, "overview?fill", "Go to Fill the table")) : null, files(about)),
    places.map(([, title, place]) => card(title, place)),
    report.sections.map(({ title, note: text, head, lines }) => card(title, el("p", { class: "muted small" }, text),
      lines.length ? table(head.map((name, place) => (place ? `#${name}` : name)), lines, { scrolls: true }) : null)));
  for (const [name, , place] of places) plot(place, name, report);
}

function files(about) {
  const take = (format) => async () => {
    try {
      const reply = await send("GET", `${of(about.name)}/report?format=${format}`);
      save(await reply.blob(), `${about.name}-report.${format}`);
    } catch (error) { notify(error.message, "wrong"); }
  };
  return el("span", { class: "line" }, ["html", "md", "json"].map((format) => el("button", { type: "button", class: "small", onclick: take(format) }, `Save ${format.toUpperCase()}`)));
}
