// Ask for a displacement; where a solve is queued, watch it and ask again.

import { caughtUp, get, of, post, trouble } from "./api.js";
import { picture } from "./arrows.js";
import { answerOf, keepAnswer, remember } from "./asked.js";
import { el, field, note, pill, put, select } from "./dom.js";
import { linkTo } from "./empty.js";
import { listen } from "./events.js";
import { OUTPUTS, aligned, counted, largestOf, number, percent, pageWords, quantity, sentence, symbol, unitOfOutput, withBar, withoutRoundOff } from "./format.js";
import { beyondRange, inputsText, named, outputsOf } from "./inputs.js";
import { failureWords } from "./job_list.js";
import { insideBars, insideWords, reportOf } from "./report.js";
import { overTolerance } from "./shares.js";
import { curlOf, pythonOf, snippet } from "./snippet.js";
import { wrenchForm } from "./wrench_form.js";

const ON_THIN = [["queue", "queue a solve"], ["estimate", "estimate only"], ["reject", "reject the query"]];
const METHODS = [["", "default of the table"], ["kriging", "kriging"], ["griddata", "griddata"], ["additive", "additive"], ["linear", "linear"]];

const BY_AXES = ["griddata", "additive"]; // for one wrench at one interface alone

export async function show(root, about, signal) {
  const answer = el("section", { class: "stack", "aria-live": "polite" },
    el("p", { class: "empty" }, about.space ? "Enter the loads that act on the component at each interface's point where it is now, in axes fixed to its undeformed frame." : "Enter the wrench that acts on the component at its interface point where it is now, in axes fixed to the undeformed interface frame. The answer is the displacement of that point with its 95 % error bar."));
  const curl = snippet("From a shell"), python = snippet("From Python");
  const onThin = select(about.has_fea ? ON_THIN : ON_THIN.slice(1), about.has_fea ? "queue" : "estimate", () => tell());
  const methods = about.space ? METHODS.filter(([name]) => !BY_AXES.includes(name)) : METHODS;
  const method = select(methods, "", () => tell());
  const options = () => ({ onThin: onThin.value, method: method.value });
  let asked = null; // what the answer on view is for
  const old = note("thin"), doubt = el("div", { "aria-live": "polite" });
  const report = reportOf(about, signal).catch(() => null);
  const ask = (wrench) => {
    asked = { wrench, options: JSON.stringify(options()) };
    tell();
    answer.scrollIntoView({ block: "nearest" });
    report.then((latest) => put(doubt, doubted(about, insideBars(latest))));
    return query(answer, about, wrench, options(), signal);
  };
  const form = wrenchForm(about, {
    action: "Ask", asked: ask, changed: () => tell(),
    more: el("div", { class: "stack" }, field("If the table does not cover the wrench", onThin), field("Method", method)),
  });
  const last = answerOf(about.name);
  if (last && String(last.wrench) === String(form.read())) { // left while its solve ran, or to look at another view
    onThin.value = last.options.onThin;
    method.value = last.options.method;
    asked = { wrench: last.wrench, options: JSON.stringify(options()) };
    drawn(answer, about, last, signal).catch((error) => { if (!signal.aborted) put(answer, trouble(error)); });
  }
  const tell = () => {
    curl.say(curlOf(about, form.read(), options()));
    python.say(pythonOf(about, form.read(), options()));
    drawing?.again();
    const stale = asked && (asked.options !== JSON.stringify(options()) || String(asked.wrench) !== String(form.read()));
    answer.parentElement?.classList.toggle("stale", Boolean(stale));
    old.hidden = !stale;
    if (stale) put(old, `This answer is for ${inputsText(named(about, asked.wrench), about, TYPED)}. Press Ask for the inputs typed now.`);
  };
  let drawing = null;
  const picture_ = about.has_fea ? el("section", { class: "card" }, el("h2", {}, about.space ? "Loads at the interfaces" : "Load at the interface")) : null;
  tell();
  put(root, el("div", { class: "two" }, el("section", { class: "card" }, form.form), el("div", { class: "stack" },
    el("div", { class: "card" }, old, doubt, answer), picture_, el("div", { class: "card" }, curl.root, python.root))));
  if (!about.has_fea) return;
  drawing = await picture(picture_, about, form.read, signal).catch(() => { picture_.remove(); return null; }); // a mesh that cannot be drawn
}

