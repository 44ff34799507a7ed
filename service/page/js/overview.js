// What a component is: contract, range, method, how well its table covers.

import { caughtUp, get, of, post, trouble } from "./api.js";
import { el, facts, field, note, notify, pill, put, table } from "./dom.js";
import { listenToTable } from "./events.js";
import { beingBuilt, linkTo } from "./empty.js";
import { findingNote } from "./findings.js";
import { OUTPUTS, count, counted, number, percent, quantity, sentence, time, triple } from "./format.js";
import { OUTSIDE, inputsOf, mark, spansOf } from "./inputs.js";
import { paint, pictured } from "./picture.js";
import { insideBars, insideWords, madeOf, reportOf } from "./report.js";
import { rowLinks } from "./rows.js";
import { isAtWork, legend, namesOf, openJobs, sharesOf, wholeError } from "./shares.js";

export async function show(root, { name }, signal, query = new URLSearchParams()) {
  put(root, el("p", { class: "muted" }, "…"));
  const about = await get(of(name), signal);
  const warned = el("div", { class: "stack" }), glance = el("div", { class: "stack" }, el("p", { class: "muted" }, "…"));
  const work = new EventTarget(); // jobs of this component
  const rows = el("section", { class: "card" }), range = el("section", { class: "card" });
  let latest = 0, facts_ = [];
  const draw = (...known) => { // the facts, and the emphasis of the button
    facts_ = known;
    put(rows, el("h2", {}, "Method and rows"), method(...known));
    document.getElementById("fill")?.classList.toggle("first", !(known[3]?.whole[0] > 0.995 || isAtWork(known[0]))); // more solves add little to a full table, or to a queue
  };
  const refresh = async () => {
    const mine = latest += 1; // of two at once the later one counts
    const now = await get(of(name), signal);
    const [report, imports] = await Promise.all([reportOf(now, signal), importsOf(now, signal)]);
    if (mine !== latest) return;
    put(warned, verdict(now, report), warnings(now, signal, refresh));
    draw(now, report, imports, facts_[3]);
    put(range, el("h2", {}, "Load range"), loads(now));
    const shares = await cover(glance, now, signal, () => mine === latest);
    if (!shares || mine !== latest) return;
    draw(now, report, imports, shares);
    if (shares.reach && !now.linear) put(range, el("h2", {}, "Load range"), loads(now, shares.reach));
  };
  put(root, warned,
    el("div", { class: "halves" },
      el("div", { class: "stack" }, el("section", { class: "card" }, el("h2", {}, "Coverage"), glance, about.has_fea ? fill(about, work, signal) : el("div", {}, linkTo(about, "table", "Import measured rows"))), range),
      el("div", { class: "stack" }, rows, el("section", { class: "card" }, el("h2", {}, "Part and conventions"), pictureOf(about, signal), contract(about)))));
  if (query.has("fill")) document.getElementById("fill")?.focus(); // a link to the button
  let counting = null;
  const count_ = () => { // jobs end in bursts: the last one counts
    clearTimeout(counting);
    counting = setTimeout(async () => {
      const now = await get(of(name), signal).catch(() => null);
      if (!now || !facts_.length) return;
      draw(now, ...facts_.slice(1));
      if (!now.rows) await cover(glance, now, signal, () => true).catch(() => {});
    }, COUNT_MS);
  };
  const heard = new Map(); // statuses of jobs
  listenToTable(name, about.table_version, signal, () => refresh().catch(() => {}), (body) => {
    work.dispatchEvent(new CustomEvent("job", { detail: body }));
    if (body.id && heard.get(body.id) === body.status) return; // progress alone
    heard.set(body.id, body.status);
    count_();
  });
  await refresh();
}

const COUNT_MS = 300; // after the last change of a job

const importsOf = async (about, signal) => (about.measured ? (await get(`${of(about.name)}/imports`, signal)).imports.filter((one) => one.withdrawn < one.rows) : []);

// A report whose true errors lie outside the error bars too often speaks against the bars of the coverage.
const verdict = (about, report) => (insideBars(report)?.tooFew ? note("outside", el("strong", {}, "The latest report warns of the error bars"), el("span", {}, report.advice), el("span", {}, madeOf(report, about.table_version)), el("div", {}, linkTo(about, "report", "Show the report"))) : null);

