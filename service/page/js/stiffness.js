// The measured stiffness between two loads: lines of load over displacement, and the play.

import { get, of, trouble } from "./api.js";
import { el, field, note, put, select, table } from "./dom.js";
import { LOADS, OUTPUTS, count, number, plain, rounded, unitOfLoad, withBar } from "./format.js";

const ROWS = { all: "all", loading: "loading", unloading: "unloading", opposite: "opposite sign" };
const PLAY = { branches: "loading and unloading", signs: "positive and negative loads" };

export function stiffnessForm(about, signal) {
  const shown = el("div", { "aria-live": "polite", class: "stack", id: "stiffness" });
  const input = (id, label) => el("input", { id, type: "number", step: "any", required: true, "aria-label": label });
  const low = input("stiffness-low", "Lowest load"), high = input("stiffness-high", "Highest load");
  const one = (names) => select([["", "automatic"], ...(about.space ? [] : names.map((name) => [name, plain(name)]))], "");
  const axis = one(LOADS), output = one(OUTPUTS);
  const ask = async (event) => {
    event.preventDefault();
    const asked = new URLSearchParams({ between: `${low.value},${high.value}`, axis: axis.value, of: output.value });
    try { put(shown, drawn(await get(`${of(about.name)}/stiffness?${asked}`, signal))); } catch (error) { if (!signal.aborted) put(shown, trouble(error)); }
  };
  return el("form", { class: "stack", onsubmit: ask },
    el("p", { class: "muted small" }, "The slope of load over displacement of measured rows between two loads: least squares with the displacement on x and the load on y."),
    el("div", { class: "few" }, field("From, N or N·m", low), field("To, N or N·m", high), field("Load", axis), field("Displacement", output)),
    el("div", {}, el("button", { id: "stiffness-ask" }, "Compute")), shown);
}

function drawn(body) {
  const lines = Object.entries(body.lines).filter(([, line]) => line), unit = body.unit.split("/").at(-1), load = unitOfLoad(body.axis.slice(-2));
  if (!lines.length) return note("thin", "Fewer than three measured rows are between these loads.");
  const plays = Object.entries(body.play).filter(([, play]) => play && play.value !== null), others = Object.entries(body.other_loads);
  return [
    table(["Rows", "#number", `#slope, ${body.unit}`, `#± 95 %, ${body.unit}`, `#residual, ${load}`, "#r²"], lines.map(([name, line]) => {
      const { value, bar } = rounded(line.slope, line.slope_half_width);
      return [ROWS[name], count(line.rows), value, bar, number(line.residual, 3), number(line.r2, 5)];
    }),
      { caption: `${plain(body.axis.slice(-2))} over ${body.of}, ${number(body.between[0])} to ${number(body.between[1])}`, scrolls: true }),
    plays.map(([name, play]) => {
      const { value, bar } = withBar(play.value, play.half_width, unit);
      return el("p", {}, `Play at no load, between ${PLAY[name]}: ${value} ${bar}`);
    }),
    others.length ? note("thin", `Other loads vary in these rows, and the slopes have their effect: ${others.map(([name, size]) => `${name} by ${number(size, 3)}`).join(", ")}.`) : null,
  ];
}
