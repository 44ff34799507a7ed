// Turning a drawing in space by buttons and arrow keys; the mouse does it as plotly has it.

import { el } from "./dom.js";

export const NARROW = 600; // px
const STEP = Math.PI / 12;
const FARTHEST = 15; // of the axes' box: the longest part begins at 10 on a telephone
// Where a drawing is first looked at from; farther away where the screen is narrow.
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

// A figure around the place of a drawing. `camera()` is where it is looked at from.
export function figure(place, label, ...below) {
  let drawing = null;
  const start = () => ({ ...START, eye: turned(START, [0, 0, (place.clientWidth < NARROW ? 1.45 : 1) * (place.dataset.away || 1)]) });
  const camera = () => drawing?.place._fullLayout?.scene?._scene?.getCamera?.() ?? start();
  const look = (camera_) => drawing?.plotly.relayout(drawing.place, { "scene.camera": camera_ });
  const turn = (how) => { if (drawing) look({ ...START, ...camera(), eye: turned(camera(), how) }); };
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