// `done()` is called after the rows of a finding are withdrawn.
function warnings(about, signal, done) {
  const checked = about.warnings.filter((one) => one.where !== "rows" && !one.import);
  const ofRows = about.warnings.filter((one) => one.where === "rows");
  const found = about.warnings.filter((one) => one.import);
  return [
    found.length ? el("section", { class: "card", id: "findings" }, el("h2", {}, "Findings of imports"),
      found.map((one) => el("div", { class: "stack" }, el("p", { class: "muted small" }, `Import ${one.import}${one.filename ? `, ${one.filename}` : ""}`),
        findingNote(about.name, one, one.import, signal, done)))) : null,
    ofRows.length ? note("thin", ofRows.map((one) => el("p", {}, textOf(one))), about.another_setup.wrenches ? resolve(about) : null) : null,
    checked.length ? note("thin", el("strong", {}, "Warnings of the bundle check"), el("ul", {}, checked.map((one) => el("li", {}, causeFirst(VERB.test(textOf(one)) ? `${one.where} ${textOf(one)}` : textOf(one)))))) : null,
  ];
}

const VERB = /^(is|are|has|have|holds|keeps|counts|names|must|cannot|consists|moves|rotates|fixes|closes|lies|needs) /; // of a message that goes on after its key
// The cause in bold, then the rest.
function causeFirst(text) {
  const words = sentence(text).replace(/([^.])$/, "$1."), end = words.search(/[:;] |\. /);
  return end < 0 || end > 120 ? words : [el("strong", {}, words.slice(0, end + 1)), words.slice(end + 1)];
}

const textOf = (one) => (typeof one === "string" ? one : one.message || one.msg || JSON.stringify(one));

async function cover(place, about, signal, isLatest) {
  const rows = about.space ? about.rows : (await caughtUp(about.name, signal)).of; // the rows of several inputs have no drawing to wait for
  const parts = [];
  let glance = null;
  if (rows) {
    glance = await get(`${of(about.name)}/glance`, signal);
    const title = (text) => (about.has_fea ? el("h3", {}, text) : null);
    parts.push(title("With mesh error"), wholeError(glance, about), legend(namesOf(glance)), title("Interpolation only"), sharesOf(glance, about));
    parts.push(legend(), el("details", { class: "small" }, el("summary", {}, "What the bars mean"), el("p", { class: "muted" }, `Parts of the load range. Covered: the interpolation error is known and within the tolerance; thin: it is larger or not known; outside: beyond the load range, with a load that no row varies, or beyond the rows for the methods by axes (additive, griddata). Kriging may cover loads a little beyond the rows. The first bar compares the complete error bar, of interpolation and of the solver, with the tolerance.${about.space ? "" : " Axis x has the loads Fx, My and Mz, axis y Fy, Mz and Mx, axis z Fz, Mx and My."}`)));
  } else parts.push(el("p", {}, about.pending_rows ? `${beingBuilt(about.pending_rows)} …` : isAtWork(about) ? ["The table has no rows yet. Solves: ", jobsLink(about), "."] : "The table has no rows yet."));
  if (isLatest()) put(place, parts);
  return glance;
}

// Rows of another setup: the component's files have changed since these were solved.
function resolve(about) {
  const order = async () => {
    try {
      const reply = await post(`${of(about.name)}/table/resolve`, {});
      notify(reply.jobs.length ? `${counted(reply.jobs.length, "solve")} queued. ${reply.reason ? sentence(reply.reason) : ""}` : reply.reason || "Nothing to solve.");
    } catch (error) { notify(error.message, "wrong"); }
  };
  return el("button", { onclick: order }, "Solve them again");
}

function fill(about, work, signal) {
  const budget = el("input", { type: "number", min: 1, max: 10000, value: 24, "aria-label": "Largest number of solves" });
  const order = async (event) => {
    event.preventDefault();
    try {
      event.submitter.disabled = true;
      await fillTo(state, about.name, Number(budget.value), work, signal);
    } catch (error) { if (!signal.aborted) put(state, trouble(error)); }
    event.submitter.disabled = false;
  };
  const state = el("div", { "aria-live": "polite" });
  return [el("form", { class: "line bottom", onsubmit: order },
    field("Largest number of solves", budget), el("button", { class: "first", id: "fill" }, "Fill the table")), state];
}

