// Numbers with units, as people read them. All that comes in is SI.

export const LOADS = ["fx", "fy", "fz", "mx", "my", "mz"];
export const OUTPUTS = ["ux", "uy", "uz", "rx", "ry", "rz"];
export const unitOfLoad = (load) => (load.startsWith("f") ? "N" : "N·m");
export const unitOfOutput = (output) => (output.startsWith("u") ? "m" : "rad");

// F_x as people write it, with a real subscript.
export function symbol(name) {
  const made = document.createElement("span");
  const lower = document.createElement("sub");
  lower.textContent = name[1];
  made.append(/[fm]/.test(name[0]) ? name[0].toUpperCase() : name[0], lower);
  return made;
}

export const marked = (name) => `${plain(name)[0]}<sub>${name[1]}</sub>`; // in a plot
export const plain = (name) => (/[fm]/.test(name[0]) ? name[0].toUpperCase() : name[0]) + name[1];

const PREFIXES = [[1, ""], [1e-3, "m"], [1e-6, "µ"], [1e-9, "n"], [1e-12, "p"]];

export function prefixOf(size) {
  return PREFIXES.find(([scale]) => Math.abs(size) >= scale) || (size ? PREFIXES.at(-1) : PREFIXES[0]);
}

const minus = (text) => text.replaceAll("-", "\u2212");

// A number with so many digits as tell something, never in the form 1e-7.
export function number(value, digits = 4) {
  if (value === null || value === undefined || !Number.isFinite(value)) return "–";
  if (value === 0) return "0";
  const size = Math.abs(value);
  return size >= 1e6 || size < 1e-4 ? scientific(value, digits) : minus(String(Number(value.toPrecision(digits))));
}

export function scientific(value, digits) {
  const [mantissa, power] = value.toExponential(digits - 1).split("e");
  return minus(`${Number(mantissa)}·10`) + superscript(Number(power));
}

const POWERS = { "-": "⁻", 0: "⁰", 1: "¹", 2: "²", 3: "³", 4: "⁴", 5: "⁵", 6: "⁶", 7: "⁷", 8: "⁸", 9: "⁹" };
export const superscript = (power) => [...String(power)].map((one) => POWERS[one]).join("");

// The title of a component, if it says more than its name.
export const titleOf = ({ name, title }) => (title === name ? "" : title.replaceAll(/(?<=\d)x(?=\d)/g, " × "));

// Loads as the fields have them: Fz in place of fz.
const named = (text) => text.replaceAll(/(?:\b(\w+)\.)?\b([fm][xyz])\b/g, (_, at, name) => (at ? `${at} ` : "") + plain(name));

// A text of the server as a sentence: a capital letter, but of a key; µm in place of 1e-06 m and mrad in place of 0.0012 rad, other powers of ten as such.
export const sentence = (text) => (/^\w+\.\w/.test(text) ? text[0] : text[0].toUpperCase()) + named(text.slice(1)).replaceAll("m/s^2", "m/s²").replaceAll(/(?<=\d) ?x ?(?=[1-9])/g, " × ").replaceAll(/(\d)%/g, "$1 %").replaceAll(/(-?[\d.e+]+)\.\.(?=-?\d)/g, "$1 to ").replaceAll(/(?<![\w.])-?\d+\.\d{5,}(?![\w.])/g, (value) => number(Number(value))).replaceAll(/(?<![\w.])-(?=\d)/g, "\u2212").replaceAll(/(\d(?:\.\d+)?e[+-]\d+|\b0\.0\d+) (m|rad|Pa)\b(?!\/)/g, (_, value, unit) => quantity(Number(value), unit)).replaceAll(/(\d)e([+-]\d+)/g, (_, digit, power) => `${digit}·10` + superscript(Number(power)));

// A text of the server without the options of commands.
export const pageWords = (text) => sentence(text.replaceAll(/ \(--[^)]*\)/g, ""));

const placeOf = (value) => (value ? Math.floor(Math.log10(Math.abs(value))) : 0);
const MOST_DIGITS = 7;

// A value rounded to the last digit of its bar, which has two digits; without a bar three digits. No digit is below 10^least, and the bar is rounded up there.
export function rounded(value, bar, least = -Infinity) {
  const known = bar > 0, size = placeOf(value), fits = known ? placeOf(Number(bar.toPrecision(2))) - 1 : size - 2;
  const last = Math.max(fits, size - MOST_DIGITS + 1, least), text = (one) => (Math.round(one / 10 ** last) * 10 ** last).toFixed(Math.max(0, -last));
  return { value: minus(text(value).replace(/^-(0(\.0*)?)$/, "$1")), bar: known && fits === last ? text(bar) : last === least && known ? text(Math.ceil(bar / 10 ** last) * 10 ** last) : number(bar, 2) };
}

