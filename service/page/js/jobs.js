// All jobs, or one of them.

import { get, post, send } from "./api.js";
import { el, facts, notify, pill, put } from "./dom.js";
import { listen } from "./events.js";
import { jobFacts, jobList, showLog } from "./job_list.js";

export async function show(root, [id], signal) {
  if (id) {
    await one(root, id, signal);
    return;
  }
  document.title = "Jobs · wrenchbook";
  const card = el("section", { class: "card" });
  put(root, el("div", { class: "head" }, el("div", {}, el("h1", {}, "Jobs"), el("p", { class: "muted" }, "Solves that the server has accepted: running ones first, then the newest."))), card);
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
      el("section", { class: "card" }, facts(jobFacts(job))));
    return job;
  };
  const job = await show_();
  listen(job.component, signal, (kind, body) => { if (kind === "job" && String(body.id) === id) show_(); });
}

function buttons(job, again) {
  const act = (call) => async () => {
    try { await call(); await again(); } catch (error) { notify(error.message, "wrong"); }
  };
  const open = ["waiting", "running"].includes(job.status), retries = ["failed", "cancelled"].includes(job.status);
  return [
    open ? el("button", { type: "button", onclick: act(() => send("DELETE", `v1/jobs/${job.id}`)) }, "Cancel") : null,
    retries ? el("button", { type: "button", class: job.error ? null : "first", onclick: act(() => post(`v1/jobs/${job.id}/retry`, {})) }, "Retry") : null,
    job.attempt ? el("button", { type: "button", onclick: () => showLog(job.id) }, "Log") : null,
  ];
}
