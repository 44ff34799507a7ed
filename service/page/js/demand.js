// Demand: what was asked that the table did not cover.

import { Problem, get, of, send } from "./api.js";
import { el, notify, put, table } from "./dom.js";
import { empty, linkTo } from "./empty.js";
import { count, number, plain, wrench, LOADS, unitOfLoad } from "./format.js";
import { choice } from "./dom.js";
import { AXES } from "./inputs.js";
import { box } from "./load_box.js";
import { draw } from "./plot.js";
import { CUBE, figure } from "./view3d.js";


export async function show(root, about, signal) {
  let reply;
  try {
    reply = await get(`${of(about.name)}/demand`, signal);
  } catch (error) {
    if (!(error instanceof Problem) || error.status !== 404) throw error;
    put(root, el("p", { class: "empty" }, "This server keeps no query statistics."));
    return;
  }
  if (!reply.cells?.length) {
    put(root, empty("No query was thin or outside the table yet.", linkTo(about, "query", "Ask a query")));
    return;
  }
  const place = Object.assign(el("div", { class: "plot", id: "demand" }), { fit: { box: CUBE } });
  const view = figure(place, `Uncovered queries of ${about.name}`, marks(reply));
  const state = { axis: "z" };
  let drawing = null;
  const forget = async () => { if (!confirm("Delete the statistics of all queries of this component?")) return; await send("DELETE", `${of(about.name)}/demand`); notify("Forgotten."); await show(root, about, signal); };
  put(root,
    el("section", { class: "card" },
      el("div", { class: "line bottom ends" }, choice("demand-axis", "Loads of", Object.keys(AXES).map((one) => [one, `axis ${one}`]), "z", (value) => { state.axis = value; drawing?.again(); }),
        el("button", { type: "button", class: "small", onclick: forget }, "Delete the statistics")),
      el("p", { class: "muted" }, `${reply.asked === 1 ? "1 query was" : `${count(reply.asked)} queries were`} not covered when asked; rows that came later may cover the same loads now. A larger mark stands for more queries. The frame is the load range: ${about.has_fea ? "fill the table for loads within it; for loads beyond it, widen [range] in component.toml" : "import rows near these loads"}.`), view.root),
    el("section", { class: "card" }, el("h2", {}, "Most frequent"), most(reply)));
  drawing = await draw(place, (shade) => picture(about, reply, state.axis, shade, view.camera()), signal, `${reply.cells.length} places with uncovered queries`);
  view.hold(drawing);
}

const SYMBOLS = { thin: "circle", outside: "diamond" }; // apart without their colours too
const KINDS = [["thin", "thin: rows near, error too large or unknown"], ["outside", "outside: no rows around, or beyond the load range"]];
const COLOURS = { thin: "thin", outside: "muted" }; // as in Response and Coverage

function marks({ cells }) {
  const one = (kind, text) => {
    const mark = el("i", { class: SYMBOLS[kind] });
    mark.style.background = `var(--${COLOURS[kind]})`;
    return el("li", {}, mark, text);
  };
  return el("ul", { class: "key-of-marks" }, KINDS.filter(([kind]) => cells.some((cell) => cell.coverage === kind)).map(([kind, text]) => one(kind, text)));
}

function picture(about, reply, axis, shade, camera) {
  const inputs = AXES[axis], largest = Math.max(...reply.cells.map((one) => one.count));
  const [x, y, z] = inputs.map((load) => reply.cells.map((one) => one.wrench[LOADS.indexOf(load)]));
  const data = [{
    type: "scatter3d", mode: "markers", x, y, z, text: reply.cells.map((one) => `${one.count} times, ${one.coverage}`),
    marker: { symbol: reply.cells.map((one) => SYMBOLS[one.coverage] || "circle"), size: reply.cells.map((one) => 3 + 9 * Math.sqrt(one.count / largest)), color: reply.cells.map((one) => shade[COLOURS[one.coverage] || "accent"]), opacity: 0.75 },
    hovertemplate: "%{text}<br>%{x:.4~g}, %{y:.4~g}, %{z:.4~g}<extra></extra>",
  }];
  const spans = [...about.range.force, ...about.range.moment];
  const reach = (load) => { // of the load range, and of what was asked beyond it
    const place = LOADS.indexOf(load), asked = reply.cells.map((one) => one.wrench[place]);
    return wide([Math.min(spans[place][0], ...asked), Math.max(spans[place][1], ...asked)]);
  };
  data.push(box(about, inputs.map((load) => LOADS.indexOf(load)), shade));
  const axis_ = (load) => ({ title: { text: `${plain(load)}, ${unitOfLoad(load)}` }, range: reach(load), nticks: 5 });
  return { data, layout: { scene: { xaxis: axis_(inputs[0]), yaxis: axis_(inputs[1]), zaxis: axis_(inputs[2]), aspectmode: "cube", camera } } };
}

const wide = ([low, high]) => [low - 0.05 * (high - low), high + 0.05 * (high - low)];

const OUTERMOST = 10; // cells from zero; that cell counts all queries farther away too (OUTERMOST in service/demand.py)

const share = (times) => (times ? count(times) : "–");

// A load of a cell as the interval that the cell counts; the cell of zero load as 0.
function interval(value, size) {
  if (!value) return "0";
  const near = Math.abs(value) - size / 2, far = near + size, side = value < 0 ? -1 : 1;
  if (near > (OUTERMOST - 1) * size) return `${side < 0 ? "≤" : "≥"} ${number(side * near, 3)}`;
  return (side < 0 ? [far, near] : [near, far]).map((end) => number(side * end, 3)).join(" to ");
}

function most(reply) {
  const rounded = (value, place) => interval(value, reply.cell_size[place]);
  const lines = [...reply.cells].sort((a, b) => b.count - a.count).slice(0, 15)
    .map((one) => [share(one.thin), share(one.outside), el("span", { class: "small" }, wrench(one.wrench.slice(0, 3), one.wrench.slice(3), 3, rounded))]);
  const half = reply.cell_size.map((one) => one / 2);
  return [
    table(["#thin", "#outside", "loads"], lines, { scrolls: true }),
    el("p", { class: "muted small" }, `Loads of one interval are counted together; 0 stands for ±\u00a0${wrench(half.slice(0, 3), half.slice(3))}. The picture has a mark at the middle of each interval. ≥ and ≤ count all that are farther out.${reply.elsewhere ? ` ${count(reply.elsewhere)} more were asked elsewhere.` : ""}`),
  ];
}
