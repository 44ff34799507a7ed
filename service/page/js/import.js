// Import: the server checks a dropped file first; the user can correct its bad rows here.

import { caughtUp, get, of, send, trouble } from "./api.js";
import { isLines, lineOf, readText, withLine } from "./csv_text.js";
import { dropPlace, el, note, put, table, working } from "./dom.js";
import { findingNote } from "./findings.js";
import { LOADS, OUTPUTS, count, counted, number, plain, sentence, unitOfLoad, unitOfOutput } from "./format.js";
import { importOptions } from "./import_options.js";

const MAX_MISTAKES = 50; // bad rows in the list: each has an input field
const PREVIEWED = 5; // correct rows in the preview before an import
const ZERO_REMEDY = "set missing_loads=zero (--missing-loads-zero)"; // in the server's message on loads without a column; the page has a button
const TYPES = { csv: "text/csv", txt: "text/csv", tsv: "text/csv", json: "application/json", h5: "application/x-hdf5", hdf5: "application/x-hdf5" };

export function importForm(about, signal) {
  const state = { file: null, text: null, checks: 0, about, signal, place: el("div", { class: "stack", "aria-live": "polite", id: "checked" }) };
  // A field fires at each blur; the same options need no second check.
  state.options = importOptions(about.name, () => { if (state.file && optionsOf(state) !== state.checked) check(state); }, signal);
  const take = async (file) => {
    if (!file) return;
    state.file = file;
    const dropped = new DataTransfer();
    dropped.items.add(file);
    input.files = dropped.files; // the field names a dropped file too
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

// The body of the request: one file, or two logs in a form.
function requestBody(state, type, displacements) {
  const body = state.text ?? state.file;
  if (!displacements) return { body, headers: { "Content-Type": type } };
  const form = new FormData();
  form.set("loads", new Blob([body]), state.file.name);
  form.set("displacements", displacements);
  return { body: form };
}

async function post(state, dry) {
  const type = TYPES[state.file.name.toLowerCase().split(".").at(-1)] || "application/octet-stream";
  const query = state.options.query(), displacements = state.options.displacements();
  query.set("dry_run", dry);
  if (dry) state.checked = optionsOf(state);
  query.set("filename", [state.file.name, displacements?.name].filter(Boolean).join(", ").slice(0, 1000));
  if (dry) query.set("preview", PREVIEWED);
  const reply = await send("POST", `${of(state.about.name)}/table?${query}`, {
    ...requestBody(state, type, displacements), signal: state.signal,
  });
  return reply.json();
}

async function check(state) {
  const current = ++state.checks; // the latest of concurrent checks is shown
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
  if (current !== state.checks) return;
  put(state.place, shown);
  state.place.scrollIntoView({ block: "nearest" }); // below the options on a telephone
}

function ready(state, result) {
  return [
    note("covered", el("strong", {}, `${state.file.name}: ${counted(result.rows.read, "row")} read without mistakes.`), tallies(result)),
    ...findings(state, result.findings), preview(state, result), state.options.columns.draw(result), beyondRange(result), el("div", { class: "line" }, importButton(state, result), again(state)),
  ];
}

const rowsAre = (rows) => `${counted(rows, "row")} ${rows === 1 ? "is" : "are"}`;
function beyondRange({ beyond_range: rows }) {
  return rows ? note("thin", el("span", {}, `${rowsAre(rows)} outside the load range of the component. Answers there are flagged as outside: check the units of the loads, or widen the range.`)) : null;
}

function importButton(state, result) {
  const button = el("button", { type: "button", class: "first", id: "import", onclick: () => load(state, result) }, `Import ${counted(result.inserted, "row")}`);
  button.disabled = result.inserted === 0;
  return button;
}

function again(state, applyEdits = () => {}) {
  return el("div", {}, el("button", { type: "button", id: "check-again", onclick: () => { applyEdits(); check(state); } }, "Check again"));
}

// Each row of the file is counted once.
function tallies(result) {
  const { read, refused, tare, unmatched, skipped, branch, averaged } = result.rows;
  const part = (rows, text) => (rows ? `, ${count(rows)} ${text}` : "");
  return [
    el("span", {}, `${count(result.inserted)} new rows${part(result.existing, "are in the table already")}${part(result.restored, "of them restored")}${read === result.inserted ? "" : `; ${count(read)} read`}${part(refused, "refused")}${part(tare, "taken as tare")}${part(unmatched, "without a load at their time")}${part(skipped, "of skipped cycles")}${part(branch, "off the branch")}${part(averaged, "in the mean of others")}.`),
    result.clock ? el("span", {}, `Clocks: ${number(result.clock.applied_s)} s added to the times of the displacements; ${result.clock.lag_s === null ? "the logs do not show a lag" : `the logs show ${number(result.clock.lag_s)} ± ${number(result.clock.uncertainty_s, 1)} s`}.`) : null,
    result.ignored?.length ? el("span", {}, `Columns left out: ${result.ignored.join(", ")}.`) : null,
    result.sheets?.length > 1 ? el("span", {}, `Sheet ${result.sheet} was read, of ${result.sheets.join(", ")}.`) : null,
  ];
}

function findings(state, list, importId) {
  return (list || []).map((finding) => {
    const shown = findingNote(state.about.name, finding, importId, state.signal);
    if (!importId) shown.append(...[finding.lever && state.options.rig.corrections(finding.lever), finding.lag && state.options.correction(finding.lag)].filter(Boolean));
    return shown;
  });
}

function preview(state, result) {
  if (!result.preview?.length) return null;
  const correct = result.inserted + result.existing;
  const inFile = new Map((result.columns || []).map(({ name, unit }) => [name.replace("-", ""), unit?.replace("*", "·").replace("um", "µm")]));
  const headOf = (name, text, unit) => `#${text}, ${unit}${inFile.get(name) && inFile.get(name) !== unit ? ` (file: ${inFile.get(name)})` : ""}`;
  const head = [state.text ? "#line" : "#row", ...LOADS.map((load) => headOf(load, plain(load), unitOfLoad(load))), ...OUTPUTS.map((output) => headOf(output, output, unitOfOutput(output)))];
  const lines = result.preview.map((row) => [String(row.row), ...[...row.wrench, ...row.displacement].map((value) => number(value, 5))]);
  const shown = table(head, lines, { scrolls: true, caption: `${result.preview.length < correct ? `The first ${result.preview.length} of ${counted(correct, "correct row")}` : "The correct rows"}, in SI` });
  shown.id = "preview";
  return shown;
}

async function load(state, checked) {
  put(state.place, working(`Step 1 of 2: ${count(checked.inserted)} rows are written to the ledger …`));
  try {
    const result = await post(state, false);
    put(state.place, working(`Step 2 of 2: ${count(result.inserted)} rows are saved; the table is built. This view may be left …`));
    await caughtUp(state.about.name, state.signal);
    const record = result.import ? (await get(`${of(state.about.name)}/imports`, state.signal)).imports.find(({ id }) => id === result.import) : null;
    const name = encodeURIComponent(state.about.name);
    put(state.place, note("covered", el("strong", {}, `${rowsAre(result.inserted)} in the table.`), result.errors.length || result.existing || result.rows.read !== result.rows.loaded ? tallies(result) : null,
      el("span", {}, el("a", { href: `#/c/${name}/query` }, "Query it"), ", or see ", el("a", { href: `#/c/${name}/rows?import=${result.import ?? ""}` }, "the rows"), `. This is table version ${result.table_version}; the import is in the list below, which can withdraw it.`)),
    ...findings(state, record?.findings || result.findings, record?.id));
  } catch (error) { if (!state.signal.aborted) put(state.place, trouble(error)); }
}

// The mistakes by row; each row of a text file has its line in an input field.
function mistakes(state, errors, result) {
  const isNoTable = !result.columns?.length && errors.every(({ row, field }) => row === 0 && field === "file");
  if (isNoTable) return note("outside", el("strong", {}, `${state.file.name} is not read as a table; nothing was loaded.`), errors.map(({ message }) => el("span", {}, sentence(withPageOptions(message)))));
  const byRow = new Map();
  if (errors.some(({ field }) => field === "load_cell")) state.options.rig.root.open = true; // it has the choice
  for (const error of errors) byRow.set(error.row, [...(byRow.get(error.row) || []), error]);
  const shown = [...byRow].slice(0, MAX_MISTAKES), edits = new Map(), isEditable = state.text && !state.options.displacements();
  const applyEdits = () => { for (const [row, input] of edits) state.text = withLine(state.text, row, input.value.replace(/[\r\n]+/g, " ")); };
  const ofHeader = errors.every(({ row }) => row === 1) && result.rows?.read === 0 && !result.rows.refused; // the server reads no rows below such a header
  const decisions = [...byRow.values()].reduce((sum, list) => sum + alike(list).length, 0);
  const named = ofHeader ? `the header needs ${decisions === 1 ? "a decision" : `${decisions} decisions`}` : `${count(byRow.size)} ${byRow.size === 1 ? "row has a mistake" : "rows have mistakes"}`;
  return [
    note("outside", el("strong", {}, `${state.file.name}: ${named}; nothing was loaded.`), result.inserted ? tallies(result) : null,
      byRow.size > MAX_MISTAKES ? el("span", {}, `The first ${MAX_MISTAKES} are shown.`) : null),
    ofHeader ? null : causes(result.causes || []),
    el("div", { class: "stack", id: "mistakes" }, shown.map(([row, list]) => mistake(isEditable && state.text, row, list, edits))),
    result.columns || byRow.has(1) || byRow.has(0) ? state.options.columns.draw(result, errors) : null,
    errors.some(({ message }) => message.includes(ZERO_REMEDY)) ? el("div", {}, el("button", { type: "button", class: "first", id: "zero-loads", onclick: state.options.countAsZero }, "Count missing loads as zero")) : null,
    edits.size ? null : el("p", { class: "muted" }, "Correct them in the file and drop it again, or change the options here."),
    again(state, applyEdits),
    result.partial && result.inserted ? [preview(state, result), beyondRange(result), el("div", {}, importButton(state, result))] : null,
  ];
}

// A message of the server with the page's own options in place of those of the command line.
const withPageOptions = (message) => message.replace(ZERO_REMEDY, "count them as zero")
  .replace(/Rename it, map it with mapping \(--column '.*?'\), or skip it with ignore \(--ignore '.*?'\)/, "Choose what it is, or “leave out”, under Meaning of the columns")
  .replace(/set load_cell=moving \(--load-cell moving\), else load_cell=fixed/, "choose “moves with the interface” as load cell, else “stays on the ground”")
  .replace(/; leave one out with ignore \(--ignore\)/, "; leave one out under Meaning of the columns")
  .replace(/name one by mapping, such as --column '.*'/, "choose one under Meaning of the columns")
  .replace("also send the log of the displacements: displacements=FILE (--displacements FILE)", "add the log of the displacements under “Two logs”")
  .replace(/ with mapping \(--column '.*?'\)/, " under Meaning of the columns")
  .replaceAll(/ \(--[^)]*\)/g, "");

// Each mistake of several rows once, with its count.
function causes(list) {
  const common = list.filter((cause) => cause.count > 1);
  return common.length ? el("ul", { id: "causes" }, common.map((cause) => el("li", {}, `${count(cause.count)} mistakes`, cause.fields.map((field) => [", ", el("code", {}, field)]), ": ", withPageOptions(cause.message)))) : null;
}

// Groups the mistakes of one row whose messages differ by the column's name alone.
function alike(list) {
  const groups = new Map();
  for (const mistake of list) {
    const { field, message } = mistake, text = withPageOptions(message);
    const key = field ? text.toLowerCase().replaceAll(`${field.toLowerCase()} [`, "[") : text;
    groups.set(key, [...(groups.get(key) || []), mistake]);
  }
  return [...groups.values()];
}

function mistake(text, row, list, edits) {
  const messages = el("ul", {}, alike(list).map((group) => {
    const fields = group.flatMap(({ field }, k) => (field ? [k ? ", " : "", el("code", {}, field)] : []));
    const text = withPageOptions(group[0].message);
    const plural = text.replace("is not a known column", "are not known columns").replace("Choose what it is", "Choose what each is");
    return el("li", {}, fields, group[0].field ? ": " : "", group.length > 1 ? plural : text);
  }));
  const title = el("strong", {}, row === 0 ? "The file" : text ? `Line ${row}` : `Row ${row}`);
  if (!text || row === 0) return el("div", { class: "note" }, title, messages);
  const line = lineOf(text, row); // a textarea wraps a long line
  const input = el("textarea", { value: line, class: "line-of-file", rows: Math.min(12, 1 + Math.ceil(line.length / 40)), "aria-label": `Line ${row}`, spellcheck: "false" });
  edits.set(row, input);
  return el("div", { class: "note" }, title, messages, input);
}
