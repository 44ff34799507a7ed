// What an import is body beside the file: what its columns are, what to leave out, tare.

import { cycleOptions } from "./cycle_options.js";
import { el, field, select } from "./dom.js";
import { rigOptions } from "./rig_options.js";

const LEFT_OUT = "leave out";
const COLUMNS = { fx: "N", fy: "N", fz: "N", mx: "N*m", my: "N*m", mz: "N*m", ux: "mm", uy: "mm", uz: "mm", rx: "deg", ry: "deg", rz: "deg" };
const UNITS = {
  f: ["force", ["N", "kN", "lbf", "kgf"]], m: ["moment", ["N*m", "N*mm", "kN*m", "lbf*ft", "lbf*in"]],
  u: ["translation", ["m", "mm", "um", "inch", "thou"]], r: ["rotation", ["rad", "mrad", "deg"]],
};
const MEANINGS = "column-meanings";

// `changed()` is called when anything is said otherwise.
export function importOptions(name, changed, signal) {
  const check = (text) => {
    const input = el("input", { type: "checkbox", onchange: changed });
    return [input, el("label", { class: "check" }, input, text)];
  };
  const [zero, zeroLine] = check("Loads without a column are zero");
  const [extra, extraLine] = check("Leave out all unknown columns");
  const [partial, partialLine] = check("Load the correct rows even if others have mistakes");
  const tare = el("input", { type: "number", min: 0, step: 1, value: 0, onchange: changed, id: "tare" });
  const decimal = select([["", "as in the file"], [".", "point"], [",", "comma"]], "", changed);
  const sheet = el("input", { autocomplete: "off", placeholder: "the first", onchange: changed, id: "sheet" });
  const file = el("input", { type: "file", id: "displacements", onchange: () => chosen() });
  const lag = el("input", { autocomplete: "off", placeholder: "0", onchange: changed, id: "lag" });
  const remove = el("button", { type: "button", class: "small", hidden: true, onclick: () => { file.value = ""; chosen(); } }, "Remove the second log");
  const chosen = () => { remove.hidden = !file.files[0]; changed(); };
  const logs = el("details", { id: "logs" }, el("summary", {}, "Two logs: loads and displacements in separate files"),
    el("div", { class: "stack" },
      el("p", { class: "muted small" }, "The file above is the log of the loads. Each log has a column of time; each displacement becomes a row with the loads at its time."),
      el("div", { class: "halves" }, field("Log of the displacements", file), field("Lag: seconds added to the times of the displacements, or auto", lag)), el("div", {}, remove)));
  const said = el("input", { autocomplete: "off", maxlength: 10000, id: "import-note" });
  const root = el("details", { id: "import-options" }, el("summary", {}, "Options"),
    el("div", { class: "stack" }, zeroLine, extraLine, partialLine,
      el("div", { class: "few" }, field("Tare: number of first rows, whose mean is subtracted", tare), field("Decimal mark (CSV)", decimal), field("Sheet (Excel), group (TDMS)", sheet)),
      field("Note, stored with the import", said)));
  const columns = columnTable(), rig = rigOptions(name, changed, signal), cycles = cycleOptions(changed);
  const query = () => {
    const asked = new URLSearchParams();
    if (zero.checked) asked.set("missing_loads", "zero");
    if (extra.checked) asked.set("ignore_extra", "true");
    if (partial.checked) asked.set("partial", "true");
    if (Number(tare.value) > 0) asked.set("tare", tare.value);
    if (decimal.value) asked.set("decimal", decimal.value);
    if (sheet.value.trim()) asked.set("sheet", sheet.value.trim());
    if (displacements() && lag.value.trim()) asked.set("lag", lag.value.trim());
    if (said.value.trim()) asked.set("note", said.value.trim());
    rig.tell(asked);
    cycles.tell(asked);
    columns.tell(asked);
    return asked;
  };
  const displacements = () => file.files[0];
  const correction = (seconds) => el("div", { class: "turn" }, el("button", { type: "button", class: "small", onclick: () => {
    lag.value = String(Number(seconds.toPrecision(4)));
    logs.open = true;
    changed();
  } }, `Use a lag of ${Number(seconds.toPrecision(4))} s`));
  const countAsZero = () => { zero.checked = root.open = true; changed(); };
  return { root: [logs, root, rig.root, cycles.root], query, columns, rig, displacements, correction, countAsZero };
}

// One input a column of the file: empty is as the file says.
function columnTable() {
  let inputs = new Map();
  const tell = (asked) => {
    const mapping = {};
    for (const [name, input] of inputs) {
      const meaning = input.value.trim();
      if (meaning === LEFT_OUT) asked.append("ignore", name);
      else if (meaning) mapping[name] = meaning;
    }
    if (Object.keys(mapping).length) asked.set("mapping", JSON.stringify(mapping));
  };
  const forget = () => { inputs = new Map(); };
  // `body` is the reply of a check, `errors` what it found: those of the header name their column.
  const draw = (body, errors = []) => {
    const before = inputs, known = new Map((body.columns || []).map((one) => [one.column, `${one.name}${one.unit ? ` [${one.unit}]` : ""}`]));
    const wrong = new Map(errors.filter((one) => one.row <= 1 && !["header", "file", "line", "form", "rows"].includes(one.field)).map((one) => [one.field, one.message]));
    const names = [...new Set([...known.keys(), ...(body.ignored || []), ...wrong.keys(), ...before.keys()])];
    inputs = new Map(names.map((name) => [name, el("input", {
      value: before.get(name)?.value ?? "", placeholder: known.get(name) || (wrong.has(name) ? "meaning?" : LEFT_OUT),
      list: MEANINGS, "aria-label": `What ${name} is`, autocomplete: "off", spellcheck: "false",
    })]));
    const bare = [...wrong].map(([name, message]) => [name, message.match(/has no unit; write for example (\w+) \[/)?.[1]]).filter(([, one]) => one);
    return el("details", { id: "columns", open: wrong.size > 0 || [...before.values()].some((one) => one.value) },
      el("summary", {}, "Meaning of the columns"),
      el("p", { class: "muted small" }, `Empty: as the file says. Otherwise a name with its unit, such as fz [kN]; a - before it reverses the sign; or “${LEFT_OUT}”.`),
      el("div", { class: "stack" }, bare.length ? unitsOf(bare, inputs) : null,
        meanings(), el("div", { class: "few columns" }, names.map((name) => field(name, inputs.get(name))))));
  };
  return { draw, tell, forget };
}

// The units of all columns that name none, at once.
function unitsOf(bare, inputs) {
  const kinds = [...new Set(bare.map(([, name]) => name[0]))].filter((one) => UNITS[one]);
  const chosen = kinds.map((kind) => [kind, select([["", "–"], ...UNITS[kind][1].map((one) => [one, one.replace("*", "·").replace("um", "µm")])], "", () => {
    for (const [column, name] of bare) if (name[0] === kind) inputs.get(column).value = chosen_(kind) ? `${name} [${chosen_(kind)}]` : "";
  })]);
  const chosen_ = (kind) => chosen.find(([one]) => one === kind)[1].value;
  return el("fieldset", {}, el("legend", {}, "Units of the columns that name none"),
    el("div", { class: "few" }, chosen.map(([kind, one]) => field(UNITS[kind][0][0].toUpperCase() + UNITS[kind][0].slice(1), one))));
}

function meanings() {
  const some = Object.entries(COLUMNS).flatMap(([name, unit]) => [`${name} [${unit}]`, `-${name} [${unit}]`]);
  return el("datalist", { id: MEANINGS }, [LEFT_OUT, ...some].map((value) => el("option", { value })));
}
