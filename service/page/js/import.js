// Import: a dropped file is checked first; bad rows are named and can be mended here.

import { caughtUp, get, of, send, trouble } from "./api.js";
import { isLines, lineOf, readText, withLine } from "./csv_text.js";
import { dropPlace, el, note, put, table, working } from "./dom.js";
import { findingNote } from "./findings.js";
import { LOADS, OUTPUTS, count, number, plain, sentence, unitOfLoad, unitOfOutput } from "./format.js";
import { importOptions } from "./import_options.js";

const MENDED = 50; // bad rows that are offered for mending at a time
const SHOWN = 5; // good rows that are shown before an import
const ZERO = "set missing_loads=zero (--missing-loads-zero)"; // of the server's message on loads without a column; the page has a button
const TYPES = { csv: "text/csv", txt: "text/csv", tsv: "text/csv", json: "application/json", h5: "application/x-hdf5", hdf5: "application/x-hdf5" };

export function importForm(about, signal) {
  const state = { file: null, text: null, about, signal, place: el("div", { class: "stack", "aria-live": "polite", id: "checked" }) };
  // A field that is left tells of a change that a check may know already.
  state.options = importOptions(about.name, () => { if (state.file && optionsOf(state) !== state.checked) check(state); }, signal);
  const take = async (file) => {
    if (!file) return;
    state.file = file;
    state.options.columns.forget();
    const text = await readText(file);
    state.text = isLines(text) ? text : null;
    await check(state);
  };
  const input = el("input", { type: "file", id: "file", "aria-label": "A table file", onchange: () => take(input.files[0]) });
  const drop = dropPlace(take, el("strong", {}, "Drop a table here, or choose a file"),
    el("span", { class: "small" }, "CSV with a header such as Fz [N], ux [mm]; Excel, Parquet, JSON, HDF5, MATLAB, LabVIEW, TDMS; each gzipped or not. The file is checked first; rows are loaded only after you confirm."), input);
  return [drop, state.options.root, state.place];
}

const optionsOf = ({ options }) => `${options.query()} ${options.displacements()?.name}`;

// The body of the call: one file, or two logs in a form.
function sent(state, type, displacements) {
  const body = state.text ?? state.file;
  if (!displacements) return { body, headers: { "Content-Type": type } };
  const form = new FormData();
  form.set("loads", new Blob([body]), state.file.name);
  form.set("displacements", displacements);
  return { body: form };
}

async function post(state, dry) {
  const ending = state.file.name.toLowerCase().replace(/\.gz$/, "").split(".").at(-1);
  const type = state.file.name.endsWith(".gz") ? "application/octet-stream" : TYPES[ending] || "application/octet-stream";
  const asked = state.options.query();
  asked.set("dry_run", dry);
  const { displacements } = state.options;
  if (dry) state.checked = optionsOf(state);
  asked.set("filename", [state.file.name, displacements()?.name].filter(Boolean).join(", ").slice(0, 1000));
  if (dry) asked.set("preview", SHOWN);
  const reply = await send("POST", `${of(state.about.name)}/table?${asked}`, {
    ...sent(state, type, displacements()), signal: state.signal,
  });
  return reply.json();
}

async function check(state) {
  state.check = (state.check || 0) + 1;
  const mine = state.check; // of two at once the later one counts
  put(state.place, working(`${state.file.name} is read and checked …`));
  let shown;
  try {
    const result = await post(state, true);
    state.options.rig.show(result.rig);
    shown = result.errors.length ? mistakes(state, result.errors, result) : ready(state, result);
  } catch (error) {
    if (state.signal.aborted) return;
    const errors = error.body?.errors;
    shown = errors?.[0]?.row !== undefined ? mistakes(state, errors, error.body) : trouble(error);
  }
  if (mine !== state.check) return;
  put(state.place, shown);
  state.place.scrollIntoView({ block: "nearest" }); // below the options on a telephone
}

function ready(state, result) {
  return [
    note("covered", el("strong", {}, `${state.file.name}: ${count(result.rows.read)} ${result.rows.read === 1 ? "row" : "rows"} read without mistakes.`), tallies(result)),
    ...findings(state, result.findings), preview(result), state.options.columns.draw(result), beyondRange(result), el("div", { class: "line" }, importButton(state, result), again(state)),
  ];
}

function beyondRange({ beyond_range: rows }) {
  return rows ? note("thin", el("span", {}, `${rows === 1 ? "1 row is" : `${count(rows)} rows are`} outside the load range of the component. Answers there are flagged as outside: check the units of the loads, or widen the range.`)) : null;
}

