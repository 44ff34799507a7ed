// All jobs, or one of them.

import { get, post, send } from "./api.js";
import { el, facts, notify, pill, put } from "./dom.js";
import { listen } from "./events.js";
import { OUTPUTS, quantity, symbol, unitOfOutput } from "./format.js";
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
  const show_ = async () => {
    const job = await get(`v1/jobs/${id}`, signal);
    put(root,
      el("div", { class: "head" },
        el("div", {}, el("span", { class: "crumb" }, el("a", { href: "#/jobs" }, "Jobs"), " /"), el("h1", {}, `Job ${id}`)),
        el("div", { class: "line" }, pill(job.status), buttons(job, show_))),
      job.status === "running" ? el("div", { class: "stack tight" }, el("progress", { max: "1", value: job.progress?.fraction ?? 0, "aria-label": `Job ${id}` }), el("span", { class: "small muted" }, job.progress?.message || "")) : null,
      result(job), el("section", { class: "card" }, facts(jobFacts(job))));
    if (job.attempt && job.status !== "running") send("GET", `v1/jobs/${id}/log`, { quiet: true, signal }).then((reply) => reply.text()).then((text) => { document.getElementById("log").hidden = !text; }, () => {});
    return job;
  };
  const job = await show_();
  listen(job.component, signal, (kind, body) => { if (kind === "job" && String(body.id) === id) show_(); });
}

// What a solve found, with links to the views that show it.
function result(job) {
  if (!job.translation) return null;
  const link = (view, text) => el("a", { class: "button", href: `#/c/${encodeURIComponent(job.component)}/${view}`, onclick: () => keepWrench(job.component, [...job.force, ...job.moment]) }, text);
  const values = [...job.translation, ...job.rotation], size = (place) => Math.max(1e-12, 1e-6 * Math.max(...values.slice(place, place + 3).map(Math.abs))); // below it is round-off
  return el("section", { class: "card" }, el("h2", {}, "Displacement of this solve"),
    el("div", { class: "few" }, values.map((value, place) => el("span", {}, symbol(OUTPUTS[place]), " ", quantity(Math.abs(value) < size(place < 3 ? 0 : 3) ? 0 : value, unitOfOutput(OUTPUTS[place]), 5)))),
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
    job.attempt ? el("button", { type: "button", id: "log", onclick: () => showLog(job.id) }, "Log") : null,
  ];
}
