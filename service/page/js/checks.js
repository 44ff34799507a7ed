// The compliance at zero load and over the range, and the physical checks of the rows.

import { get, of } from "./api.js";
import { el, facts, note, pill, put, working } from "./dom.js";
import { emptyTable } from "./empty.js";
import { OUTSIDE } from "./inputs.js";
import { rowLinks } from "./rows.js";
import { LOADS, OUTPUTS, count, counted, number, percent, plain, scientific, sentence, superscript, symbol, triple } from "./format.js";

const LEAST = 1e-4; // of the unit: smaller entries would need a power of ten of their own; their value is the title
const NOISE = 1e-9; // of the largest entry of its unit: rounding of the solver
const ASYMMETRY = 0.1; // of the larger of two mirror entries: rows in all loads differ by less, for Maxwell and Betti
const ROUNDING = 1e-6; // of the largest eigenvalue: NEGATIVE in surrogate/table/physics_checks.py
const ORIGINS = { row: "tangent of the row" };

const also = (text) => (text ? `; ${text}` : "");

// Of each check its title, and the text of its result.
const CHECKS = {
  zero_at_zero_load: ["The displacement at zero load is zero", ({ displacement, reason }) => {
    if (!displacement) return reason;
    const six = Object.values(displacement);
    return `largest displacement u\u00a0${triple(six.slice(0, 3), "m")}, r\u00a0${triple(six.slice(3, 6), "rad")}${also(reason)}`;
  }],
  symmetric: ["The compliance is symmetric (Maxwell, Betti)", (check) => `asymmetry ${percent(check.asymmetry)}, allowed ${percent(check.allowed)}${also(check.reason)}${check.asymmetry_of_solves == null ? "" : `; of the tangents of solves ${number(check.asymmetry_of_solves, 2)}, allowed ${number(check.allowed_of_solves, 2)}`}; the largest entries decide it, small ones may differ more`],
  positive: ["Loads do positive work", (check) => `smallest eigenvalue over largest ${number(check.smallest_over_largest_eigenvalue, 3)}${isOfFit(check) ? ", within the asymmetry of the fit: the rows do not determine its sign yet" : ""}`],
  linear: ["The response is linear (one 6 × 6 compliance)", ({ says, reason }) => says || reason],
  work: ["Work does not decrease from row to row", (check) => `pairs of rows that lose work: ${count(check.pairs_that_give_work_back ?? 0)}`],
  tangents: ["Tangents agree with neighbouring rows", ({ ok, largest_miss: miss, reason }) => {
    if (miss == null) return reason;
    return ok ? "all deviations are within half a step between rows, and the rows' error bars" : `largest deviation ${percent(miss)} of the range: solve wrenches between these rows; if the deviation stays, a tangent is wrong`;
  }],
};

// A smallest eigenvalue that is negative by no more than the errors of the fit.
const isOfFit = (check) => check.ok && check.smallest_over_largest_eigenvalue < -ROUNDING;

// Checks whose failure breaks no law: strong curvature between rows bends tangents too.
const FAILED = { linear: ["not linear", ""], tangents: ["deviates", "thin"] };

export async function show(root, about, signal) {
  if (!about.rows) {
    put(root, emptyTable(about, "The table has no rows yet. This view will show its compliance, and whether the rows keep physical laws such as its symmetry."));
    return;
  }
  put(root, working("The checks are computed …"));
  const [reply, { rows, coverage }] = await Promise.all([get(`${of(about.name)}/compliance`, signal), get(of(about.name), signal)]);
  const beyond = coverage.beyond_range;
  const comparison = await get(`${of(about.name)}/disagreement`, signal).catch(() => null);
  put(root,
    el("section", { class: "card" }, el("h2", {}, "Compliance at zero load"),
      reply.tangent_origin === "none" ? el("p", { class: "muted" }, "Not known yet: there are no rows.") : matrix(reply.tangent, "Tangent at zero load", `${ORIGINS[reply.tangent_origin] || `du/dw of ${reply.tangent_origin}`} at zero load`)),
    reply.origin === "none" ? null : el("section", { class: "card" }, el("h2", {}, "Mean compliance over the load range"),
      matrix(mean(reply), "Mean compliance", `${reply.origin} from ${counted(rows - beyond, "row")}${beyond ? `; ${counted(beyond, "row")} ${OUTSIDE}` : ""}`)),
    el("section", { class: "card" }, el("h2", {}, "Physical checks of the rows"), checks(reply, about)),
    comparison?.compared ? el("section", { class: "card" }, el("h2", {}, "Measured against solved rows"), disagreement(comparison, about)) : null);
}

// The server's matrix has zeros in the columns of loads that the rows do not determine.
const mean = (reply) => reply.matrix.map((line) => line.map((value, j) => (reply.known_loads.includes(LOADS[j]) ? value : null)));