function importButton(state, result) {
  const button = el("button", { type: "button", class: "first", id: "import", onclick: () => load(state, result) }, `Import ${count(result.inserted)} ${result.inserted === 1 ? "row" : "rows"}`);
  button.disabled = result.inserted === 0;
  return button;
}

function again(state, mend = () => {}) {
  return el("div", {}, el("button", { type: "button", id: "check-again", onclick: () => { mend(); check(state); } }, "Check again"));
}

// Each row of the file is counted once.
function tallies(result) {
  const { read, refused, tare, unmatched, skipped, branch, averaged } = result.rows;
  return [
    el("span", {}, `${count(result.inserted)} new rows${result.existing ? `, ${count(result.existing)} are in the table already` : ""}${result.restored ? `, ${count(result.restored)} of them restored` : ""}; ${count(read)} read${refused ? `, ${count(refused)} refused` : ""}${tare ? `, ${count(tare)} taken as tare` : ""}${unmatched ? `, ${count(unmatched)} without a load at their time` : ""}${skipped ? `, ${count(skipped)} of skipped cycles` : ""}${branch ? `, ${count(branch)} off the branch` : ""}${averaged ? `, ${count(averaged)} in the mean of others` : ""}.`),
    result.clock ? el("span", {}, `Clocks: ${number(result.clock.applied_s)} s added to the times of the displacements; ${result.clock.lag_s === null ? "the logs do not show a lag" : `the logs show ${number(result.clock.lag_s)} ± ${number(result.clock.uncertainty_s, 1)} s`}.`) : null,
    result.ignored?.length ? el("span", {}, `Columns left out: ${result.ignored.join(", ")}.`) : null,
    result.sheets?.length > 1 ? el("span", {}, `Sheet ${result.sheet} was read, of ${result.sheets.join(", ")}.`) : null,
  ];
}

function findings(state, found, number) {
  return (found || []).map((one) => {
    const shown = findingNote(state.about.name, one, number, state.signal);
    if (!number) shown.append(...[one.lever && state.options.rig.corrections(one.lever), one.lag && state.options.correction(one.lag)].filter(Boolean));
    return shown;
  });
}

function preview(result) {
  if (!result.preview?.length) return null;
  const inFile = new Map((result.columns || []).map(({ name, unit }) => [name.replace("-", ""), unit?.replace("*", "·").replace("um", "µm")]));
  const headOf = (name, text, unit) => `#${text}, ${unit}${inFile.get(name) && inFile.get(name) !== unit ? ` (file: ${inFile.get(name)})` : ""}`;
  const head = ["#row", ...LOADS.map((one) => headOf(one, plain(one), unitOfLoad(one))), ...OUTPUTS.map((one) => headOf(one, one, unitOfOutput(one)))];
  const lines = result.preview.map((one) => [String(one.row), ...[...one.wrench, ...one.displacement].map((value) => number(value, 5))]);
  const shown = table(head, lines, { scrolls: true, caption: "The first correct rows, in SI" });
  shown.id = "preview";
  return shown;
}

async function load(state, checked) {
  put(state.place, working(`Step 1 of 2: ${count(checked.inserted)} rows are written to the ledger …`));
  try {
    const result = await post(state, false);
    put(state.place, working(`Step 2 of 2: ${count(result.inserted)} rows are saved; the table is built. This view may be left …`));
    await caughtUp(state.about.name, state.signal);
    const kept = result.import ? (await get(`${of(state.about.name)}/imports`, state.signal)).imports.find((one) => one.id === result.import) : null;
    const name = encodeURIComponent(state.about.name);
    put(state.place, note("covered", el("strong", {}, `${result.inserted === 1 ? "1 row is" : `${count(result.inserted)} rows are`} in the table.`), result.errors.length || result.existing || result.rows.read !== result.rows.loaded ? tallies(result) : null,
      el("span", {}, el("a", { href: `#/c/${name}/query` }, "Query it"), ", or see ", el("a", { href: `#/c/${name}/rows?import=${result.import ?? ""}` }, "the rows"), `. This is table version ${result.table_version}; the import is in the list below, which can withdraw it.`)),
    ...findings(state, kept?.findings || result.findings, kept?.id));
  } catch (error) { if (!state.signal.aborted) put(state.place, trouble(error)); }
}