// Values of one kind with 0 for the round-off of a solver.
export function withoutRoundOff(values) {
  const least = Math.max(1e-12, 1e-6 * Math.max(...values.map((one) => Math.abs(one ?? 0)))); // m or rad
  return values.map((one) => (one !== null && Math.abs(one) < least ? 0 : one));
}

// The largest size of some values, for the unit of them all.
export const largestOf = (values) => values.reduce((most, one) => Math.max(most, Math.abs(one ?? 0)), 0);

const BELOW = 4; // digits below the first one of a column's largest number

// A value and its bar in one unit: that of the largest of a column, `size`, else of the larger of both.
export function withBar(value, bar, unit, size = 0) {
  const [scale, prefix] = prefixOf(size || largestOf([value, bar])), unknown = bar === null || bar === undefined;
  if (value === null || value === undefined) return { value: "–", bar: "–" };
  if (value === 0 && !bar) return { value: `0 ${prefix}${unit}`, bar: bar === 0 ? "± 0" : "–" };
  const shown = rounded(value / scale, unknown ? 0 : bar / scale, size ? placeOf(size / scale) - BELOW : -Infinity);
  return { value: `${shown.value} ${prefix}${unit}`, bar: unknown ? "–" : `± ${shown.bar} ${prefix}${unit}` };
}

export function quantity(value, unit, digits = 3) {
  if (value === null || value === undefined || !Number.isFinite(value)) return "–";
  const [scale, prefix] = prefixOf(value);
  return `${number(value / scale, digits)}\u00a0${prefix}${unit}`; // no line breaks before a unit
}

// Texts of numbers as a column: right-aligned ones have their points below each other.
export function aligned(texts) {
  const parts = texts.map((text) => text.match(/^((?:± )?\u2212?\d+)(\.\d+)?( .*)?$/)), after = parts.map((part) => part?.[2]?.length ?? 0), most = Math.max(...after);
  const space = (n, has) => (has || !n ? "" : "\u2008") + "\u2007".repeat(Math.max(0, has ? n : n - 1)); // as wide as a point, and as digits
  return texts.map((text, k) => (parts[k] ? `${parts[k][1]}${parts[k][2] ?? ""}${space(most - after[k], after[k])}${parts[k][3] ?? ""}` : text));
}

// Three values with one prefix: (1.2, 0, −3.4) µm; the prefix is that of a `size`, else of the largest.
export function triple(values, unit, size = largestOf(values)) {
  const sizes = withoutRoundOff(values), [scale, prefix] = prefixOf(size), least = NEGLIGIBLE * largestOf(values);
  return `(${sizes.map((one) => (one === null ? "–" : one && Math.abs(one) < least ? "≈\u00a00" : number(one / scale))).join(",\u00a0")})\u00a0${prefix}${unit}`;
}

const NEGLIGIBLE = 1e-4; // of the largest of three values: number() would need a power of ten

export function stress(value, digits = value >= 1e6 ? 4 : 3) {
  if (value === null || value === undefined) return "–";
  return value >= 1e6 ? `${number(value / 1e6, digits)} MPa` : `${number(value / 1e3, digits)} kPa`;
}

export function percent(fraction, digits = 2) {
  return `${number(100 * fraction, digits)} %`;
}

export function seconds(value) {
  if (value === null || value === undefined) return "–";
  if (value < 120) return `${value.toFixed(value < 10 ? 2 : 1)} s`;
  return `${number(value / 60, 3)} min`;
}

// `more` are further options of the format, such as seconds.
export function time(text, more = {}) {
  if (!text) return "–";
  return new Date(text).toLocaleString("en-GB", { day: "numeric", month: "short", year: "numeric", hour: "2-digit", minute: "2-digit", timeZoneName: "short", ...more }); // 24 hours
}

const ACTORS = { "(anonymous)": "anonymous", "(local)": "a command", "(server)": "the server" };
export const actorOf = (name) => ACTORS[name] || name || "";

export function wrench(force, moment, digits = 3, written = (value) => number(value, digits)) {
  const said = (values, first) => values.map((one, place) => written(one, first + place)).join(",\u00a0"); // a line breaks between force and moment
  return `F\u00a0(${said(force, 0)})\u00a0N, M\u00a0(${said(moment, 3)})\u00a0N·m`;
}

export const count = (value) => value.toLocaleString("en");
export const counted = (value, noun) => `${count(value)} ${noun}${value === 1 ? "" : "s"}`;
