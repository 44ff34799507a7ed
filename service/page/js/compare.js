// Measured rows beside the answer of the solves alone, or of another import's rows.

import { get, of, send, trouble } from "./api.js";
import { choice, el, field, put, save, select, table, working } from "./dom.js";
import { empty, emptyTable, linkTo } from "./empty.js";
import { LOADS, OUTPUTS, count, counted, largestOf, marked, number, plain, prefixOf, rounded, symbol, unitOfLoad, unitOfOutput, withBar } from "./format.js";
import { draw, faint } from "./plot.js";

const PLOTS = ["over-load", "over-order", "over-expected"];

export async function show(root, about, signal) {
  if (!about.rows) {
    put(root, emptyTable(about, "There are no rows to compare yet."));
    return;
  }
  const { imports } = await get(`${of(about.name)}/imports`, signal);
  const names = imports.filter((one) => one.format !== "copy" && one.withdrawn < one.rows).map((one) => [String(one.id), `Import ${one.id}${one.filename ? `, ${one.filename}` : ""}`]);
  if (!about.solved && names.length < 2) { // of one import there is nothing to compare it with
    put(root, empty("Compare needs two imports of measured rows: the newest is shown beside the oldest.", linkTo(about, "table", "Import rows")));
    return;
  }
  const state = { number: "", against: about.solved || !names.length ? "" : names.at(-1)[0], load: "fz", output: "uz", reply: null, drawings: [] };
  if (!about.solved) state.number = names[0][0];
  const places = PLOTS.map((id) => el("div", { class: "plot low", id }));
  const facts = el("div", { class: "stack", "aria-live": "polite" }), below = el("div"), axes = el("div", { class: "line bottom" });
  const query = () => new URLSearchParams(Object.entries({ import: state.number, against: state.against }).filter(([, value]) => value));
  const again = () => state.drawings.forEach((one, k) => { one.again(); places[k].setAttribute("aria-label", label(state, k)); });
  let latest = null;
  const load = async () => {
    const asked = latest = String(query());
    put(facts, working("The rows are compared …"));
    put(axes);
    put(below);
    [...places, marks, saved].forEach((one) => { one.hidden = true; });
    try {
      const reply = await get(`${of(about.name)}/comparison?${asked}`, signal);
      if (asked !== latest) return; // another choice was made meanwhile
      reply.reason ||= nothing(reply);
      state.reply = reply;
      const first = ["output", "load"].map((kind) => varying(state.reply, kind));
      if (!first[0].includes(state.output)) [state.output] = first[0];
      if (!first[1].includes(state.load)) [state.load] = first[1];
      const bar = (kind, text, list) => choice(kind, text, list.map((name) => [name, symbol(name)]), state[kind], (value) => { state[kind] = value; again(); });
      put(axes, state.reply.reason ? null : [bar("output", "Output", first[0]), bar("load", "Over", first[1])]);
      put(facts, words(state.reply, about));
      [...places, marks, saved].forEach((one) => { one.hidden = Boolean(state.reply.reason); });
      if (state.reply.reason) return;
      put(marks, key(state.reply));
      put(below, factors(state.reply));
      if (!state.drawings.length) for (const [k, place] of places.entries()) state.drawings.push(await draw(place, (shade) => picture(state, k, shade), signal, label(state, k)));
      again();
    } catch (error) {
      if (signal.aborted || asked !== latest) return;
      put(facts, trouble(error));
    }
  };
  const take = async () => {
    try {
      const asked = query();
      asked.set("format", "csv");
      save(await (await send("GET", `${of(about.name)}/comparison?${asked}`)).blob(), `${about.name}-comparison.csv`);
    } catch (error) { put(facts, trouble(error)); }
  };
  const marks = el("ul", { class: "key-of-marks" }), saved = el("div", {}, el("button", { type: "button", onclick: take }, "Rows as CSV"));
  const chosen = (kind, none) => select([...none, ...names], state[kind], (value) => { state[kind] = value; load(); });
  const compared = chosen("number", [["", "All measured rows"]]), reference = chosen("against", about.solved ? [["", "The solves alone"]] : []);
  compared.id = "compared";
  reference.id = "reference";
  put(root, el("section", { class: "card stack" },
    el("div", { class: "few" }, field("Measured", compared), field("Reference", reference)),
    facts, axes, places, marks, below, saved));
  await load();
}