const ROUND = 24; // solves: the next round is designed with their rows, as by the command fill
// Queues solves round by round until the budget is spent or the table needs none; they end about in their order.
async function fillTo(place, name, budget, work, signal) {
  let ended = 0, failed = 0, queued = 0, stopped = false;
  const open = new Map(); // jobs of this round that have not ended: their status and fraction
  const bar = el("progress", { max: String(budget), value: 0, "aria-label": "Solves that have ended" }), words = el("span", { class: "small muted" }), why = el("span", { class: "small muted" });
  const stop = el("button", { type: "button", class: "small", id: "stop-fill", onclick: () => { stopped = stop.disabled = true; say(); } }, "Stop after this round");
  const jobs_ = el("a", { class: "small", href: `#/c/${encodeURIComponent(name)}/jobs` }, "Show the jobs");
  const say = (end = stopped ? " Stops after these." : " The next round begins by itself while this view is open.") => {
    const states = [...open.values()], running = states.filter((one) => one.status === "running");
    bar.value = ended + running.reduce((sum, one) => sum + (one.progress?.fraction ?? 0), 0);
    const parts = [[ended - failed, "done"], [failed, "without a row"], [running.length, "running"], [states.length - running.length, "waiting"]].filter(([n]) => n).map(([n, state]) => `${n} ${state}`);
    words.textContent = `${counted(queued, "solve")} queued (at most ${budget}): ${parts.join(", ")}.${end}`;
  };
  const hear = ({ detail: job }) => {
    if (!open.has(job.id) || !["waiting", "running"].includes(job.status)) return; // the end is asked for
    open.set(job.id, job);
    say();
  };
  work.addEventListener("job", hear);
  try {
    while (ended < budget && !stopped) {
      const { jobs, reason } = await post(`${of(name)}/fill`, { budget: Math.min(ROUND, budget - ended) }, signal);
      const because = reason ? sentence(reason.replace(/^\d+ of at most \d+ solves: /, "")) : "";
      if (!jobs.length && !queued) { put(place, el("p", {}, `No solve is queued: ${because || "the table needs none."}`)); return; }
      why.textContent = because;
      if (!jobs.length) break;
      if (!queued) put(place, el("div", { class: "stack tight" }, el("div", { class: "line ends" }, words, jobs_), bar, why, el("div", {}, stop)));
      queued += jobs.length;
      for (const job of jobs) open.set(job.id, { status: "waiting", ...job });
      const before = failed;
      for (const { id } of jobs) {
        say();
        let job;
        do job = await get(`v1/jobs/${id}?wait_s=20`, signal); while (["waiting", "running"].includes(job.status));
        failed += job.status === "done" ? 0 : 1;
        ended += 1;
        open.delete(id);
      }
      if (failed - before === jobs.length) break; // the next round would ask for the same
    }
  } finally { work.removeEventListener("job", hear); }
  stop.remove();
  say(ended < budget ? "" : " The budget is spent.");
}

const SOURCES = { fea: "solved" };
const pointOf = (point) => `(${point.map((one) => number(Math.abs(one) < 1e-9 ? 0 : 1e3 * one)).join(", ")}) mm`; // below a nanometre is roundoff

const DIGEST = /, rig [0-9a-f]{8}$/; // of a rig profile without a name: the imports say more
const NAMED_IMPORTS = 3; // the newest; the link leads to all

function sourcesOf(about) {
  const found = {};
  for (const [name, rows] of Object.entries(about.sources)) { const kind = (SOURCES[name] || name).replace(DIGEST, ""); found[kind] = (found[kind] || 0) + rows; }
  return Object.entries(found).map(([kind, rows]) => `${count(rows)} ${kind}`).join("; ");
}

function importLinks(about, imports) {
  const view = `#/c/${encodeURIComponent(about.name)}`;
  const lines = imports.slice(0, NAMED_IMPORTS).map((one) => el("li", {}, el("a", { href: `${view}/rows?import=${one.id}` }, one.filename || `import ${one.id}`), ` (${counted(one.rows - one.withdrawn, "row")}, ${time(one.when)})`));
  return el("ul", { class: "plain" }, lines, imports.length > NAMED_IMPORTS ? el("li", {}, el("a", { href: `${view}/table` }, `all ${count(imports.length)} imports`)) : null);
}

const jobsLink = (about) => el("a", { href: `#/c/${encodeURIComponent(about.name)}/jobs` }, openJobs(about));

