// Jobs with live progress: running ones, waiting ones in the order of their start, then the newest; cancel, retry, the log of a failed one.

import { get, post, send, trouble } from "./api.js";
import { el, note, notify, pill, put, save } from "./dom.js";
import { empty as emptyState } from "./empty.js";
import { listen } from "./events.js";
import { actorOf, counted, seconds, sentence, time } from "./format.js";
import { inputsElement } from "./inputs.js";
import { rowLink } from "./rows.js";

const SHOWN = 50, MOST_WAITING = 1000, NEWEST = 20; // jobs: of a page; put in the order of their start; whose solve times are averaged

export async function jobList(root, component, signal) {
  const list = { running: el("tbody", { class: "running" }), waiting: el("tbody", { class: "waiting" }), root: el("tbody", {}), rows: new Map(), last: null, loads: 0, withName: !component, means: new Map(), calls: new Map(), signal };
  const status = { value: "" };
  const older = el("button", { type: "button", hidden: true }, "Older jobs");
  let following = null;
  const load = async (path, fresh) => {
    const turn = fresh ? ++list.loads : list.loads; // a slow reply must not replace that of a later filter
    let page = await get(path, signal);
    const running = fresh && !status.value ? (await get(query("running"), signal)).jobs : [];
    const waiting = fresh && ["", "waiting"].includes(status.value) ? (await get(query("waiting", MOST_WAITING), signal)).jobs.sort(inOrder) : [];
    if (turn !== list.loads) return;
    if (fresh) { list.rows.clear(); put(list.root); put(list.running); put(list.waiting); }
    const ended = () => (status.value === "waiting" ? [] : page.jobs.filter((job) => job.status !== "waiting"));
    while (!fresh && page.next && !ended().length) page = await get(page.next.slice(1), signal);
    if (turn !== list.loads) return;
    for (const job of [...running, ...(status.value ? waiting : waiting.slice(0, SHOWN)), ...ended()]) if (!list.rows.has(job.id)) place(list, rowOf(list, job));
    following = status.value === "waiting" ? null : page.next;
    if (fresh) { list.last = waiting.at(-1) || null; list.count(); }
    older.hidden = !following;
  };
  const query = (kind = status.value, limit = SHOWN) => `v1/jobs?limit=${limit}${component ? `&component=${encodeURIComponent(component)}` : ""}${kind ? `&status=${kind}` : ""}`;
  const empty = emptyState("No jobs. A query that the table does not cover queues a solve; so does filling the table.", component ? el("a", { class: "button", href: `#/c/${encodeURIComponent(component)}/query` }, "Ask a query") : el("a", { class: "button", href: "#/" }, "Go to the library"));
  empty.hidden = true;
  const queue = el("p", { class: "muted small", id: "queue", "aria-live": "polite" });
  list.count = () => {
    empty.hidden = list.rows.size > 0;
    all.hidden = !empty.hidden;
    const waiting = [...list.rows.values()].map((row) => row.job).filter((job) => job.status === "waiting");
    get(query("waiting", 1), signal).then(({ jobs }) => { cancelAll.hidden = !jobs.length; }).catch(() => {});
    const hidden = list.last && !list.rows.has(list.last.id) ? [list.last] : []; // of a long queue
    return waitingTime([...waiting, ...hidden].sort(inOrder).at(-1), queue, signal);
  };
  const wrong = (error) => { if (!signal.aborted) notify(error.message, "wrong"); };
  const fresh = () => load(query(), true).catch((error) => { if (!signal.aborted) put(root, trouble(error)); });
  older.addEventListener("click", () => load(following.replace(/^\//, ""), false).catch(wrong));
  const filter = el("select", { "aria-label": "Which jobs", onchange: (event) => { status.value = event.target.value; fresh(); } },
    ["", "waiting", "running", "done", "failed", "cancelled"].map((one) => el("option", { value: one }, one || "all")));
  const cancelAll = el("button", { type: "button", class: "small", hidden: true, onclick: () => cancelWaiting(component).catch(wrong) }, "Cancel all waiting jobs");
  const head = ["#Job", component ? null : "Component", "State", "Wrench", "Accepted", "#Took", ""].filter((one) => one !== null);
  const all = el("table", { class: `folds jobs${component ? "" : " all"}` }, el("thead", {}, el("tr", {}, head.map((one) => el("th", { scope: "col", class: one[0] === "#" ? "number" : null }, one.replace("#", ""))))), list.running, list.waiting, list.root);
  put(root,
    el("div", { class: "line ends" }, el("label", { class: "line" }, "Show", filter), cancelAll), queue,
    all, empty, older);
  await fresh();
  listen(component, signal, (kind, body) => hear(list, kind, body, fresh, status));
}

// An event tells of one job, or that many have changed at once; jobs may have ended before a connection.
function hear(list, kind, body, fresh, status) {
  if (["jobs", "hello", "missed"].includes(kind)) fresh();
  if (kind !== "job") return;
  if (body.id === list.last?.id && body.status !== "waiting") list.last = null;
  const row = list.rows.get(body.id);
  const moved = row?.job.status !== body.status;
  if (row) change(list, row, { ...row.job, ...body });
  if (!moved || (!row && status.value)) return;
  const call = get(`v1/jobs/${body.id}`, list.signal); // events do not tell how long it took
  list.calls.set(body.id, call);
  call.then((job) => {
    if (list.calls.get(body.id) !== call) return null; // a later event has its own
    const now = list.rows.get(job.id);
    if (now) change(list, now, job); else place(list, rowOf(list, job));
    return list.count();
  }).catch(() => {});
}

async function cancelWaiting(component) {
  const { cancelled } = await (await send("DELETE", `v1/jobs?status=waiting${component ? `&component=${encodeURIComponent(component)}` : ""}`)).json();
  notify(`${counted(cancelled, "job")} cancelled.`);
}

function rowOf(list, job) {
  const row = { root: el("tr", { id: `job-${job.id}` }), job };
  list.rows.set(job.id, row);
  change(list, row, job);
  return row;
}

// The order in which the server starts jobs of one actor.
const inOrder = (a, b) => (b.priority || 0) - (a.priority || 0) || a.id - b.id;

const bodyOf = (list, { status }) => ({ running: list.running, waiting: list.waiting })[status] || list.root;

// Of running and of ended jobs the newest is first.
function place(list, row) {
  const body = bodyOf(list, row.job), after = body === list.waiting ? (job) => inOrder(job, row.job) > 0 : (job) => job.id < row.job.id;
  body.insertBefore(row.root, [...body.children].find((one) => after(list.rows.get(Number(one.id.slice(4))).job)) || null);
}

// When the newest waiting job, and so the queue, is expected to be solved.
async function waitingTime(job, place_, signal) {
  put(place_);
  if (!job) return;
  const { waiting } = await get(`v1/jobs/${job.id}`, signal).catch(() => ({}));
  if (!waiting) return;
  const left = waiting.expected_s === null || waiting.solve_s === null ? "" : `; all are solved in about ${rough(waiting.expected_s + waiting.solve_s)}`;
  put(place_, `${waiting.ahead + 1} waiting${left}.`);
}

// What a solve of a component took on average, s, of its newest; null if there is none.
function meanOf(list, component) {
  if (!list.means.has(component)) {
    list.means.set(component, get(`v1/jobs?component=${encodeURIComponent(component)}&status=done&limit=${NEWEST}`, list.signal)
      .then(({ jobs }) => (jobs.length ? jobs.reduce((sum, job) => sum + job.seconds, 0) / jobs.length : null)).catch(() => null));
  }
  return list.means.get(component);
}

async function expected(list, job, place_) {
  const mean = await meanOf(list, job.component), ran = (Date.now() - new Date(job.started)) / 1000;
  if (mean !== null) place_.textContent = ran < mean ? `about ${rough(mean - ran)} left` : `longer than the mean, ${rough(mean)}`;
}

const rough = (value) => (value < 120 ? `${Math.max(1, Math.round(value))} s` : `${Math.round(value / 60)} min`);

function change(list, row, job) {
  const moves = row.root.isConnected && bodyOf(list, row.job) !== bodyOf(list, job);
  row.job = job;
  if (moves) place(list, row);
  const left = el("span", { class: "small muted" });
  if (job.status === "running" && job.started) expected(list, job, left);
  const running = job.status === "running";
  const fraction = job.progress?.fraction;
  put(row.root,
    el("td", { class: "number" }, el("a", { href: `#/jobs/${job.id}` }, String(job.id))),
    list.withName ? el("td", {}, el("a", { href: `#/c/${job.component}` }, job.component)) : null,
    el("td", { class: running || job.error ? "whole" : null }, el("div", { class: "stack tight" }, el("div", { class: "line" }, pill(job.status), running && job.progress ? el("span", { class: "small muted" }, job.progress.message) : null),
      running ? el("progress", { max: "1", value: fraction ?? 0, "aria-label": `Job ${job.id}` }) : null, running ? left : null)),
    el("td", { class: "small whole" }, inputsElement(job), job.status === "failed" && job.error ? el("div", { class: "muted" }, failureWords(job.error)[0]) : null),
    el("td", { class: "muted small" }, time(job.created).replaceAll(/(?<!,) /g, "\u00a0"), job.actor && job.actor !== "(anonymous)" ? el("div", {}, `by ${actorOf(job.actor)}`) : null),
    el("td", { class: "muted small number" }, job.seconds ? seconds(job.seconds) : ""),
    el("td", {}, actions(list, row, job)));
}

function actions(list, row, job) {
  const act = (call) => async () => {
    try { change(list, row, await call()); await list.count(); } catch (error) { notify(error.message, "wrong"); }
  };
  const buttons = [];
  if (["waiting", "running"].includes(job.status)) buttons.push(["Cancel", act(async () => (await send("DELETE", `v1/jobs/${job.id}`)).json())]);
  if (["failed", "cancelled"].includes(job.status)) buttons.push(["Retry", act(() => post(`v1/jobs/${job.id}/retry`, {}))]);
  if (job.attempt && job.status !== "waiting") buttons.push(["Log", () => showLog(job)]);
  return el("div", { class: "line" }, buttons.map(([text, press]) => el("button", { type: "button", class: "small", "aria-label": `${text} job ${job.id}`, onclick: press }, text)));
}

const TRACEBACK = /^Traceback \(most recent call last\):$/m; // of Python: the message above has its cause

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
    ["Attempt", job.attempt ? String(job.attempt) : ""], ["Accepted", time(job.created)], ["Started", job.started ? time(job.started) : ""],
    ["Ended", job.finished ? time(job.finished) : ""], ["Took", job.seconds ? seconds(job.seconds) : ""], ["Row", job.row ? rowLink(job.component, job.row) : ""],
    ["Waits", job.waiting?.reason ? sentence(job.waiting.reason) : ""],
    ["Notes", job.notes?.length ? el("ul", {}, job.notes.map((one) => el("li", {}, sentence(one)))) : ""],
    ["Failed", job.error ? failure(job.error) : ""],
  ];
}

const KINDS = { snap_through: "buckling or snap-through" };
export const kindWords = (kind) => KINDS[kind] || kind.replaceAll("_", " ");
const failure = (error) => note("outside", el("strong", {}, sentence(kindWords(error.kind || "failed"))), failureWords(error));

// Why a solve failed, and what helps, each once: messages often hold both.
export function failureWords({ kind, message, remedy }) {
  const words = kind && message.startsWith(`${kind}: `) ? message.slice(kind.length + 2) : message;
  return [el("span", {}, sentence(words)), remedy && !words.includes(remedy) ? el("span", {}, `Remedy: ${remedy}`) : null].filter(Boolean);
}
