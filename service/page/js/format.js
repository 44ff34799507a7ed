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

// Loads as the fields have them: Fz in place of fz.
const named = (text) => text.replaceAll(/\b[fm][xyz]\b/g, plain);

// A text of the server as a sentence: a capital letter, µm in place of 1e-06 m, other powers of ten as such.
export const sentence = (text) => text[0].toUpperCase() + named(text.slice(1)).replaceAll(/(\d(?:\.\d+)?e[+-]\d+) (m|rad|Pa)\b/g, (_, value, unit) => quantity(Number(value), unit)).replaceAll(/(\d)e([+-]\d+)/g, (_, digit, power) => `${digit}·10` + superscript(Number(power)));

// A text of the server without the options of commands.
export const pageWords = (text) => sentence(text.replaceAll(/ \(--[^)]*\)/g, ""));

// A value and its bar in one unit: of the value as many digits as the bar leaves, three to seven.
export function withBar(value, bar, unit) {
  if (value === null || value === undefined) return { value: "–", bar: "–" };
  if (value === 0 && !bar) return { value: `0 ${unit}`, bar: bar === 0 ? "± 0" : "–" };
  const known = bar !== null && bar !== undefined && bar > 0;
  const hidden = known && Math.abs(value) < bar; // it may as well be zero: one digit of the bar's size
  const [scale, prefix] = prefixOf(hidden ? bar : value);
  const digits = known && !hidden ? Math.min(7, Math.max(3, 2 + Math.floor(Math.log10(Math.abs(value) / bar)))) : 3;
  const size = value === 0 ? 0 : Math.floor(Math.log10(Math.abs(value / scale)));
  const shown = hidden ? (value / scale).toFixed(1) : (value / scale).toFixed(Math.max(0, digits - 1 - size));
  return {
    value: `${minus(shown.replace(/^-(0(\.0*)?)$/, "$1"))} ${prefix}${unit}`,
    bar: bar === null || bar === undefined ? "–" : `± ${number(bar / scale, 2)} ${prefix}${unit}`,
  };
}

export function quantity(value, unit, digits = 3) {
  if (value === null || value === undefined || !Number.isFinite(value)) return "–";
  const [scale, prefix] = prefixOf(value);
  return `${number(value / scale, digits)} ${prefix}${unit}`;
}

// Three values with one prefix: (1.2, 0, −3.4) µm.
export function triple(values, unit) {
  const [scale, prefix] = prefixOf(Math.max(...values.map((one) => Math.abs(one ?? 0)))), least = 1e-6 * scale; // below it is round-off
  return `(${values.map((one) => (one === null ? "–" : Math.abs(one) < least ? "0" : number(one / scale))).join(",\u00a0")})\u00a0${prefix}${unit}`;
}

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

export function time(text) {
  if (!text) return "–";
  return new Date(text).toLocaleString("en-GB", { day: "numeric", month: "short", year: "numeric", hour: "2-digit", minute: "2-digit", timeZoneName: "short" }); // 24 hours
}

const ACTORS = { "(anonymous)": "anonymous", "(local)": "a command", "(server)": "the server" };
export const actorOf = (name) => ACTORS[name] || name || "";

export function wrench(force, moment, digits = 3, written = (value) => number(value, digits)) {
  const said = (values, first) => values.map((one, place) => written(one, first + place)).join(",\u00a0"); // a line breaks between force and moment
  return `F\u00a0(${said(force, 0)})\u00a0N, M\u00a0(${said(moment, 3)})\u00a0N·m`;
}

export const count = (value) => value.toLocaleString("en").replaceAll(",", "\u202f");
