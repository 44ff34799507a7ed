// The axes of a rig and of the interface, with the points of the readings, as an SVG.

const SVG = "http://www.w3.org/2000/svg";
const AXES = ["x", "y", "z"];
const ARROW = 58, FARTHEST = 92; // px: an axis, the farthest point
const RIG = [92, 128], INTERFACE = [268, 128]; // px: where the two frames are drawn
const IDENTITY = [[1, 0, 0], [0, 1, 0], [0, 0, 1]];

// `rig` has frame (the rig's axes in the interface's frame), load_point and displacement_point, m.
export function rigPicture(rig) {
  const points = pointsOf(rig);
  const scale = FARTHEST / Math.max(1e-12, ...points.map(([, at]) => Math.hypot(...flat(at))), 0.5 * Math.max(0, ...points.map(([, at]) => Math.hypot(...at))));
  return shape("svg", { viewBox: "0 0 400 240", class: "rig-picture", role: "img", "aria-label": words(rig) },
    shape("polygon", { class: "section", points: [[-1, -1], [1, -1], [1, 1], [-1, 1]].map(([x, y]) => place(INTERFACE, [x, y, 0], 24).join(",")).join(" ") }),
    triad(RIG, rig.frame, "rig"), triad(INTERFACE, IDENTITY, "interface"),
    points.map(([kind, at]) => lever(kind, place(INTERFACE, at, scale))),
    caption(RIG, "axes of the rig"), caption(INTERFACE, "interface"));
}

// One sentence for each axis and point.
function words(rig) {
  const axes = rig.frame.map((one, k) => `the rig's ${AXES[k]} axis points along ${direction(one)}`);
  return [...axes, ...pointsOf(rig).map(([name, at]) => `the ${name} point is at ${at.join(", ")} m`)].join("; ");
}

// The points that are not the interface's: [name, [x, y, z]].
export function pointsOf(rig) {
  return [["load", rig.load_point], ["displacement", rig.displacement_point]].filter(([, at]) => at.some(Boolean));
}

function direction(axis) {
  const along = axis.findIndex((one) => Math.abs(Math.abs(one) - 1) < 1e-9);
  return along < 0 ? axis.map((one) => one.toFixed(3)).join(", ") : `${axis[along] < 0 ? "−" : ""}${AXES[along]}`;
}

// x to the right and front, y to the right and back, z up.
function flat([x, y, z]) {
  return [0.82 * x + 0.57 * y, 0.24 * x - 0.35 * y - 0.91 * z];
}

function place([left, top], at, scale) {
  const [x, y] = flat(at);
  return [left + scale * x, top + scale * y].map((one) => Number(one.toFixed(1)));
}

function triad(origin, axes, kind) {
  return axes.map((axis, k) => {
    const [x, y] = place(origin, axis, ARROW), [left, top] = place(origin, axis, ARROW + 13);
    return [
      shape("line", { class: kind, x1: origin[0], y1: origin[1], x2: x, y2: y }), head(origin, [x, y], kind),
      shape("text", { class: kind, x: left, y: top + 4, "text-anchor": "middle" }, AXES[k]),
    ];
  });
}

function head([x0, y0], [x, y], kind) {
  const size = Math.hypot(x - x0, y - y0) || 1, [u, v] = [(x - x0) / size, (y - y0) / size];
  const corners = [[x + 5 * u, y + 5 * v], [x - 4 * u - 4 * v, y - 4 * v + 4 * u], [x - 4 * u + 4 * v, y - 4 * v - 4 * u]];
  return shape("polygon", { class: kind, points: corners.map((one) => one.map((each) => each.toFixed(1)).join(",")).join(" ") });
}

function lever(kind, [x, y]) {
  return [
    shape("line", { class: "lever", x1: INTERFACE[0], y1: INTERFACE[1], x2: x, y2: y }),
    kind === "load" ? shape("circle", { class: "point", cx: x, cy: y, r: 5 }) : shape("rect", { class: "point", x: x - 4.5, y: y - 4.5, width: 9, height: 9 }),
  ];
}

function caption([x], text) {
  return shape("text", { class: "caption", x, y: 230, "text-anchor": "middle" }, text);
}

function shape(tag, attributes, ...children) {
  const made = document.createElementNS(SVG, tag);
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  made.append(...children.flat(3));
  return made;
}