// The outputs that are compared, or the loads that act.
function varying(reply, kind) {
  const compared = OUTPUTS.filter((name) => reply.outputs[name].compared);
  if (kind === "output") return compared.length ? compared : OUTPUTS;
  const acting = LOADS.filter((_, k) => reply.wrench.some((one) => one[k] !== 0));
  return acting.length ? acting : LOADS;
}

// Why the plots would be empty, though rows are compared.
const nothing = (reply) => (Object.values(reply.outputs).some((one) => one.compared) ? "" : "no measured row lies where the reference has an answer. Choose another reference, or solve or import rows at these loads");

const are = (value) => `${count(value)} ${value === 1 ? "is" : "are"}`;

function words(reply, about) {
  const { reference, coverages } = reply, unanswered = Math.max(...Object.values(reply.outputs).map((one) => one.unanswered));
  if (reply.reason) return empty(`Nothing is compared: ${reply.reason}.`, linkTo(about, "table", "Import rows"));
  const by = reference.import === null ? "the answer of the solves alone" : `a ${reference.method} of the rows of import ${reference.import}`;
  const parts = [
    `${count(reply.compared)} of ${count(reply.measured)} measured ${reply.measured === 1 ? "row" : "rows"}${reply.compared < reply.measured - reply.beyond_range ? ", evenly chosen," : ""} beside ${by} (${count(reference.rows)}${reference.rows < reference.of ? ` of ${count(reference.of)}` : ""} ${reference.of === 1 ? "row" : "rows"}).`,
    unanswered ? `${are(unanswered)} outside its rows and ${unanswered === 1 ? "has" : "have"} no answer.` : "",
    coverages.thin ? `${are(coverages.thin)} where its rows are thin.` : "",
    reply.beyond_range ? `${are(reply.beyond_range)} outside the load range.` : "",
    reference.bars_are_complete ? "" : "Its bars are not known, since the solver's own error is not.",
    "A residual within the bars of reference and reading is no difference.",
  ];
  return el("p", {}, parts.filter(Boolean).join(" "));
}

function factors(reply) {
  const lines = [], several = reply.campaigns.length > 1;
  for (const part of [{ import: "all", outputs: reply.outputs }, ...(several ? reply.campaigns : [])]) {
    const sizes = Object.fromEntries(["u", "r"].map((kind) => [kind, largestOf(Object.entries(part.outputs).filter(([name]) => name[0] === kind).flatMap(([, one]) => [one.mean, one.rms]))]));
    for (const [name, one] of Object.entries(part.outputs)) {
      if (!one.compared) continue;
      const sure = one.half_width !== null && one.half_width < Math.abs(one.factor);
      const factor = rounded(one.factor ?? 0, one.half_width), spread = withBar(one.mean, one.rms, unitOfOutput(name), sizes[name[0]]);
      lines.push([...(several ? [part.import === null ? "none" : String(part.import)] : []), symbol(name),
        one.half_width === null ? number(one.factor, 5) : sure ? factor.value : "not determined", one.half_width === null ? "unknown" : sure ? `± ${factor.bar}` : "–", one.of_reference === null ? "unknown" : sure ? `± ${number(one.of_reference, 2)}` : "–",
        spread.value, one.rms ? spread.bar.replace("± ", "") : spread.value, `${count(one.beyond_bars)} of ${count(one.compared)}`]);
    }
  }
  return table([...(several ? ["Import"] : []), "Output", "#Measured / reference", "#95 % bound", "#Part from the reference", "#Mean residual", "#RMS residual", "#Beyond the bars"], lines, { scrolls: true, class: "folds named" });
}

