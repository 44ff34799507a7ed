// The tour of a first visit: three steps beside the view, shown once; Escape ends it.

import { el, put } from "./dom.js";

const SEEN = "wrenchbook-tour", LOOKS_MS = 10000; // as long as a view may take to show what a step points to
const STEPS = [
  ["query", "main .two form", "Ask a wrench", "Type the force and moment that act on the part, and press Ask. The answer is the displacement of its interface with a 95 % error bar."],
  ["overview", "main .halves .card", "See where the table is thin", "Coverage has a bar from the first row on. Its green part of the load range is answered within the tolerance; elsewhere an answer is an estimate."],
  ["overview", "#fill", "Fill the table", "This button queues the solves that lower the error most, up to the number that you give. Rows of a test rig come in under Import & export."],
];

// Begins the tour at a part whose mesh is fine enough for its tolerance, else one that can be solved, unless this browser has seen it.
export function tour(components, again = false) {
  const parts = components.filter((one) => one.has_fea && !one.space), nonlinear = parts.filter((one) => !one.linear);
  const part = nonlinear.find((one) => one.name === "plate_thin") ?? nonlinear.find((one) => one.rows) ?? nonlinear[0] ?? parts[0];
  if (!part || (!again && localStorage.getItem(SEEN)) || document.querySelector("dialog")) return;
  localStorage.setItem(SEEN, "yes");
  let now = -1, stop = () => {};
  const title = el("h2", { id: "tour-title" }), text = el("p", { "aria-live": "polite" });
  const next = el("button", { type: "button", class: "first", autofocus: true, onclick: () => go(now + 1) });
  const dialog = el("dialog", { class: "tour stack", "aria-labelledby": "tour-title", onclose: () => { stop(); dialog.remove(); }, onkeydown: (event) => { if (event.key === "Escape") dialog.close(); } },
    title, text, el("div", { class: "line ends" }, next, el("button", { type: "button", class: "quiet", onclick: () => dialog.close() }, "End the tour")));
  const say = (head, body, press) => { put(title, head); put(text, body); put(next, press); };
  const go = (step) => {
    stop();
    if (step === STEPS.length) { dialog.close(); return; }
    const [view, selector, head, body] = STEPS[now = step];
    location.hash = `#/c/${encodeURIComponent(part.name)}/${view}`;
    say(`${step + 1} of ${STEPS.length}: ${head}`, body, step + 1 < STEPS.length ? "Next" : "Done");
    stop = pointTo(selector);
  };
  say("New here?", `Three steps show how a table works, with the component ${part.name}.`, "Begin");
  document.body.append(dialog);
  dialog.show();
}

// Outlines the first element that fits, whenever the view is drawn; returns what ends it.
function pointTo(selector) {
  let at = null;
  const look = () => {
    const found = document.querySelector(selector);
    if (found === at) return;
    at?.classList.remove("pointed");
    at = found;
    at?.classList.add("pointed");
    at?.scrollIntoView({ block: innerWidth < 760 ? "start" : "center" }) ; // on a telephone the tour has the lower half
  };
  const watch = new MutationObserver(look);
  watch.observe(document.getElementById("main"), { childList: true, subtree: true });
  setTimeout(() => watch.disconnect(), LOOKS_MS);
  look();
  return () => { watch.disconnect(); at?.classList.remove("pointed"); };
}
