// What a component is: contract, range, method, how well its table covers.

import { caughtUp, get, of, post } from "./api.js";
import { el, facts, field, note, notify, put, table } from "./dom.js";
import { listenToTable } from "./events.js";
import { beingBuilt } from "./empty.js";
import { findingNote } from "./findings.js";
import { count, number, quantity, sentence } from "./format.js";
import { inputsOf, mark, spansOf } from "./inputs.js";
import { legend, sharesOf, wholeError } from "./shares.js";

export async function show(root, { name }, signal) {
  put(root, el("p", { class: "muted" }, "…"));
  const about = await get(of(name), signal);
  const warned = el("div", { class: "stack" }), glance = el("div", { class: "stack" }, el("p", { class: "muted" }, "…"));
  const rows = el("section", { class: "card" }), range = el("section", { class: "card" });
  let latest = 0;
  const refresh = async () => {
    const mine = latest += 1; // of two at once the later one counts
    const now = await get(of(name), signal);
    if (mine !== latest) return;
    put(warned, warnings(now, signal, refresh));
    put(rows, el("h2", {}, "Method and rows"), method(now));
    put(range, el("h2", {}, "Load range"), loads(now));
    const shares = await cover(glance, now, signal, () => mine === latest);
    if (shares?.reach && mine === latest) put(range, el("h2", {}, "Load range"), loads(now, shares.reach));
  };
  put(root, warned,
    el("div", { class: "halves" },
      el("section", { class: "card" }, el("h2", {}, "Coverage"), glance, about.has_fea ? fill(about) : el("p", {}, el("a", { href: `#/c/${about.name}/table` }, "Import measured rows"), ".")),
      rows,
      range,
      el("section", { class: "card" }, el("h2", {}, "Conventions"), contract(about))));
  listenToTable(name, about.table_version, signal, () => refresh().catch(() => {}));
  await refresh();
}

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
    checked.length ? note("thin", el("strong", {}, "Warnings of the bundle check"), el("ul", {}, checked.map((one) => el("li", {}, VERB.test(textOf(one)) ? `${one.where} ${textOf(one)}` : sentence(textOf(one)).replace(/([^.])$/, "$1."))))) : null,
  ];
}

const VERB = /^(is|are|has|have|holds|keeps|counts|names|must|cannot|consists|moves|rotates|fixes|closes|lies|needs) /; // of a message that goes on after its key
const textOf = (one) => (typeof one === "string" ? one : one.message || one.msg || JSON.stringify(one));

async function cover(place, about, signal, isLatest) {
  const rows = about.space ? about.rows : (await caughtUp(about.name, signal)).of; // the rows of several inputs have no drawing to wait for
  const parts = [];
  let glance = null;
  if (rows) {
    glance = await get(`${of(about.name)}/glance`, signal);
    if (about.has_fea) parts.push(wholeError(glance, about));
    parts.push(sharesOf(glance));
    parts.push(legend(), el("p", { class: "muted small" }, `Share of the load range${about.space ? "" : ", and of each axis' three loads,"} whose interpolation error is within the tolerance${about.has_fea ? "; the first bar is of the whole error" : ""}.`));
  } else parts.push(el("p", {}, about.pending_rows ? `${beingBuilt(about.pending_rows)} …` : "The table has no rows yet."));
  if (isLatest()) put(place, parts);
  return glance;
}

// Rows of another setup: the component's files have changed since these were solved.
function resolve(about) {
  const order = async () => {
    try {
      const reply = await post(`${of(about.name)}/table/resolve`, {});
      notify(reply.jobs.length ? `${reply.jobs.length} solves are queued. ${reply.reason ? sentence(reply.reason) : ""}` : reply.reason || "Nothing to solve.");
    } catch (error) { notify(error.message, "wrong"); }
  };
  return el("button", { onclick: order }, "Solve them again");
}

function fill(about) {
  const budget = el("input", { type: "number", min: 1, max: 10000, value: 24, "aria-label": "Largest number of solves" });
  const order = async (event) => {
    event.preventDefault();
    try {
      const reply = await post(`${of(about.name)}/fill`, { budget: Number(budget.value) });
      notify(reply.jobs.length ? `${reply.jobs.length} solves are queued. ${reply.reason ? sentence(reply.reason) : ""}` : reply.reason || "Nothing to solve.");
    } catch (error) { notify(error.message, "wrong"); }
  };
  return el("form", { class: "line bottom", onsubmit: order },
    field("Largest number of solves", budget), el("button", { class: "first" }, "Fill the table"));
}

const SOURCES = { fea: "solved" };
const pointOf = (point) => point.map((one) => quantity(Math.abs(one) < 1e-9 ? 0 : one, "m")).join(", "); // below a nanometre is roundoff

function method(about) {
  const cover = about.coverage;
  const tolerance = about.tolerance
    ? `${quantity(about.tolerance.translation, "m")}, ${quantity(about.tolerance.rotation, "rad")}`
    : "1 % of each output's range";
  const sources = Object.entries(about.sources).map(([name, rows]) => `${count(rows)} ${SOURCES[name] || name}`).join("; ");
  const jobs = Object.entries(about.jobs).filter(([, n]) => n).map(([status, n]) => `${n} ${status}`).join(", ");
  return facts([
    ["Rows", sources || "none"],
    ["Method", cover.method],
    ["Why", cover.method_reason],
    ["Tolerance", tolerance],
    ["Jobs", jobs ? el("a", { href: `#/c/${encodeURIComponent(about.name)}/jobs` }, jobs) : "none"],
    ["Contradictions", cover.conflicting_wrenches ? `${cover.conflicting_wrenches} ${cover.conflicting_wrenches === 1 ? "wrench has" : "wrenches have"} rows that disagree: withdraw the wrong import under Entry` : ""],
    ["Outside the range", cover.beyond_range ? `${count(cover.beyond_range)} rows, which do not count` : ""],
    ["Version", String(about.table_version)],
    ["Notes", about.notes],
  ]);
}

// The range of each load, and the part of it that the table's rows reach.
function loads(about, reach) {
  const spans = spansOf(about);
  return table(["Load", "#from", "#to", "", ...(reach ? ["#rows reach"] : [])], inputsOf(about).map(({ name, unit }, place) =>
    [el("span", {}, mark(name)), number(spans[place][0]), number(spans[place][1]), unit, ...(reach ? [between(...reach[place])] : [])]));
}

const between = (low, high) => (low === high ? `only ${number(low, 3)}` : `${number(low, 3)} to ${number(high, 3)}`);

function contract(about) {
  const held = about.interface;
  return facts([
    ["Units", about.contract.units],
    ["Wrench", about.contract.wrench],
    ["Displacement", about.contract.displacement],
    ["Relative to", held?.displacement],
    ["Gravity", held?.gravity ? held.gravity.map((one) => quantity(one, "m/s²")).join(", ") : ""],
    ["Moment", about.contract.moment],
    ["Sign", about.contract.sign],
    ["Section", held?.section],
    ["Point", held?.point ? pointOf(held.point) : ""],
    ["Coupling", held?.coupling],
    ...Object.entries(about.interfaces || {}).map(([name, one]) => [`Interface ${name}`, `${one.section}, ${one.coupling}${one.held ? ", held" : ""}${one.point ? `, at ${pointOf(one.point)}` : ""}`]),
    ["Locked", held?.locked?.join(", ")],
  ]);
}
