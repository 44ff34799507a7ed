// Jobs with live progress; cancel, retry, the log of a failed one.

import { get, post, send, trouble } from "./api.js";
import { el, note, notify, pill, put, save } from "./dom.js";
import { listen } from "./events.js";
import { seconds, time, wrench } from "./format.js";

const SHOWN = 50;

export async function jobList(root, component, signal) {
  const list = { root: el("tbody", {}), rows: new Map(), withName: !component, signal };
  const status = { value: "" };
  const older = el("button", { type: "button", hidden: true }, "Older jobs");
  let following = null;
  const load = async (path, fresh) => {
    const page = await get(path, signal);
    if (fresh) { list.rows.clear(); put(list.root); }
    for (const job of page.jobs) list.root.append(rowOf(list, job));
    following = page.next;
    older.hidden = !following;
    empty.hidden = list.rows.size > 0;
  };
  const query = () => `v1/jobs?limit=${SHOWN}${component ? `&component=${encodeURIComponent(component)}` : ""}${status.value ? `&status=${status.value}` : ""}`;
  const empty = el("p", { class: "empty", hidden: true }, "No jobs.");
  const fresh = () => load(query(), true).catch((error) => { if (!signal.aborted) put(root, trouble(error)); });
  older.addEventListener("click", () => load(following.replace(/^\//, ""), false));
  const filter = el("select", { "aria-label": "Which jobs", onchange: (event) => { status.value = event.target.value; fresh(); } },
    ["", "waiting", "running", "done", "failed", "cancelled"].map((one) => el("option", { value: one }, one || "all")));
  const cancelAll = el("button", { type: "button", class: "small", onclick: () => cancelWaiting(component) }, "Cancel all waiting jobs");
  const head = ["job", component ? null : "component", "state", "wrench", "took", ""].filter((one) => one !== null);
  put(root,
    el("div", { class: "line ends" }, el("label", { class: "line" }, "Show", filter), cancelAll),
    el("table", { class: "folds jobs" }, el("thead", {}, el("tr", {}, head.map((one) => el("th", { scope: "col" }, one)))), list.root),
    empty, older);
  await fresh();
  listen(component, signal, (kind, body) => hear(list, kind, body, fresh, status));
}

// An event tells of one job, or that many have changed at once.
function hear(list, kind, body, fresh, status) {
  if (kind === "jobs") fresh();
  if (kind !== "job") return;
  const row = list.rows.get(body.id);
  if (row) change(list, row, { ...row.job, ...body });
  else if (!status.value) get(`v1/jobs/${body.id}`, list.signal).then((job) => { if (!list.rows.has(job.id)) list.root.prepend(rowOf(list, job)); }).catch(() => {});
}

async function cancelWaiting(component) {
  const { cancelled } = await (await send("DELETE", `v1/jobs?status=waiting${component ? `&component=${encodeURIComponent(component)}` : ""}`)).json();
  notify(`${cancelled} jobs were cancelled.`);
}

function rowOf(list, job) {
  const row = { root: el("tr", { id: `job-${job.id}` }), job };
  list.rows.set(job.id, row);
  change(list, row, job);
  return row.root;
}

function change(list, row, job) {
  row.job = job;
  const running = job.status === "running";
  const fraction = job.progress?.fraction;
  put(row.root,
    el("td", {}, el("a", { href: `#/jobs/${job.id}` }, String(job.id))),
    list.withName ? el("td", {}, el("a", { href: `#/c/${job.component}` }, job.component)) : null,
    el("td", { class: running || job.error ? "whole" : null }, el("div", { class: "stack" }, el("div", { class: "line" }, pill(job.status), running && job.progress ? el("span", { class: "small muted" }, job.progress.message) : null),
      running ? el("progress", { max: "1", value: fraction ?? 0, "aria-label": `Job ${job.id}` }) : null,
      job.status === "failed" && job.error ? el("span", { class: "small" }, job.error.message) : null)),
    el("td", { class: "small whole" }, job.force ? wrench(job.force, job.moment) : ""),
    el("td", { class: "muted small" }, job.seconds ? seconds(job.seconds) : ""),
    el("td", {}, actions(list, row, job)));
}

function actions(list, row, job) {
  const act = (call) => async () => {
    try { change(list, row, await call()); } catch (error) { notify(error.message, "wrong"); }
  };
  const buttons = [];
  if (["waiting", "running"].includes(job.status)) buttons.push(["Cancel", act(async () => (await send("DELETE", `v1/jobs/${job.id}`)).json())]);
  if (["failed", "cancelled"].includes(job.status)) buttons.push(["Retry", act(() => post(`v1/jobs/${job.id}/retry`, {}))]);
  if (job.attempt && job.status !== "waiting") buttons.push(["Log", () => showLog(job.id)]);
  return el("div", { class: "line" }, buttons.map(([text, press]) => el("button", { type: "button", class: "small", "aria-label": `${text} job ${job.id}`, onclick: press }, text)));
}

export async function showLog(id) {
  const text = el("pre", { tabindex: "0" }, "…");
  const dialog = el("dialog", { "aria-label": `Log of job ${id}`, onclose: () => dialog.remove() },
    el("div", { class: "stack" }, el("h2", {}, `Log of job ${id}`), text,
      el("div", { class: "line" }, el("button", { class: "first", onclick: () => dialog.close() }, "Close"),
        el("button", { type: "button", onclick: () => saveFiles(id) }, "Save all files of the attempt"))));
  document.body.append(dialog);
  dialog.showModal();
  try {
    text.textContent = (await (await send("GET", `v1/jobs/${id}/log`)).text()) || "The solver printed nothing.";
  } catch (error) {
    text.textContent = error.message;
  }
}

async function saveFiles(id) {
  try {
    save(await (await send("GET", `v1/jobs/${id}/files`)).blob(), `job-${id}.zip`);
  } catch (error) { notify(error.message, "wrong"); }
}

export function jobFacts(job) {
  return [
    ["Component", el("a", { href: `#/c/${job.component}` }, job.component)], ["Wrench", wrench(job.force, job.moment)],
    ["Attempt", job.attempt ? String(job.attempt) : ""], ["Accepted", time(job.created)], ["Started", job.started ? time(job.started) : ""],
    ["Ended", job.finished ? time(job.finished) : ""], ["Took", job.seconds ? seconds(job.seconds) : ""], ["Row", job.row ? String(job.row) : ""],
    ["Waits", job.waiting ? job.waiting.reason || "" : ""],
    ["Notes", job.notes?.length ? el("ul", {}, job.notes.map((one) => el("li", {}, one))) : ""],
    ["Failed", job.error ? failure(job.error) : ""],
  ];
}

// Why a solve failed, and what helps, each once: messages often hold both.
function failure({ kind, message, remedy }) {
  const words = kind && message.startsWith(`${kind}: `) ? message.slice(kind.length + 2) : message;
  return note("outside", el("strong", {}, (kind || "failed").replaceAll("_", " ")), el("span", {}, words),
    remedy && !words.includes(remedy) ? el("span", {}, `Remedy: ${remedy}`) : null);
}
