// The list of jobs with live progress, and their actions: cancel, retry, log.
// Running jobs come first, then waiting ones in the order of their start, then the newest others.

import { get, post, send, trouble } from "./api.js";
import { el, note, notify, pill, put, save } from "./dom.js";
import { empty as emptyState } from "./empty.js";
import { listen } from "./events.js";
import { actorOf, counted, seconds, sentence, time } from "./format.js";
import { inputsElement } from "./inputs.js";
import { rowLink } from "./rows.js";

const SHOWN = 50; // jobs of a page
const SECONDS = { second: "2-digit" };
const MAX_WAITING = 1000; // waiting jobs that are put in the order of their start
const AVERAGED = 20; // newest jobs of a component whose solve times are averaged

// The jobs that are shown, by number, and the table bodies in which they are.
class JobTable {
  constructor(component, signal) {
    this.signal = signal;
    this.hasComponents = !component; // each row names its component
    this.running = el("tbody", { class: "running" });
    this.waiting = el("tbody", { class: "waiting" });
    this.ended = el("tbody", {});
    this.rows = new Map();
    this.means = new Map(); // solve times by component
    this.calls = new Map(); // the latest call for each job that has changed
    this.last = null; // the job that starts last, shown or not
    this.count = () => {}; // called when the number of jobs of a state has changed
  }

  clear() {
    this.rows.clear();
    for (const body of [this.running, this.waiting, this.ended]) put(body);
  }

  bodyOf({ status }) {
    return { running: this.running, waiting: this.waiting }[status] || this.ended;
  }

  add(job) {
    const row = { root: el("tr", { id: `job-${job.id}` }), job };
    this.rows.set(job.id, row);
    this.change(row, job);
    this.place(row);
  }

  // Of running and of ended jobs the newest is first.
  place(row) {
    const body = this.bodyOf(row.job);
    const isAfter = body === this.waiting ? (job) => inOrder(job, row.job) > 0 : (job) => job.id < row.job.id;
    const jobOf = (element) => this.rows.get(Number(element.id.slice("job-".length))).job;
    body.insertBefore(row.root, [...body.children].find((element) => isAfter(jobOf(element))) || null);
  }

  change(row, job) {
    const isMoved = row.root.isConnected && this.bodyOf(row.job) !== this.bodyOf(job);
    row.job = job;
    if (isMoved) this.place(row);
    const { actor, progress, error } = job, isRunning = job.status === "running";
    const remaining = el("span", { class: "small muted" });
    if (isRunning && job.started) this.expect(job, remaining);
    const message = isRunning && progress ? el("span", { class: "small muted" }, progress.message) : null;
    const bar = isRunning ? el("progress", { max: "1", value: progress?.fraction ?? 0, "aria-label": `Job ${job.id}` }) : null;
    const state = el("div", { class: "stack tight" }, el("div", { class: "line" }, pill(job.status), message), bar, isRunning ? remaining : null);
    const failed = job.status === "failed" && error ? el("div", { class: "muted" }, failureWords(error)[0]) : null;
    const accepted = time(job.created).replaceAll(/(?<!,) /g, "\u00a0");
    put(row.root,
      el("td", { class: "number" }, el("a", { href: `#/jobs/${job.id}` }, String(job.id))),
      this.hasComponents ? el("td", {}, el("a", { href: `#/c/${job.component}` }, job.component)) : null,
      el("td", { class: isRunning || error ? "whole" : null }, state),
      el("td", { class: "small whole" }, inputsElement(job), failed),
      el("td", { class: "muted small" }, accepted, actor && actor !== "(anonymous)" ? el("div", {}, `by ${actorOf(actor)}`) : null),
      el("td", { class: "muted small number" }, job.seconds ? seconds(job.seconds) : ""),
      el("td", {}, this.actions(row, job)));
  }

  actions(row, job) {
    const act = (call) => async () => {
      try { this.change(row, await call()); await this.count(); } catch (error) { notify(error.message, "wrong"); }
    };
    const buttons = [];
    if (["waiting", "running"].includes(job.status)) buttons.push(["Cancel", act(async () => (await send("DELETE", `v1/jobs/${job.id}`)).json())]);
    if (["failed", "cancelled"].includes(job.status)) buttons.push(["Retry", act(() => post(`v1/jobs/${job.id}/retry`, {}))]);
    if (job.attempt && job.status !== "waiting") buttons.push(["Log", () => showLog(job)]);
    return el("div", { class: "line" }, buttons.map(([text, press]) =>
      el("button", { type: "button", class: "small", "aria-label": `${text} job ${job.id}`, onclick: press }, text)));
  }

