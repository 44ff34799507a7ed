// A small picture of a part: its undeformed surface, shaded, seen from the front, the right and above.

import { get, of } from "./api.js";
import { el } from "./dom.js";
import { colours } from "./plot.js";
import { extent, normals } from "./surface.js";

const SIZE = [320, 150]; // CSS pixels
const surfaces = new Map();
const RIGHT = [0.82, 0.57, 0], UP = [-0.26, 0.37, 0.89], TOWARDS = [0.51, -0.73, 0.46];
const LIGHT = [0.2, -0.5, 0.84];
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];

// The canvas of a part's picture; until it is drawn, its place says what is awaited.
export const pictured = (name, words = "The mesh is being built …") => el("div", { class: "picture" },
  el("canvas", { class: "part", role: "img", "aria-label": `The part ${name}`, hidden: true }), el("span", { class: "muted small" }, words));

// Draws a part on a canvas from its mesh, which needs no rows; the symbol of a table where there is no mesh to draw.
export async function paint(canvas, { name, has_fea: meshed }, signal, frames = []) {
  if (meshed && !surfaces.has(name)) surfaces.set(name, await get(`${of(name)}/surface`, signal).catch(() => null));
  if (!surfaces.get(name)?.triangles.length) {
    surfaces.delete(name);
    canvas.setAttribute("aria-label", meshed ? `${name}: no picture of its mesh` : `${name}: a table without a mesh`);
    shown(canvas, () => symbol(canvas), signal);
    return;
  }
  const { vertices, triangles } = surfaces.get(name);
  const flat = vertices.map((point) => [dot(point, RIGHT), -dot(point, UP), dot(point, TOWARDS)]);
  const facing = normals(vertices, triangles);
  const order = triangles.map((corners, k) => [corners, facing[k], corners.reduce((sum, one) => sum + flat[one][2], 0)])
    .filter(([, normal]) => dot(normal, TOWARDS) > 0).sort((one, other) => one[2] - other[2]);
  const length = 0.2 * extent(vertices);
  const axes = frames.map(({ point, axes: rows }) => [point, ...rows.map((row) => point.map((one, k) => one + length * row[k]))].map((one) => [dot(one, RIGHT), -dot(one, UP)]));
  shown(canvas, () => fill(canvas, flat, order, axes), signal);
}

function shown(canvas, draw, signal) {
  canvas.hidden = false;
  const sized = new ResizeObserver(draw); // at the first layout, and at each other width
  sized.observe(canvas);
  signal.addEventListener("abort", () => sized.disconnect());
  window.addEventListener("theme", draw, { signal });
}

function penOf(canvas) {
  const ratio = (window.devicePixelRatio || 1) * Math.max(1, canvas.clientWidth / SIZE[0]);
  [canvas.width, canvas.height] = SIZE.map((one) => one * ratio);
  const pen = canvas.getContext("2d");
  pen.scale(ratio, ratio);
  return pen;
}

// Four rows and three columns.
function symbol(canvas) {
  const pen = penOf(canvas), [left, top] = [SIZE[0] / 2 - 45, SIZE[1] / 2 - 36];
  pen.strokeStyle = pen.fillStyle = colours().muted;
  pen.lineWidth = 2;
  pen.globalAlpha = 0.55;
  pen.fillRect(left, top, 90, 18);
  for (const row of [0, 1, 2, 3]) for (const column of [0, 1, 2]) pen.strokeRect(left + 30 * column, top + 18 * row, 30, 18);
}

// `axes` are the point and the ends of the axes of each interface.
function fill(canvas, flat, order, axes = []) {
  const all = [...flat, ...axes.flat()];
  const [low, high] = [Math.min, Math.max].map((end) => [0, 1].map((k) => end(...all.map((one) => one[k]))));
  const scale = (axes.length ? 0.8 : 0.88) * Math.min(SIZE[0] / (high[0] - low[0] || 1), SIZE[1] / (high[1] - low[1] || 1));
  const at = (one) => [0, 1].map((k) => SIZE[k] / 2 + scale * (one[k] - (low[k] + high[k]) / 2));
  const pen = penOf(canvas), shade = colours(), [red, green, blue] = shade.accent.match(/[\d.]+/g).map(Number);
  pen.lineJoin = "round"; // mitred strokes of thin triangles would end in spikes
  for (const [corners, normal] of order) {
    const light = 0.45 + 0.55 * Math.max(0, dot(normal, LIGHT));
    pen.fillStyle = pen.strokeStyle = `rgb(${[red, green, blue].map((one) => Math.round(one * light + 60 * light)).join()})`;
    pen.beginPath();
    for (const one of corners) pen.lineTo(...at(flat[one]));
    pen.closePath();
    pen.fill();
    pen.stroke(); // closes the seams between triangles
  }
  pen.font = `600 12px ${getComputedStyle(document.body).fontFamily}`;
  for (const [colour, width] of [[shade.sunken, 4.5], [shade.ink, 1.5]]) { // a halo: in dark colours the part is nearly as light as the ink
    pen.strokeStyle = pen.fillStyle = colour;
    pen.lineWidth = width;
    for (const [from, ...ends] of axes) {
      ends.forEach((end, k) => {
        pen.beginPath();
        pen.lineTo(...at(from));
        pen.lineTo(...at(end));
        pen.stroke();
        const text = ["xyz"[k], at(end)[0] + 3, at(end)[1] - 2];
        pen.lineWidth = 3; // wider, the halo of a letter closes its gaps
        if (colour === shade.ink) pen.fillText(...text);
        else pen.strokeText(...text);
        pen.lineWidth = width;
      });
    }
  }
}