// That the latest report speaks against the error bars of all answers.
const doubted = (about, bars) => (bars?.tooFew ? note("outside", el("span", {}, `In the latest report only ${insideWords(bars)}. `, el("a", { href: `#/c/${encodeURIComponent(about.name)}/report` }, "Show the report"))) : null);

async function query(place, about, wrench, options, signal, watched = null) {
  const body = { ...named(about, wrench), on_thin: options.onThin };
  if (options.method) body.method = options.method;
  if (options.beyond) Object.assign(body, { on_thin: "wait", wait_s: 0, beyond_range: true }); // a solve of exactly this wrench
  let answer;
  try {
    answer = await post(`${of(about.name)}/displacement`, body, signal);
  } catch (error) {
    if (signal.aborted) return;
    const guess = error.body?.type?.endsWith(":not-covered") && options.onThin !== "estimate"; // the page has a button for this option
    const outside = beyondRange(about, wrench);
    if (guess) put(place, note(error.body.coverage, el("strong", {}, error.body.title), outside ? el("span", {}, outside) : null, el("span", {}, pageWords(error.body.reason || error.message)), el("div", {}, el("button", { type: "button", onclick: () => query(place, about, wrench, { ...options, onThin: "estimate" }, signal) }, "Show the estimate"))));
    else put(place, trouble(error));
    return;
  }
  remember(about.name, wrench, answer.coverage);
  await drawn(place, about, { wrench, options, answer, watched }, signal);
}

// Draws an answer, keeps it while the tab is open, and watches its solve.
async function drawn(place, about, kept, signal) {
  const { wrench, options, answer, watched } = kept;
  keepAnswer(about.name, kept);
  const unknown = answered(answer) && (answer.coverage === "outside" || barUnknown(answer)) ? await get(of(about.name), signal) : null;
  const why = unknown && barUnknown(answer) ? whyUnknown(answer, unknown) : null;
  const over = answer.coverage === "covered" && answer.within_tolerance === false ? await whyOver(about, wrench, options, signal) : null;
  const solve = answer.job === null && beyondRange(about, wrench) ? () => query(place, about, wrench, { ...options, beyond: true }, signal) : null;
  const limits = answered(answer) ? await limitsOf(about, signal) : {};
  put(place, shown(answer, { ...about, rows: unknown?.rows ?? about.rows }, wrench, limits, why, over, solve));
  if (answer.job && answer.job.id !== watched) await watch(place, about, wrench, options, answer.job, signal);
}

const TYPED = 12; // digits: a load as it was typed
const ROUNDOFF = 1e-20; // m or rad: the kernel's least error bar is 1e-30
const shareOf = (part) => (part < 10 ? percent(part, 2) : `${number(part, 2)} times`);

// The tolerance of each output by its name: of a component without a stated one, a part of each output's range.
async function limitsOf(about, signal) {
  const stated = about.tolerance;
  const allowed = stated ? null : (await get(`${of(about.name)}/glance`, signal).catch(() => ({}))).allowed;
  return Object.fromEntries(outputsOf(about).map((name, k) => [name, stated ? stated[name.split(".").at(-1)[0] === "u" ? "translation" : "rotation"] : allowed?.[k]]));
}

// Why a covered answer exceeds the tolerance; the parts of its error bars come with a second call.
async function whyOver(about, wrench, options, signal) {
  const { error, error_parts: { table }, displacements } = await post(`${of(about.name)}/displacement`, { ...named(about, wrench), on_thin: "estimate", detail: true, ...(options.method && { method: options.method }) }, signal);
  const fronts = displacements ? Object.entries(displacements).map(([name, one]) => [one.error, table[name]]) : [[error, table]];
  const rests = fronts.flatMap(([bars, inner]) => ["translation", "rotation"].flatMap((kind) => bars[kind].map((bar, k) => (bar - inner[kind][k]) / (about.tolerance?.[kind] ?? Infinity))));
  return overTolerance(about, about.tolerance ? Math.max(...rests) : Infinity);
}

