// The plots of a report as SVG, for the page and for the report's own HTML file: imports nothing.

const MARKS = { circle: "M-5 0a5 5 0 1 0 10 0a5 5 0 1 0-10 0", square: "M-4.5-4.5h9v9h-9z", diamond: "M0-6 6 0 0 6-6 0z", triangle: "M0-6 6 5H-6z", x: "M-5-5 5 5M5-5-5 5", cross: "M-6 0H6M0-6V6" };
// Colour, mark and dash of each curve: curves that cross stay apart without colours too.
const LOOKS = { kriging: ["accent", "circle", ""], griddata: ["outside", "square", "7 5"], additive: ["query", "diamond", "12 4 3 4"], linear: ["covered", "x", "2 4"], other: ["muted", "cross", "12 5"], FEA: ["ink", "diamond", "2 4"] };
const HEIGHT = 360, BOX = { left: 72, right: 16, top: 14, bottom: 50 };
const UNITS = [[1, "s"], [1e-3, "ms"], [1e-6, "µs"], [1e-9, "ns"]];

const shown = (entries) => entries.filter((entry) => entry.largest_error > 0); // null: not answered

export const PLOTS = {
  front: ["Error against run time of one answer", (report, width) => curves(report, width, { ...groups(report), FEA: report.fea.slice(0, -1) }, (entry) => entry.seconds, timeText, "run time of one answer")],
  growth: ["Error against rows", (report, width) => curves(report, width, groups(report), (entry) => entry.rows, String, "rows of the table")],
  calibration: ["How often the true error lies within the error bar", calibration],
};

// Draws a plot of PLOTS into a place, and again whenever its width changes.
export function show(place, name, report) {
  const [title, make] = PLOTS[name];
  const again = () => {
    const picture = make(report, Math.max(280, place.clientWidth));
    picture.setAttribute("aria-label", `${title}; the figures are in the tables below`);
    place.replaceChildren(picture, legend(name === "front" ? [...Object.keys(groups(report)), "FEA"] : Object.keys(groups(report)), name));
    place.dataset.drawn = "1";
  };
  again();
  let width = place.clientWidth;
  new ResizeObserver(() => { if (place.clientWidth && place.clientWidth !== width) { width = place.clientWidth; again(); } }).observe(place);
}

// In one order for curves, bars and their key.
const inOrder = (entries) => [...entries].sort((a, b) => rank(a) - rank(b)), rank = ({ method }) => Object.keys(LOOKS).indexOf(method);

function groups(report) {
  const found = {};
  for (const entry of inOrder(report.tables)) (found[entry.method] ??= []).push(entry);
  return found;
}

