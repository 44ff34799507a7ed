// Which view an address shows, the bar on top, the key and the colours.

import { key, send, setKey, trouble } from "./api.js";
import { el, note, notify, put } from "./dom.js";
import "./theme.js";

const VIEWS = [
  [/^\/$/, "library.js"],
  [/^\/add$/, "add.js"],
  [/^\/c\/([^/?]+)(?:\/([a-z]+))?(?:\?(.*))?$/, "component.js"],
  [/^\/jobs(?:\/(\d+))?$/, "jobs.js"],
  [/^\/scene$/, "scene.js"],
  [/^\/audit$/, "audit.js"],
  [/^\/terms$/, "terms.js"],
];
const main = document.getElementById("main");
let leaving = new AbortController();

async function show() {
  const address = location.hash.slice(1) || "/";
  leaving.abort();
  leaving = new AbortController();
  const { signal } = leaving;
  markWhereWeAre(address);
  const [file, found] = viewOf(address);
  const back = address === "/" ? "" : address.startsWith("/jobs/") ? el("a", { href: "#/jobs" }, "Go to the jobs") : el("a", { href: "#/" }, "Go to the library");
  document.title = "wrenchbook";
  if (!file) {
    put(main, el("h1", {}, "No such page"), el("p", {}, back));
    return;
  }
  try {
    const view = await import(`./${file}`);
    if (!signal.aborted) await view.show(main, found.map((one, place) => one && (place < 2 ? decodeURIComponent(one) : one)), signal);
  } catch (error) {
    if (error.name === "AbortError" || signal.aborted) return;
    put(main, el("h1", {}, "This view cannot be shown"), trouble(error), el("p", {}, back));
  }
}

function viewOf(address) {
  for (const [pattern, file] of VIEWS) {
    const found = address.match(pattern);
    if (found) return [file, found.slice(1)];
  }
  return [null, []];
}

function markWhereWeAre(address) {
  const room = ["#/jobs", "#/scene", "#/audit", "#/terms"].find((one) => `#${address}`.startsWith(one)) || (viewOf(address)[0] ? "#/" : "");
  for (const link of document.querySelectorAll(".main-nav a")) {
    if (link.getAttribute("href") === room) link.setAttribute("aria-current", "page");
    else link.removeAttribute("aria-current");
  }
}

let retry = 0;
function noAnswer() {
  Object.assign(document.getElementById("state"), { textContent: "no answer", className: "state faulty", title: "The server does not answer." });
  clearTimeout(retry);
  retry = setTimeout(tellState, RETRY_MS);
}
const RETRY_MS = 2000; // between looks at a server that is away

async function tellState() {
  if (document.hidden) return;
  const place = document.getElementById("state");
  const set = (text, kind, more = "") => { if (place.textContent !== text + more) put(place, text, el("span", { class: "detail" }, more)); place.className = `state ${kind}`; };
  try {
    const state = await (await send("GET", "health/ready", { quiet: true })).json();
    if (document.querySelector("main .lost") && !document.querySelector("main form")) show(); // a form keeps what was typed
    if (state.building.length) set("building", "ready", ` ${state.building.join(", ")}`);
    else if (state.status === "degraded") set("degraded", "faulty", `: ${Object.keys(state.broken).join(", ")}`);
    else set("ready", "ready");
    place.title = Object.entries(state.broken).map(([name, reason]) => `${name}: ${reason}`).join("\n");
  } catch (error) {
    const fault = error.body?.faults?.[0];
    if (!error.status) { noAnswer(); return; }
    set(fault ? "not ready" : error.status === 401 ? "needs a key" : "no answer", "faulty");
    place.title = fault || error.message;
  }
}

function askForKey() {
  const input = el("input", { type: "password", autocomplete: "off", value: key(), "aria-label": "Key" });
  const close = () => { dialog.close(); dialog.remove(); };
  const refused = el("div", { "aria-live": "polite" });
  const use = async () => {
    const before = key(); // a refused key does not cost the one that worked
    setKey(input.value.trim());
    const [needed, known] = await Promise.all(["", key()].map((one) => answers(one)));
    if (key() && !known && !needed) return put(refused, note("outside", "The server refuses this key. Copy it again, or ask for a new one."), setKey(before));
    verdict = !key() ? "" : needed ? " (not needed)" : " ✓";
    if (key() && needed) notify("This server needs no key.");
    close();
    markKey();
    tellState();
    return show();
  };
  const form = el("form", {
    method: "dialog", class: "stack",
    onsubmit: (event) => { event.preventDefault(); use(); },
  },
    el("h2", {}, "Key"),
    el("p", {}, "A server that other machines can reach needs a key. The key is stored until this tab is closed and is sent to this server only."),
    input, refused,
    el("div", { class: "line" },
      el("button", { class: "first" }, "Use this key"),
      el("button", { type: "button", onclick: () => { input.value = ""; form.requestSubmit(); } }, "Delete the key"),
      el("button", { type: "button", class: "quiet", onclick: close }, "Cancel")));
  const dialog = el("dialog", { "aria-label": "Key", onclose: () => dialog.remove() }, form);
  document.body.append(dialog);
  dialog.showModal();
}

// Whether the server answers a call with a key, or without one.
const answers = (one) => send("GET", "v1/components?limit=1", { quiet: true, as: one }).then(() => true, (error) => error.status !== 401);
let verdict = ""; // of the key, once it was tried

function markKey() {
  document.getElementById("key").textContent = key() ? `Key${verdict || " set"}` : "Key";
  markAudit();
}

// Only a key for admin may read the audit; a server without keys shows it to everybody.
async function markAudit() {
  const link = document.querySelector(".main-nav a[href='#/audit']");
  const refused = await send("GET", "v1/audit?limit=1", { quiet: true }).then(() => false, (error) => [401, 403].includes(error.status));
  link.hidden = refused;
}

document.getElementById("skip").addEventListener("click", (event) => { event.preventDefault(); main.focus(); });
document.getElementById("key").addEventListener("click", askForKey);
window.addEventListener("key-wanted", () => { if (!document.querySelector("dialog")) askForKey(); });
window.addEventListener("hashchange", async () => {
  window.scrollTo(0, 0);
  await show();
  // The link that was pressed may be gone: the next Tab leads on from the view, not from the top.
  if (!document.activeElement || document.activeElement === document.body) main.focus({ preventScroll: true });
});
document.addEventListener("visibilitychange", tellState);
window.addEventListener("no-connection", noAnswer);
markKey();
show();
tellState();
setInterval(tellState, 15000);
// Views are loaded ahead: one that is opened while the server is away says so in its own place.
setTimeout(async () => { for (const [, file] of VIEWS) await import(`./${file}`).then((view) => view.preload?.()).catch(() => {}); }, 3000);