function label({ reply, output, load }, k) {
  const over = [plain(load), "the order of the rows", "the reference's answer"][k];
  return `${k === 2 ? "Measured" : "Residual of"} ${plain(output)} over ${over}, ${counted(reply.compared, "row")}`;
}

function picture({ reply, output, load }, k, shade) {
  const at = OUTPUTS.indexOf(output), column = (name) => reply[name].map((one) => one[at]);
  const expected = column("expected"), values = k === 2 ? column("displacement") : column("residual"), bars = column("bar");
  const largest = values.reduce((most, one) => Math.max(most, Math.abs(one ?? 0)), 0);
  const [scale, prefix] = prefixOf(largest), scaled = (list) => list.map((one) => (one === null ? null : one / scale));
  const x = [reply.wrench.map((one) => one[LOADS.indexOf(load)]), reply.row, scaled(expected)][k];
  const unit = `${prefix}${unitOfOutput(output)}`, data = [], colours = [shade.accent, shade.query, shade.covered, shade.outside];
  if (k < 2) data.push(band(x, scaled(bars), shade));
  else {
    const known = x.filter((one) => one !== null), ends = known.length ? [known.reduce((a, b) => Math.min(a, b)), known.reduce((a, b) => Math.max(a, b))] : [0, 0], { factor } = reply.outputs[output];
    data.push({ x: ends, y: ends, mode: "lines", line: { color: shade.muted, dash: "dot" }, hoverinfo: "skip", showlegend: false });
    if (factor !== null) data.push({ x: ends, y: ends.map((one) => factor * one), mode: "lines", line: { color: shade.ink, width: 1.5 }, hoverinfo: "skip", showlegend: false });
  }
  for (const [n, part] of reply.campaigns.entries()) {
    const some = reply.campaign.flatMap((one, place) => (one === part.import ? [place] : []));
    const pick = (list) => some.map((place) => list[place]);
    data.push({
      x: pick(x), y: scaled(pick(values)), customdata: pick(reply.row), mode: "markers",
      marker: { color: colours[n % colours.length], size: 7, symbol: pick(reply.coverage).map((one) => (one === "covered" ? "circle" : "circle-open")) },
      name: part.import === null ? "no import" : `import ${part.import}`, hovertemplate: `row %{customdata}: %{y:.4~g} ${unit}<extra></extra>`,
    });
  }
  const title = [`${marked(load)}, ${unitOfLoad(load)}`, "row, in the order of the table", `${marked(output)} of the reference, ${unit}`][k];
  return { data, layout: {
    xaxis: { title: { text: title }, ...(k === 1 ? { tick0: 0, dtick: Math.max(1, Math.ceil((x.at(-1) - x[0]) / MOST_TICKS)) } : {}) }, yaxis: { title: { text: `${k === 2 ? "measured" : "residual of"} ${marked(output)}, ${unit}` } },
    showlegend: reply.campaigns.length > 1, legend: { orientation: "h", y: 1.12 }, margin: { l: 60, r: 12, t: 24, b: 44 },
  } };
}

const MOST_TICKS = 8; // of the rows

// The reference's own bar about no difference, in the order of x.
function band(x, bars, shade) {
  const order = [...x.keys()].filter((place) => bars[place] !== null).sort((a, b) => x[a] - x[b]), back = [...order].reverse();
  return {
    x: [...order, ...back].map((place) => x[place]), y: [...order.map((place) => bars[place]), ...back.map((place) => -bars[place])],
    mode: "lines", line: { width: 0 }, fill: "toself", fillcolor: faint(shade.query, 0.2), hoverinfo: "skip", showlegend: false,
  };
}

// The key of what is drawn, and of nothing else.
function key(reply) {
  const mark = (kind, text) => el("li", {}, el("i", { class: kind }), text);
  return [mark("square band", "95 % error bar of the reference"), reply.coverages.thin ? mark("hollow", "row where the reference is thin") : null,
    mark("rule dotted", "measured equals reference"), mark("rule", "fitted factor: measured over reference")];
}