// Whether a displacement of an answer lacks its error bar.
const barUnknown = ({ displacements, ...one }) => (displacements ? Object.values(displacements) : [one]).some(({ translation, rotation, error }) => !error || [...error.translation, ...error.rotation].some((bar, place) => bar === null && [...translation, ...rotation][place] !== null));

function whyUnknown(answer, { warnings = [], rows }) {
  const few = answer.reason ? "" : answer.coverage === "outside" ? "beyond the rows no error bar is known" : `the table has ${counted(rows, "row")}, too few for an error bar here`; // the server's reason is shown already
  return warnings.find((one) => one.where === "tolerance" && one.message.includes("unknown"))?.message || few;
}

function shown(answer, about, wrench, limits, why, over, solve) {
  const outside = beyondRange(about, wrench);
  const reason = (answer.reason || "").replace(/: to solve it nevertheless, set beyond_range to true.*$/, "").split("; ").filter((part) => !outside || !/ outside the (load range|rows), /.test(part)).join("; ").replaceAll(/(?<=\. )[a-z]/g, (letter) => letter.toUpperCase()); // the note above says that, and the button is there
  const guess = `Extrapolated from ${counted(about.rows, "row")}${barUnknown(answer) ? "; its error is not known" : ""}.`;
  return [
    el("div", { class: "line" }, stateOf(answer, outside), el("span", { class: "muted small" }, about_(answer))),
    outside ? note("outside", el("span", {}, pageWords(`${outside.slice(0, -1)}${reason ? `; ${reason}` : ""}.`)), extrapolated(answer) ? el("span", {}, guess) : null, solve ? el("div", {}, el("button", { type: "button", onclick: solve }, "Solve it nevertheless")) : null) : null,
    extrapolated(answer) && !outside ? note("outside", reason ? el("span", {}, `${pageWords(reason)}.`) : null, el("span", {}, guess)) : null,
    reason && !outside && !extrapolated(answer) ? note(answered(answer) && !(why !== null && answer.coverage === "covered") ? answer.coverage : "", pageWords(reason)) : null,
    !answered(answer) && !about.has_fea && !about.rows ? linkTo(about, "table", "Import rows") : null,
    why ? note("thin", el("strong", {}, "The error bar is unknown"), el("span", {}, `${sentence(why)}.`)) : null,
    over ? note("thin", over) : null,
    Object.entries(answer.displacements || { "": answer }).map(([name, part]) => moved(name, part, OUTPUTS.map((output) => limits[name ? `${name}.${output}` : output]), answer)),
    answer.notes ? note("thin", el("ul", {}, answer.notes.map((one) => el("li", {}, one)))) : null,
    el("p", { class: "muted small" }, inputsText(named(about, wrench), about, TYPED)),
  ];
}

// An answer beyond the rows or the load range: a guess.
const extrapolated = (answer) => answered(answer) && answer.coverage === "outside" && answer.source !== "fea";

const answered = ({ translation, displacements }) => Boolean(translation || Object.values(displacements || {})[0]?.translation);

// Coverage as a pill; a queued solve brings the answer that is missing.
function stateOf(answer, beyond) {
  const { coverage, within_tolerance: within } = answer;
  if (!answered(answer)) return pill(answer.job ? "no answer yet" : "no answer", "");
  if (coverage === "outside") return pill(beyond ? "outside the load range" : "outside the rows", "outside");
  if (coverage !== "covered") return pill(coverage);
  return barUnknown(answer) ? pill("covered, error bar unknown", "thin") : within === false ? pill("covered, over tolerance", "thin")
    : answer.missing?.length ? pill(`covered; ${counted(answer.missing.length, "output")} not measured`, coverage) : pill(coverage);
}

