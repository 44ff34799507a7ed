// Server-sent events, read by fetch: EventSource could not send a key.

import { send } from "./api.js";

const FIRST_MS = 1500, MOST_MS = 30000; // between tries to connect again: each twice the last

// Tells `hear(kind, body)` what happens until `signal`, over broken connections too. A window that
// nobody sees does not listen: a browser has six connections to a server for all its windows.
export async function listen(component, signal, hear) {
  let last = null, pause = FIRST_MS;
  while (!signal.aborted) {
    await seen(signal);
    const hidden = new AbortController();
    const leave = () => { if (document.hidden) hidden.abort(); };
    document.addEventListener("visibilitychange", leave);
    try {
      const query = component ? `?component=${encodeURIComponent(component)}` : "";
      const headers = last ? { "Last-Event-ID": last } : {};
      const reply = await send("GET", `v1/events${query}`, { headers, signal: AbortSignal.any([signal, hidden.signal]), quiet: true });
      pause = FIRST_MS;
      for await (const event of parts(reply.body)) {
        last = event.id || last;
        if (event.event) hear(event.event, JSON.parse(event.data || "{}"));
      }
    } catch (error) {
      if (signal.aborted || [401, 403, 404].includes(error.status)) return;
    } finally {
      document.removeEventListener("visibilitychange", leave);
    }
    if (!hidden.signal.aborted) await new Promise((done) => setTimeout(done, pause));
    pause = Math.min(MOST_MS, 2 * pause);
  }
}

// Tells `hear()` of each version of a component's table that is newer than `known`, and `hearJob(body)` of its jobs.
export function listenToTable(component, known, signal, hear, hearJob = () => {}) {
  let newest = known;
  return listen(component, signal, (kind, body) => {
    if (["job", "jobs"].includes(kind)) hearJob(body);
    const version = kind === "table" ? body.table_version : kind === "hello" ? body.tables?.[component] : null;
    if (!(version > newest)) return;
    newest = version;
    hear();
  });
}

function seen(signal) {
  if (!document.hidden) return null;
  return new Promise((done) => {
    const look = () => { if (!document.hidden || signal.aborted) { document.removeEventListener("visibilitychange", look); done(); } };
    document.addEventListener("visibilitychange", look);
    signal.addEventListener("abort", look);
  });
}

async function* parts(stream) {
  const reader = stream.pipeThrough(new TextDecoderStream()).getReader();
  let held = "";
  for (;;) {
    const { value, done } = await reader.read();
    if (done) return;
    const blocks = (held + value).split("\n\n");
    held = blocks.pop();
    for (const block of blocks) {
      const event = {};
      for (const line of block.split("\n")) {
        const colon = line.indexOf(":");
        if (colon > 0) event[line.slice(0, colon)] = line.slice(colon + 1).trimStart();
      }
      yield event;
    }
  }
}
