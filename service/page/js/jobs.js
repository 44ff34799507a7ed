// All jobs, or one of them.

import { get, of, post, send } from "./api.js";
import { el, facts, note, notify, pill, put } from "./dom.js";
import { listen } from "./events.js";
import { OUTPUTS, number, quantity, sentence, symbol, unitOfOutput, withoutRoundOff } from "./format.js";
import { beyondRange, timesRange, valuesOf } from "./inputs.js";
import { keepWrench } from "./wrench_form.js";
import { jobFacts, jobList, showLog } from "./job_list.js";

export async function show(root, [id], signal) {
  if (id) {
    await one(root, id, signal);
    return;
  }
  document.title = "Jobs · wrenchbook";
  const card = el("section", { class: "card" });
  put(root, el("div", { class: "head" }, el("div", {}, el("h1", {}, "Jobs"), el("p", { class: "muted" }, "Solves that the server has accepted: running ones, waiting ones in the order of their start, then the newest."))), card);
  await jobList(card, null, signal);
}

async function one(root, id, signal) {
  document.title = `Job ${id} · wrenchbook`;
  let about = null;
  const show_ = async () => {
    const job = await get(`v1/jobs/${id}`, signal);
    about ??= await get(of(job.component), signal).catch(() => ({})); // a deleted component has no range
    const outside = outsideOf(job, about);
    put(root,
      el("div", { class: "head" },
        el("div", {}, el("span", { class: "crumb" }, el("a", { href: "#/jobs" }, "Jobs"), " /"), el("h1", {}, `Job ${id}`)),
        el("div", { class: "line" }, pill(job.status), outside ? pill("outside the load range", "outside") : null, buttons(job, show_))),
      job.status === "running" ? el("div", { class: "stack tight" }, el("progress", { max: "1", value: job.progress?.fraction ?? 0, "aria-label": `Job ${id}` }), el("span", { class: "small muted" }, job.progress?.message || "")) : null,
      outside ? note("outside", outside) : null,
      (job.notes || []).filter(isYield).map((one) => note("thin", el("strong", {}, "The part yields"), el("span", {}, sentence(one)))),
      result(job), el("section", { class: "card" }, facts(jobFacts({ ...job, notes: job.notes?.filter((one) => !isYield(one)) }))));
    if (job.attempt && job.status !== "running") send("GET", `v1/jobs/${id}/log`, { quiet: true, signal }).then((reply) => reply.text()).then((text) => { document.getElementById("log").hidden = !text; }, () => {});
    return job;
  };
  const job = await show_();
  listen(job.component, signal, (kind, body) => { if (kind === "hello" || (kind === "job" && String(body.id) === id)) show_(); });
}

const isYield = (text) => text.includes("above its yield strength");

// That a job's loads are outside the load range, and how far; empty for others.
function outsideOf(job, about) {
  if (!about.range || !(job.force || job.loads)) return "";
  const values = valuesOf(about, job), outside = beyondRange(about, values), times = timesRange(about, values);
  return outside && times > 1 ? `${outside} The wrench is ${number(times, 3)} times the load range.` : outside;
}

// What a solve found, with links to the views that show it.
function result(job) {
  if (!job.translation) return null;
  const link = (view, text) => el("a", { class: "button", href: `#/c/${encodeURIComponent(job.component)}/${view}`, onclick: () => keepWrench(job.component, [...job.force, ...job.moment]) }, text);
  const values = [...withoutRoundOff(job.translation), ...withoutRoundOff(job.rotation)];
  return el("section", { class: "card" }, el("h2", {}, "Displacement of this solve"),
    el("div", { class: "few" }, values.map((value, place) => el("span", {}, symbol(OUTPUTS[place]), " ", quantity(value, unitOfOutput(OUTPUTS[place]), 5)))),
    el("p", { class: "muted small" }, "A solve has no error bar of its own: Query shows it."),
    job.inputs || job.loads ? null : el("div", { class: "line" }, link("query", "Query this wrench"), link("shape", "Show its shape")));
}

function buttons(job, again) {
  const act = (call) => async () => {
    try { await call(); await again(); } catch (error) { notify(error.message, "wrong"); }
  };
  const open = ["waiting", "running"].includes(job.status), retries = ["failed", "cancelled"].includes(job.status);
  return [
    open ? el("button", { type: "button", onclick: act(() => send("DELETE", `v1/jobs/${job.id}`)) }, "Cancel") : null,
    retries ? el("button", { type: "button", class: job.error ? null : "first", onclick: act(() => post(`v1/jobs/${job.id}/retry`, {})) }, "Retry") : null,
    job.attempt ? el("button", { type: "button", id: "log", onclick: () => showLog(job) }, "Log") : null,
  ];
}