function method(about, report, imports, shares) {
  const cover = about.coverage, unmeasured = cover.unmeasured || [], allowed = shares?.allowed.map((one, place) => (unmeasured.includes(OUTPUTS[place]) ? null : one));
  const bars = insideBars(report);
  const tolerance = about.tolerance
    ? `${quantity(about.tolerance.translation, "m")}, ${quantity(about.tolerance.rotation, "rad")}`
    : `1 % of each output's range${allowed?.length === OUTPUTS.length ? `: ${[["u", "m", allowed.slice(0, 3)], ["r", "rad", allowed.slice(3)]].filter(([, , limits]) => limits.some((one) => one !== null)).map(([name, unit, limits]) => `${name}\u00a0${triple(limits, unit)}`).join(", ")}` : ""}`;
  const sources = sourcesOf(about), clashes = (cover.conflicts || []).flatMap((one) => one.rows);
  const jobs = Object.entries(about.jobs).filter(([, n]) => n).map(([status, n]) => pill(`${n} ${status}`, status));
  return facts([
    ["Rows", sources || "none"],
    ["Imports", imports.length ? importLinks(about, imports) : ""],
    ["Method", sources ? cover.method : ""],
    [sources ? "Reason" : "Method", about.has_fea || sources ? sentence(cover.method_reason || "–") : "The table has no rows: import measured ones."],
    ["Not measured", unmeasured.join(", ")],
    ["Tolerance", tolerance],
    ["Jobs", jobs.length ? el("a", { class: "line", href: `#/c/${encodeURIComponent(about.name)}/jobs` }, jobs) : about.has_fea ? "none" : ""],
    ["Report", bars ? [`${insideWords(bars)}${leastShare(report, bars)}, `, el("a", { href: `#/c/${encodeURIComponent(about.name)}/report` }, time(report.made))] : ""],
    ["Contradictions", cover.conflicting_wrenches ? [`${cover.conflicting_wrenches} ${cover.conflicting_wrenches === 1 ? "wrench has" : "wrenches have"} rows that disagree: `, rowLinks(about.name, clashes, 12), ". Withdraw the wrong ones."] : ""],
    ["Outside", cover.beyond_range ? pill(`${counted(cover.beyond_range, "row")} ${OUTSIDE}`, "outside") : ""],
    ["Table version", String(about.table_version)],
    ["Notes", about.notes],
  ]);
}

const CONFIDENCE = 0.95; // as in service/report/layout.py

// What a few wrenches without a miss prove: with n successes of n the least share is (1 - confidence)^(1/n), Clopper and Pearson 1934.
function leastShare({ wrenches }, { inside, all }) {
  if (inside < all || !wrenches?.compared) return "";
  return `; with ${count(wrenches.compared)} wrenches, at least ${percent((1 - CONFIDENCE) ** (1 / wrenches.compared))} of each output's true errors do so with 95 % confidence`;
}

// The range of each load, and the part of it that the table's rows reach.
function loads(about, reach) {
  const spans = spansOf(about), inputs = inputsOf(about);
  const idle = (front) => front && inputs.every((one, place) => one.interface !== front || spans[place].every((end) => !end));
  const unloaded = [...new Set(inputs.map((one) => one.interface))].filter(idle);
  const lines = inputs.map(({ name, unit, interface: front }, place) => unloaded.includes(front) ? null :
    [el("span", {}, mark(name)), number(spans[place][0]), number(spans[place][1]), unit, ...(reach ? [between(...reach[place])] : [])]).filter(Boolean);
  return [table(["Load", "#from", "#to", "unit", ...(reach ? ["#rows reach"] : [])], lines), unloaded.length ? el("p", { class: "muted small" }, `No loads at ${unloaded.join(", ")}: the range there is 0.`) : null];
}

const between = (low, high) => (low === high ? `only ${number(low, 3)}` : `${number(low, 3)} to ${number(high, 3)}`);

// The part, with the axes of its interfaces.
function pictureOf(about, signal) {
  const frames = Object.values(about.interfaces || { "": about.interface }).filter((one) => one?.point);
  if (!about.has_fea) return null;
  const picture = pictured(about.name);
  paint(picture.firstChild, about, signal, frames).catch(() => {});
  return el("div", {}, picture, frames.length ? el("p", { class: "muted small" }, "x, y, z: axes of the interface at its point, in which loads and displacements are given.") : null);
}

function contract(about) {
  const held = about.interface;
  return facts([
    ["Units", about.contract.units],
    ["Wrench", sentence(about.contract.wrench)],
    ["Displacement", sentence(about.contract.displacement)],
    ["Relative to", held?.displacement?.replace(/^relative to /, "").replace("degC", "°C")],
    ["Gravity", held?.gravity ? held.gravity.map((one) => quantity(one, "m/s²")).join(", ") : ""],
    ["Moment", sentence(about.contract.moment)],
    ["Sign", sentence(about.contract.sign)],
    ["Section", held?.section],
    ["Point", held?.point ? pointOf(held.point) : ""],
    ["Coupling", held?.coupling],
    ...Object.entries(about.interfaces || {}).map(([name, one]) => [`Interface ${name}`, `${one.section}, ${one.coupling}${one.held ? ", held" : ""}${one.point ? `, at ${pointOf(one.point)}` : ""}`]),
    ["Locked", held?.locked?.join(", ")],
  ]);
}
