// The service's calls: JSON in and out, problems as errors, events as they come.

import { note, el } from "./dom.js";

const KEY = "wrenchbook-key";
export const base = new URL(".", document.baseURI);

export class Problem extends Error {
  constructor(status, body) {
    super(body.detail || body.title || `The server answered ${status}.`);
    this.status = status;
    this.body = body;
  }
}

export function key() {
  return sessionStorage.getItem(KEY) || "";
}

export function setKey(text) {
  if (text) sessionStorage.setItem(KEY, text);
  else sessionStorage.removeItem(KEY);
}

let pending = 0;

// A bar under the header shows that calls are pending, 0.3 s after they began (base.css).
function counted(change) {
  pending += change;
  document.body.classList.toggle("busy", pending > 0);
}

export async function send(method, path, { json, body, headers = {}, signal, quiet, as = key() } = {}) {
  const sent = { ...headers };
  if (json !== undefined) sent["Content-Type"] = "application/json";
  if (as) sent.Authorization = `Bearer ${as}`;
  let reply;
  if (!quiet) counted(1);
  try {
    reply = await fetch(new URL(path, base), {
      method, headers: sent, body: json === undefined ? body : JSON.stringify(json), signal,
    });
  } catch (error) {
    if (error.name === "AbortError") throw error;
    window.dispatchEvent(new Event("no-connection"));
    throw new Problem(0, { title: "No connection", detail: "The server does not answer. Is it running?" });
  } finally {
    if (!quiet) counted(-1);
  }
  if (reply.ok) return reply;
  const problem = await reply.json().catch(() => ({}));
  if (reply.status === 401 && !quiet) window.dispatchEvent(new Event("key-wanted"));
  throw new Problem(reply.status, problem);
}

export async function get(path, signal) {
  return (await send("GET", path, { signal })).json();
}

export async function post(path, json, signal) {
  return (await send("POST", path, { json, signal })).json();
}

// All components of the library, page after page.
export async function listed(signal, archived = false) {
  const library = { components: [], broken: [] };
  let url = `v1/components${archived ? "?archived=true" : ""}`;
  while (url) {
    const page = await get(url, signal);
    library.components.push(...page.components);
    library.broken = page.broken;
    url = page.next?.slice(1);
  }
  return library;
}

export const of = (name) => `v1/components/${encodeURIComponent(name)}`;

// Waits until a table answers with all rows there are.
export const caughtUp = (name, signal) => get(`${of(name)}/drawing?most=1`, signal);

// The note in the place of a failed call: the server's message, which says what to do.
export function trouble(error) {
  // Browsers name a script that cannot be fetched differently.
  if (error instanceof Problem ? error.status === 0 : /module|Failed to fetch|could not be loaded/.test(error.message)) {
    window.dispatchEvent(new Event("no-connection"));
    return note("outside lost", el("strong", {}, "No connection"), el("span", {}, "The server does not answer. Start it again, or check the network. The view is shown when it answers."), el("div", {}, el("button", { type: "button", onclick: () => location.reload() }, "Retry")));
  }
  if (error.status === 401) return note("outside", el("strong", {}, "A key is needed"), el("span", {}, key() ? "The server refuses the key of this tab." : "The server answers only with a key. Its operator has one."), el("div", {}, el("button", { type: "button", onclick: () => window.dispatchEvent(new Event("key-wanted")) }, "Enter a key")));
  const title = error instanceof Problem ? error.body.title : "Error in the page";
  const mistakes = error.body?.errors || [];
  // A message that contains all mistakes is cut where their list begins; views list what a call would.
  const texts = mistakes.map(({ loc, msg }) => `${loc}: ${msg}`);
  const hasAll = texts.length > 1 && texts.every((one) => error.message.includes(one));
  const text = hasAll ? error.message.slice(0, error.message.indexOf(texts[0])).trim() : error.message.replace(/; list [^;]*GET \S+$/, ".").replace(/^[a-z]/, (first) => first.toUpperCase());
  return note("outside",
    el("strong", {}, title || "The call failed"), el("span", {}, text),
    texts.length > 1 ? el("ul", {}, texts.slice(0, 20).map((one) => el("li", {}, one))) : null);
}