  // Shows how long a job still runs, by the mean time of its component.
  async expect(job, place) {
    const mean = await this.meanOf(job.component), elapsed = (Date.now() - new Date(job.started)) / 1000;
    if (mean !== null) place.textContent = elapsed < mean ? `about ${rough(mean - elapsed)} left` : `longer than the mean, ${rough(mean)}`;
  }

  // The mean time of the newest solves of a component, s; null if there are none.
  meanOf(component) {
    if (!this.means.has(component)) {
      const path = `v1/jobs?component=${encodeURIComponent(component)}&status=done&limit=${AVERAGED}`;
      const mean = ({ jobs }) => (jobs.length ? jobs.reduce((sum, job) => sum + job.seconds, 0) / jobs.length : null);
      this.means.set(component, get(path, this.signal).then(mean).catch(() => null));
    }
    return this.means.get(component);
  }

  // Shows the event of one job; with `isFiltered` a job that is not shown is not added.
  update(event, isFiltered) {
    if (event.id === this.last?.id && event.status !== "waiting") this.last = null;
    const row = this.rows.get(event.id), hasNewStatus = row?.job.status !== event.status;
    if (row) this.change(row, { ...row.job, ...event });
    if (!hasNewStatus || (!row && isFiltered)) return;
    const call = get(`v1/jobs/${event.id}`, this.signal); // an event has no solve time
    this.calls.set(event.id, call);
    call.then((job) => {
      if (this.calls.get(event.id) !== call) return null; // a later event has its own call
      const present = this.rows.get(job.id);
      if (present) this.change(present, job); else this.add(job);
      return this.count();
    }).catch(() => {});
  }
}