// The mistakes by row, each row with its line to mend where the file is text.
function mistakes(state, errors, result) {
  const isNoTable = errors.every((one) => one.row === 0) && !result.columns?.length && errors.every((one) => one.field === "file");
  if (isNoTable) return note("outside", el("strong", {}, `${state.file.name} is not read as a table; nothing was loaded.`), errors.map((one) => el("span", {}, sentence(pageWords(one.message)))));
  const byRow = new Map();
  if (errors.some((one) => one.field === "load_cell")) state.options.rig.root.open = true; // it has the choice
  for (const one of errors) byRow.set(one.row, [...(byRow.get(one.row) || []), one]);
  const shown = [...byRow].slice(0, MENDED), edits = new Map(), mended = state.text && !state.options.displacements();
  const mend = () => { for (const [row, input] of edits) state.text = withLine(state.text, row, input.value.replace(/[\r\n]+/g, " ")); };
  const ofHeader = errors.every((one) => one.row === 1) && result.rows?.read === 0 && !result.rows.refused; // and so the rows were not read
  const decisions = [...byRow.values()].reduce((sum, list) => sum + alike(list).length, 0);
  const named = ofHeader ? `the header needs ${decisions === 1 ? "a decision" : `${decisions} decisions`}` : `${count(byRow.size)} ${byRow.size === 1 ? "row has a mistake" : "rows have mistakes"}`;
  return [
    note("outside", el("strong", {}, `${state.file.name}: ${named}; nothing was loaded.`), result.inserted ? tallies(result) : null,
      byRow.size > MENDED ? el("span", {}, `The first ${MENDED} are shown.`) : null),
    ofHeader ? null : causes(result.causes || []),
    el("div", { class: "stack", id: "mistakes" }, shown.map(([row, list]) => mistake(mended && state.text, row, list, edits))),
    result.columns || byRow.has(1) || byRow.has(0) ? state.options.columns.draw(result, errors) : null,
    errors.some((one) => one.message.includes(ZERO)) ? el("div", {}, el("button", { type: "button", class: "first", id: "zero-loads", onclick: state.options.countAsZero }, "Count missing loads as zero")) : null,
    edits.size ? null : el("p", { class: "muted" }, "Correct them in the file and drop it again, or change the options here."),
    again(state, mend),
    result.partial && result.inserted ? [preview(result), beyondRange(result), el("div", {}, importButton(state, result))] : null,
  ];
}

// A message of the server with the page's own options in place of those of the command line.
const pageWords = (message) => message.replace(ZERO, "count them as zero")
  .replace(/Rename it, map it with mapping \(--column '.*?'\), or skip it with ignore \(--ignore '.*?'\)/, "Choose what it is, or “leave out”, under Meaning of the columns")
  .replace(/set load_cell=moving \(--load-cell moving\), else load_cell=fixed/, "choose “moves with the interface” as load cell, else “stays on the ground”")
  .replace(/; leave one out with ignore \(--ignore\)/, "; leave one out under Meaning of the columns")
  .replace(/name one by mapping, such as --column '.*'/, "choose one under Meaning of the columns")
  .replace("also send the log of the displacements: displacements=FILE (--displacements FILE)", "add the log of the displacements under “Two logs”")
  .replace(/ with mapping \(--column '.*?'\)/, " under Meaning of the columns")
  .replaceAll(/ \(--[^)]*\)/g, "");

// What many rows have in common, once with its count.
function causes(list) {
  const common = list.filter((one) => one.count > 1);
  return common.length ? el("ul", { id: "causes" }, common.map((one) => el("li", {}, `${count(one.count)} mistakes`, one.fields.map((field) => [", ", el("code", {}, field)]), ": ", pageWords(one.message)))) : null;
}

// Mistakes of one row that differ by the column's name alone, together: each sentence is there once.
function alike(list) {
  const found = new Map();
  for (const one of list) {
    const words = one.field ? pageWords(one.message).toLowerCase().replaceAll(`${one.field.toLowerCase()} [`, "[") : pageWords(one.message);
    found.set(words, [...(found.get(words) || []), one]);
  }
  return [...found.values()];
}

function mistake(text, row, list, edits) {
  const words = el("ul", {}, alike(list).map((group) => el("li", {}, group.flatMap((one, k) => (one.field ? [k ? ", " : "", el("code", {}, one.field)] : [])), group[0].field ? ": " : "", group.length > 1 ? pageWords(group[0].message).replace("is not a known column", "are not known columns").replace("Choose what it is", "Choose what each is") : pageWords(group[0].message))));
  const title = el("strong", {}, row === 0 ? "The file" : text ? `Line ${row}` : `Row ${row}`);
  if (!text || row === 0) return el("div", { class: "note" }, title, words);
  const line = lineOf(text, row); // wrapped: its last cell is seen too
  const input = el("textarea", { value: line, class: "line-of-file", rows: Math.min(12, 1 + Math.ceil(line.length / 40)), "aria-label": `Line ${row}`, spellcheck: "false" });
  edits.set(row, input);
  return el("div", { class: "note" }, title, words, input);
}