// Outputs that no row measures and loads that no row has are left out.
function matrix(values, name, origin) {
  const power = 3 * Math.ceil((Math.log10(Math.max(...values.flat().map(Math.abs)) || 1) - 4) / 3); // the largest entry has up to four digits before its point
  const unit = 10 ** power, shown = LOADS.map((_, j) => j).filter((j) => values.some((line) => line[j] !== null)); // of the columns
  const entry = entryOf(values, unit);
  const lines = el("tbody", {}, values.map((line, i) => (line.some((value) => value !== null) ? el("tr", {}, el("th", { scope: "row" }, symbol(OUTPUTS[i])), shown.map((j) => entry(i, j))) : "")));
  const table = el("table", { class: "matrix" },
    el("thead", {}, el("tr", {}, el("th", {}), shown.map((j) => el("th", { class: "number", scope: "col" }, symbol(LOADS[j]))))), lines);
  if (shown.length < LOADS.length) table.style.maxWidth = `${9 * (shown.length + 1)}rem`; // a value is near its name
  const has = (sign) => [...lines.querySelectorAll("td")].some((cell) => cell.textContent === sign);
  const absent = [...OUTPUTS.filter((_, i) => values[i].every((value) => value === null)), ...LOADS.filter((_, j) => !shown.includes(j)).map(plain)];
  return [
    el("div", { class: "wide", tabindex: "0", role: "region", "aria-label": name }, table),
    el("p", { class: "muted small" }, `In ${power ? `10${superscript(power)} ` : ""}m or rad per N or N·m; ${origin}. By blocks: u by F in m/N, u by M in m/(N·m), r by F in rad/N, r by M in rad/(N·m). Shades compare entries of one unit.${has("?") ? " The rows do not determine entries with ? yet: they are negative on the diagonal, or more than 10 % off their mirror entries." : ""}${has("–") ? " –: not known." : ""}${absent.length ? ` Not in the rows: ${absent.join(", ")}.` : ""}`),
  ];
}

// A function that draws an entry of a matrix, in a unit. Shades compare entries of one 3 x 3 block, which have one unit.
function entryOf(values, unit) {
  const size = (i, j) => Math.abs(values[i][j] ?? 0), block = (i) => [0, 1, 2].map((k) => 3 * Math.floor(i / 3) + k);
  const largest = (i, j) => Math.max(...block(i).flatMap((a) => block(j).map((b) => size(a, b))));
  return (i, j) => {
    const value = values[i][j], mirror = values[j][i];
    if (value === null) return el("td", {}, "–");
    if (!value) return el("td", {}, "0");
    if (size(i, j) < Math.max(LEAST * unit, NOISE * Math.max(largest(i, j), Math.sqrt(size(i, i) * size(j, j))))) return el("td", { title: scientific(value, 3) }, "≈ 0");
    const isNegative = i === j && value < 0, isOff = mirror !== null && Math.abs(value - mirror) > ASYMMETRY * Math.max(size(i, j), size(j, i));
    if (isNegative || isOff) return el("td", { class: "muted", title: `${scientific(value, 3)}, ${isNegative ? "negative on the diagonal" : "more than 10 % off its mirror entry"}: the rows do not determine it yet` }, "?");
    const cell = el("td", {}, number(value / unit, size(i, j) < 0.1 * unit ? 2 : 3));
    cell.style.background = `color-mix(in srgb, var(--accent) ${Math.round((26 * size(i, j)) / largest(i, j))}%, transparent)`;
    return cell;
  };
}

function checks(reply, about) {
  if (!reply.rows_checked) return el("p", { class: "muted" }, "There are no rows with all six outputs to check.");
  const lines = Object.entries(reply.checks).filter(([name]) => name !== "symmetric" || reply.known_loads.length > 1).map(([name, check]) => {
    const [title, textOf] = CHECKS[name] || [name, () => ""];
    const verdict = check.ok === null || isOfFit(check) ? pill("not known yet", "") : check.ok ? pill("holds", "ok") : pill(...(FAILED[name] || ["broken", "wrong"]));
    const rows = check.rows?.length && name !== "linear" ? el("span", { class: "muted small" }, rowLinks(about.name, check.rows, 12), check.rows.length > 12 ? " …" : "") : null;
    return el("tr", {}, el("td", {}, verdict), el("td", { class: "whole" }, title), el("td", { class: "muted small whole" }, sentence(textOf(check) || " ")), el("td", { class: "whole" }, rows));
  });
  return el("table", { class: "folds checks" }, el("tbody", {}, lines));
}

function disagreement(reply, about) {
  return [
    reply.outside ? note("thin", `${reply.outside} of ${reply.compared} measured values lie outside the error bar of the solved rows.`) : note("covered", `All ${reply.compared} measured values lie within the error bar of the solved rows.`),
    (reply.rows || []).length ? facts(reply.rows.slice(0, 20).map(({ row, output, measured, expected, bar, ratio }) => [[rowLinks(about.name, [row], 1), `, ${output}`], `${number(measured)} measured, ${number(expected)} ± ${number(bar, 2)} expected: ${number(ratio, 2)} bars off`])) : null,
  ];
}