export async function jobList(root, component, signal) {
  const jobs = new JobTable(component, signal);
  const ofComponent = component ? `&component=${encodeURIComponent(component)}` : "";
  let status = "", following = null, loads = 0;
  const query = (kind = status, limit = SHOWN) => `v1/jobs?limit=${limit}${ofComponent}${kind ? `&status=${kind}` : ""}`;
  const load = async (path, fresh) => {
    if (fresh) loads += 1;
    const number = loads; // a slow reply must not replace that of a later filter
    let page = await get(path, signal);
    const running = fresh && !status ? (await get(query("running"), signal)).jobs : [];
    const waiting = fresh && ["", "waiting"].includes(status) ? (await get(query("waiting", MAX_WAITING), signal)).jobs.sort(inOrder) : [];
    if (number !== loads) return;
    if (fresh) jobs.clear();
    const ended = () => (status === "waiting" ? [] : page.jobs.filter((job) => job.status !== "waiting"));
    while (!fresh && page.next && !ended().length) page = await get(page.next.slice(1), signal);
    if (number !== loads) return;
    for (const job of [...running, ...(status ? waiting : waiting.slice(0, SHOWN)), ...ended()]) if (!jobs.rows.has(job.id)) jobs.add(job);
    following = status === "waiting" ? null : page.next;
    older.hidden = !following;
    if (fresh) { jobs.last = waiting.at(-1) || null; jobs.count(); }
  };
  const report = (error) => { if (!signal.aborted) notify(error.message, "wrong"); };
  const fresh = () => load(query(), true).catch((error) => { if (!signal.aborted) put(root, trouble(error)); });
  const older = el("button", { type: "button", hidden: true, onclick: () => load(following.replace(/^\//, ""), false).catch(report) }, "Older jobs");
  const [href, text] = component ? [`#/c/${encodeURIComponent(component)}/query`, "Ask a query"] : ["#/", "Go to the library"];
  const empty = emptyState("No jobs. A query that the table does not cover queues a solve; so does filling the table.", el("a", { class: "button", href }, text));
  empty.hidden = true;
  const queue = el("p", { class: "muted small", id: "queue", "aria-live": "polite" });
  const filter = el("select", { "aria-label": "Which jobs", onchange: (event) => { status = event.target.value; fresh(); } },
    ["", "waiting", "running", "done", "failed", "cancelled"].map((name) => el("option", { value: name }, name || "all")));
  const cancelAll = el("button", { type: "button", class: "small", hidden: true, onclick: () => cancelWaiting(ofComponent).catch(report) }, "Cancel all waiting jobs");
  const titles = ["#Job", component ? null : "Component", "State", "Wrench", "Accepted", "#Took", ""].filter((title) => title !== null);
  const head = titles.map((title) => el("th", { scope: "col", class: title[0] === "#" ? "number" : null }, title.replace("#", ""))); // #: numbers
  const all = el("table", { class: `folds jobs${component ? "" : " all"}` }, el("thead", {}, el("tr", {}, head)), jobs.running, jobs.waiting, jobs.ended);
  jobs.count = () => {
    empty.hidden = jobs.rows.size > 0;
    all.hidden = !empty.hidden;
    const waiting = [...jobs.rows.values()].map((row) => row.job).filter((job) => job.status === "waiting");
    get(query("waiting", 1), signal).then((reply) => { cancelAll.hidden = !reply.jobs.length; }).catch(() => {});
    const hidden = jobs.last && !jobs.rows.has(jobs.last.id) ? [jobs.last] : []; // of a long queue
    return waitingTime([...waiting, ...hidden].sort(inOrder).at(-1), queue, signal);
  };
  put(root, el("div", { class: "line ends" }, el("label", { class: "line" }, "Show", filter), cancelAll), queue, all, empty, older);
  await fresh();
  listen(component, signal, (kind, body) => { // jobs: many have changed; hello, missed: some may have changed before
    if (["jobs", "hello", "missed"].includes(kind)) fresh();
    if (kind === "job") jobs.update(body, status !== "");
  });
}

async function cancelWaiting(ofComponent) {
  const { cancelled } = await (await send("DELETE", `v1/jobs?status=waiting${ofComponent}`)).json();
  notify(`${counted(cancelled, "job")} cancelled.`);
}

// The order in which the server starts jobs of one actor.
const inOrder = (a, b) => (b.priority || 0) - (a.priority || 0) || a.id - b.id;

const rough = (value) => (value < 120 ? `${Math.max(1, Math.round(value))} s` : `${Math.round(value / 60)} min`);

// When the newest waiting job, and so the queue, is expected to be solved.
async function waitingTime(job, place, signal) {
  put(place);
  if (!job) return;
  const { waiting } = await get(`v1/jobs/${job.id}`, signal).catch(() => ({}));
  if (!waiting) return;
  const isKnown = waiting.expected_s !== null && waiting.solve_s !== null;
  put(place, `${waiting.ahead + 1} waiting${isKnown ? `; all are solved in about ${rough(waiting.expected_s + waiting.solve_s)}` : ""}.`);
}

const TRACEBACK = /^Traceback \(most recent call last\):$/m; // of Python: the lines above have its cause

export async function showLog({ id, error: cause }) {
  const text = el("pre", { tabindex: "0" }, "…"), trace = el("pre", { tabindex: "0" }), folded = el("details", { hidden: true }, el("summary", {}, "Where in the program it failed"), trace);
  const dialog = el("dialog", { "aria-label": `Log of job ${id}`, onclose: () => dialog.remove() },
    el("div", { class: "stack" }, el("h2", {}, `Log of job ${id}`), cause ? note("outside", failureWords(cause)) : null, text, folded,
      el("div", { class: "line" }, el("button", { class: "first", onclick: () => dialog.close() }, "Close"),
        el("button", { type: "button", onclick: () => saveFiles(id) }, "Save all files of the attempt"))));
  document.body.append(dialog);
  dialog.showModal();
  try {
    const log = await (await send("GET", `v1/jobs/${id}/log`)).text(), begun = cause ? log.search(TRACEBACK) : -1;
    const printed = begun < 0 ? log : log.slice(0, begun);
    text.textContent = printed.trim() ? printed : "The solver printed nothing.";
    folded.hidden = begun < 0;
    text.hidden = !folded.hidden && !printed.trim();
    trace.textContent = log.slice(printed.length);
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
    ["Component", el("a", { href: `#/c/${job.component}` }, job.component)], ["Actor", actorOf(job.actor)], ["Wrench", inputsElement(job)],
    ["Attempt", job.attempt ? String(job.attempt) : ""], ["Accepted", time(job.created, SECONDS)], ["Started", job.started ? time(job.started, SECONDS) : ""],
    ["Ended", job.finished ? time(job.finished, SECONDS) : ""], ["Took", job.seconds ? seconds(job.seconds) : ""], ["Row", job.row ? rowLink(job.component, job.row) : ""],
    ["Waits", job.waiting?.reason ? sentence(job.waiting.reason) : ""],
    ["Notes", job.notes?.length ? el("ul", {}, job.notes.map((text) => el("li", {}, sentence(text)))) : ""],
    ["Failed", job.error ? failure(job.error) : ""],
  ];
}

const KINDS = { snap_through: "buckling or snap-through" };
export const kindWords = (kind) => KINDS[kind] || kind.replaceAll("_", " ");
const failure = (error) => note("outside", el("strong", {}, sentence(kindWords(error.kind || "failed"))), failureWords(error));

// The cause of a failure and its remedy, each once: many messages have both.
export function failureWords({ kind, message, remedy }) {
  const cause = kind && message.startsWith(`${kind}: `) ? message.slice(kind.length + 2) : message;
  const isMissing = remedy && !cause.includes(remedy);
  return [el("span", {}, sentence(cause)), isMissing ? el("span", {}, `Remedy: ${remedy}`) : null].filter(Boolean);
}
