// Turning a drawing in space by buttons and arrow keys; the mouse does it as plotly has it.

import { el } from "./dom.js";

export const CUBE = { x: 1, y: 1, z: 1 };
const STEP = Math.PI / 12;
const FARTHEST = 15; // of the axes' box: the longest part begins at 10 on a telephone
// The direction in which a drawing is first looked at.
export const START = { eye: { x: 1.45, y: -1.6, z: 1 }, up: { x: 0, y: 0, z: 1 }, center: { x: 0, y: 0, z: -0.16 } };
const VIEWS = { ArrowLeft: [-STEP, 0, 1], ArrowRight: [STEP, 0, 1], ArrowUp: [0, STEP, 1], ArrowDown: [0, -STEP, 1], "+": [0, 0, 1 / 1.2], "-": [0, 0, 1.2] };
const BUTTONS = [["ArrowLeft", "←", "Turn left"], ["ArrowRight", "→", "Turn right"], ["ArrowUp", "↑", "Turn up"], ["ArrowDown", "↓", "Turn down"], ["+", "+", "Nearer"], ["-", "\u2212", "Farther"]];

function turned({ eye }, [around, up, away]) {
  const distance = Math.hypot(eye.x, eye.y, eye.z);
  const azimuth = Math.atan2(eye.y, eye.x) + around;
  const height = Math.asin(eye.z / distance) + up;
  const tilt = Math.max(-1.45, Math.min(1.45, height));
  const far = Math.max(0.4, Math.min(FARTHEST, distance * away));
  return { x: far * Math.cos(tilt) * Math.cos(azimuth), y: far * Math.cos(tilt) * Math.sin(azimuth), z: far * Math.sin(tilt) };
}

const ROUND_OFF = 1e-6; // of a camera that Plotly returns
const HALF = Math.tan(Math.PI / 8); // of the height that is seen, at distance 1
const NAMES = [60, 36]; // px beside, and above and below the box, for the names and ticks of its axes
const minus = (a, b) => a.map((one, k) => one - b[k]), dot = (a, b) => a.reduce((sum, one, k) => sum + one * b[k], 0), size = (a) => Math.hypot(...a);
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];

// How much farther than START the box of the axes is looked at from so that it fills its part of a place. `fit` of a place:
// `box`, the lengths of the axes; `domain`, the part of the place for the scene; `names`, px beside, and above and below the box.
function fitted({ fit: { box, domain = { x: [0, 1], y: [0, 1] }, names = NAMES }, clientWidth, clientHeight }) {
  const [from, centre] = [START.eye, START.center].map((one) => [one.x, one.y, one.z]);
  const tall = clientHeight * (domain.y[1] - domain.y[0]), wide = clientWidth * (domain.x[1] - domain.x[0]);
  const [width, height] = [wide - 2 * names[0], tall - 2 * names[1]].map((one) => (HALF * one) / tall);
  const corners = [-0.5, 0.5].flatMap((x) => [-0.5, 0.5].flatMap((y) => [-0.5, 0.5].map((z) => [x * box.x, y * box.y, z * box.z])));
  const fits = (away) => {
    const eye = from.map((one) => one * away), ahead = minus(centre, eye), right = cross(ahead, [0, 0, 1]), up = cross(right, ahead);
    return corners.every((corner) => {
      const seen = minus(corner, eye), deep = dot(seen, ahead) / size(ahead);
      return Math.abs(dot(seen, up)) / size(up) <= height * deep && Math.abs(dot(seen, right)) / size(right) <= width * deep;
    });
  };
  let away = 0.1;
  while (!fits(away) && away < FARTHEST) away *= 1.005;
  return away;
}

// A figure around the place of a drawing, which has a `fit` once it is drawn. `camera()` is where it is looked at from.
export function figure(place, label, ...below) {
  let drawing = null;
  let begun = START; // the last camera that the user did not choose
  const start = () => (begun = { ...START, eye: turned(START, [0, 0, fitted(place)]) });
  const isChosen = ({ eye }) => Math.hypot(...["x", "y", "z"].map((name) => eye[name] - begun.eye[name])) > ROUND_OFF;
  const now = () => drawing?.place._fullLayout?.scene?._scene?.getCamera?.();
  const camera = () => (now() && isChosen(now()) ? now() : start());
  const look = (camera_) => drawing?.plotly.relayout(drawing.place, { "scene.camera": camera_ });
  const turn = (how) => { if (drawing) look({ ...START, ...now(), eye: turned(now() ?? start(), how) }); };
  const buttons = BUTTONS.map(([name, sign, text]) =>
    el("button", { type: "button", class: "small", title: text, "aria-label": text, onclick: () => turn(VIEWS[name]) }, sign));
  buttons.push(el("button", { type: "button", class: "small", onclick: () => look(start()) }, "Reset"));
  const keys = (event) => {
    if (event.target !== root || !VIEWS[event.key]) return;
    event.preventDefault();
    turn(VIEWS[event.key]);
  };
  const root = el("div", { class: "figure", tabindex: "0", role: "group", "aria-label": `${label}. Arrow keys turn it, plus and minus zoom.`, onkeydown: keys },
    place, el("div", { class: "turn" }, buttons), ...below);
  return { root, hold: (made) => { drawing = made; }, camera };
}