// The displacement of an interface, its name empty where there is one.
function moved(name, part, limits, answer) {
  if (!part.translation) return null;
  const values = [part.translation, part.rotation].flatMap((group) => (part.error ? group.map((one) => (one !== null && Math.abs(one) < ROUNDOFF ? 0 : one)) : withoutRoundOff(group)));
  const bars = part.error ? [...part.error.translation, ...part.error.rotation].map((one) => (one !== null && one < ROUNDOFF ? 0 : one)) : [];
  if (name && bars.length && ![...values, ...bars].some((one) => one !== 0)) return el("p", { class: "muted" }, `${name}: no displacement`);
  const hasLimit = limits.some(Boolean), isUnmeasured = (output) => answer.missing?.includes(name ? `${name}.${output}` : output);
  const kinds = [0, 3].map((first) => { // one unit for the translation, and one for the rotation
    const pick = (list) => list.slice(first, first + 3), size = largestOf([...pick(values), ...pick(bars)]);
    const pairs = pick(OUTPUTS).map((output, k) => (isUnmeasured(output) ? { value: "not measured", bar: "–" } : withBar(values[first + k], bars[first + k], unitOfOutput(output), size)));
    return [aligned(pairs.map((one) => one.value)), aligned(pairs.map((one) => one.bar))];
  });
  const lines = OUTPUTS.map((output, place) => {
    const [value, bar] = kinds[Math.floor(place / 3)].map((list) => list[place % 3]);
    const allowed = limits[place];
    const share = allowed && bars[place] !== null && bars[place] !== undefined ? shareOf(bars[place] / allowed) : "–";
    return row(symbol(output), value, bar, hasLimit ? share : null);
  });
  const head = ["", "Value", "95 % error bar", ...(hasLimit ? ["Of the tolerance"] : [])].map((one, place) =>
    el("th", { scope: "col", class: place ? "number" : null }, one));
  return el("table", { class: extrapolated(answer) ? "answer guess" : "answer" }, name ? el("caption", {}, name) : null, el("thead", {}, el("tr", {}, head)), el("tbody", {}, lines));
}

function row(name, value, bar, share) {
  return el("tr", {}, el("th", { scope: "row" }, name), el("td", { class: "number" }, value),
    el("td", { class: "number muted" }, bar), share === null ? null : el("td", { class: "number muted small" }, share));
}

function about_(answer) {
  const source = answer.source === "fea" ? "a solve of this wrench" : answer.source === "table" ? "from the table" : answer.source || "no source";
  return `${source}${answer.source && answer.method !== "row" ? ` · ${answer.method}` : ""} · table version ${answer.table_version} · ${quantity(1e-6 * answer.elapsed_us, "s")}`;
}

// Events tell how far the solve is; its end is asked for as well, since it may come before them.
async function watch(place, about, wrench, options, job, signal) {
  const bar = el("progress", { max: "1", value: 0 });
  const words = el("span", { class: "small muted" }, "waiting for a solver");
  const link = el("a", { href: `#/jobs/${job.id}` }, `Job ${job.id}`);
  place.append(el("div", { class: "stack", id: "watched" },
    el("div", { class: "line ends" }, el("span", {}, "A solve is queued: ", link, ". Its answer appears here."), words), bar));
  const ended = new AbortController();
  const stop = AbortSignal.any([signal, ended.signal]);
  listen(about.name, stop, (kind, body) => {
    if (kind !== "job" || body.id !== job.id || !body.progress) return;
    bar.value = body.progress.fraction;
    words.textContent = body.progress.message;
  });
  try {
    let now = job;
    while (!["done", "failed", "cancelled"].includes(now.status)) now = await get(`v1/jobs/${job.id}?wait_s=20`, signal);
    ended.abort();
    if (now.status === "done") {
      if (!about.space) await caughtUp(about.name, signal);
      await query(place, about, wrench, about.space ? { ...options, onThin: "wait" } : options, signal, job.id);
    } else put(place, note("outside", el("strong", {}, `The solve ${now.status === "failed" ? "failed" : "was cancelled"}.`), now.error ? failureWords(now.error) : null, link));
  } catch (error) {
    ended.abort();
    if (!signal.aborted) put(place, trouble(error));
  }
}