function tag(name, attributes, ...children) {
  const made = document.createElementNS("http://www.w3.org/2000/svg", name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  made.append(...children.flat(Infinity).filter((one) => one !== null));
  return made;
}

const frame = (width, ...children) => tag("svg", { viewBox: `0 0 ${width} ${HEIGHT}`, width, height: HEIGHT, role: "img", "font-size": 12, fill: "var(--muted)" }, ...children);
const words = (x, y, text, more = {}) => tag("text", { x, y, "text-anchor": "middle", ...more }, text);
const rule = (x1, y1, x2, y2, more = {}) => tag("line", { x1, y1, x2, y2, stroke: "var(--line)", ...more });

// Ticks of a logarithmic axis: decades, or 1, 2 and 5 of each where there are few.
function ticks(low, high) {
  const all = [];
  for (let power = Math.floor(Math.log10(low)); power <= Math.log10(high); power += 1) for (const digit of [1, 2, 5]) all.push(digit * 10 ** power);
  const inside = all.filter((one) => one >= low * 0.999 && one <= high * 1.001);
  return inside.length > 6 ? inside.filter((one) => Math.abs(Math.log10(one) % 1) < 1e-9 || Math.abs(Math.log10(one) % 1) > 1 - 1e-9) : inside;
}

function span(values) {
  const low = Math.min(...values), high = Math.max(...values), more = Math.max(1.3, (high / low) ** 0.06);
  return [low / more, high * more];
}

function timeText(value) {
  const [scale, unit] = UNITS.find(([one]) => value >= one * 0.999) || UNITS.at(-1);
  return `${Number((value / scale).toPrecision(2))} ${unit}`;
}

const percentText = (value) => `${Number(value.toPrecision(2))} %`;

function curves(report, width, found, along, text, label) {
  const level = 100 * report.mesh_error;
  const entries = Object.entries(found).map(([name, list]) => [name, shown(list)]).filter(([, list]) => list.length);
  const points = entries.flatMap(([, list]) => list);
  if (!points.length) return frame(width, words(width / 2, HEIGHT / 2, "no errors to draw"));
  const [x0, x1] = span(points.map(along)), [y0, y1] = span([...points.map((one) => 100 * one.largest_error), ...(level ? [level] : [])]);
  const at = (value, low, high, from, to) => from + (to - from) * (Math.log(value / low) / Math.log(high / low));
  const x = (value) => at(value, x0, x1, BOX.left, width - BOX.right), y = (value) => at(value, y0, y1, HEIGHT - BOX.bottom, BOX.top);
  const places = (entry) => [x(along(entry)), y(100 * entry.largest_error)];
  const xs = ticks(x0, x1), fits = Math.max(2, Math.floor(width / 70));
  return frame(width,
    ticks(y0, y1).map((one) => [rule(BOX.left, y(one), width - BOX.right, y(one)), words(BOX.left - 8, y(one) + 4, percentText(one), { "text-anchor": "end" })]).flat(),
    xs.filter((_, k) => k % Math.ceil(xs.length / fits) === 0).map((one) => [rule(x(one), BOX.top, x(one), HEIGHT - BOX.bottom), words(x(one), HEIGHT - BOX.bottom + 18, text(one))]).flat(),
    words(width / 2, HEIGHT - 8, label), words(14, HEIGHT / 2 - 20, "largest RMS error, of the range", { transform: `rotate(-90 14 ${HEIGHT / 2 - 20})` }),
    entries.map(([name, list]) => {
      const [colour, mark, dash] = LOOKS[name] || LOOKS.other;
      return tag("g", { stroke: `var(--${colour})`, fill: `var(--${colour})` },
        tag("polyline", { points: list.map((one) => places(one).join()).join(" "), fill: "none", "stroke-width": 1.7, "stroke-dasharray": dash }),
        list.map((one) => tag("path", { d: MARKS[mark], transform: `translate(${places(one)})`, "stroke-width": 2 },
          tag("title", {}, `${one.name}: ${percentText(100 * one.largest_error)}, ${timeText(one.seconds)}`))));
    }),
    level ? [rule(BOX.left, y(level), width - BOX.right, y(level), { stroke: "var(--ink)", "stroke-dasharray": "7 5", "stroke-width": 1.5 }),
      words(BOX.left + 6, y(level) - 7, width < 500 ? "mesh error" : "mesh error: more rows approach it", { "text-anchor": "start", fill: "var(--ink)", stroke: "var(--card)", "stroke-width": 4, "paint-order": "stroke" })] : []);
}

function calibration(report, width) {
  const list = inOrder(report.tables.filter((entry) => entry.rows === report.rows)), names = report.outputs, right = width < 500 ? 44 : 112;
  const y = (share) => BOX.top + (HEIGHT - BOX.top - BOX.bottom) * (1 - share / 1.02);
  const slot = (width - BOX.left - right) / names.length, bar = (0.8 * slot) / Math.max(1, list.length);
  const known = list.some((entry) => entry.inside_error_bar.some((share) => share !== null));
  const left = (k, one) => BOX.left + slot * (k + 0.1) + bar * one;
  const aim = (share, text) => [rule(BOX.left, y(share), width - right, y(share), { stroke: "var(--ink)", "stroke-dasharray": "7 5" }),
    words(width - right + 6, y(share) + 4, width < 500 ? text.split(" (")[0] : text, { "text-anchor": "start", fill: "var(--ink)" })];
  return frame(width,
    [0, 0.25, 0.5, 0.75, 1].map((one) => [rule(BOX.left, y(one), width - right, y(one)), words(BOX.left - 8, y(one) + 4, percentText(100 * one), { "text-anchor": "end" })]).flat(),
    names.map((name, k) => words(BOX.left + slot * (k + 0.5), HEIGHT - BOX.bottom + 18, [name[0], tag("tspan", { dy: 3, "font-size": 9 }, name.slice(1))])),
    list.map((entry, one) => entry.inside_error_bar.map((share, k) => (share === null ? null
      : tag("rect", { x: left(k, one), y: y(share), width: bar, height: y(0) - y(share), fill: `var(--${(LOOKS[entry.method] || LOOKS.other)[0]})` },
        tag("title", {}, `${entry.method}, ${names[k]}: ${percentText(100 * share)}`))))).flat(),
    words(14, HEIGHT / 2 - 20, "share within the error bar", { transform: `rotate(-90 14 ${HEIGHT / 2 - 20})` }),
    known ? null : words((BOX.left + width - right) / 2, HEIGHT / 2, "not known: too few rows for error bars"),
    aim(0.95, "95 % (nominal)"), aim(0.9, "90 % (accepted)"));
}

function legend(names, plot) {
  const made = document.createElement("ul");
  made.className = "key-of-marks";
  for (const name of names) {
    const [colour, mark] = LOOKS[name] || LOOKS.other, line = document.createElement("li");
    const drawn = plot === "calibration" ? "square" : mark;
    line.append(tag("svg", { viewBox: "-8 -8 16 16", width: 14, height: 14, "aria-hidden": "true" }, tag("path", { d: MARKS[drawn], fill: `var(--${colour})`, stroke: `var(--${colour})`, "stroke-width": 2 })), ` ${name}`);
    made.append(line);
  }
  return made;
}
