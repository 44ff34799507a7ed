// What is drawn of a surface: its outline, its displaced points, the size of both.

const SHARP = Math.cos(Math.PI / 6); // facets that meet at less are one smooth face to the eye

const FOLDED = -0.999; // the simplification of a surface turns small facets of a flat face over

export function normals(vertices, triangles) {
  return triangles.map(([a, b, c]) => {
    const [p, q, r] = [vertices[a], vertices[b], vertices[c]];
    const u = q.map((one, k) => one - p[k]), v = r.map((one, k) => one - p[k]);
    const n = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
    const length = Math.hypot(...n) || 1;
    return n.map((one) => one / length);
  });
}

// The edges at which the surface ends or bends sharply, as pairs of vertices.
export function outline(vertices, triangles) {
  const facing = normals(vertices, triangles), seen = new Map(), count = vertices.length;
  triangles.forEach((corners, number) => {
    for (let k = 0; k < 3; k += 1) {
      const [a, b] = [corners[k], corners[(k + 1) % 3]].sort((one, other) => one - other);
      const edge = a * count + b, found = seen.get(edge);
      if (found) found.push(number); else seen.set(edge, [number]);
    }
  });
  const hasArea = (number) => facing[number].some((one) => one), edgesOf = ([a, b, c]) => [[a, b], [b, c], [c, a]].map(([one, other]) => Math.min(one, other) * count + Math.max(one, other));
  const isSharp = (one, other) => {
    const dot = facing[one].reduce((sum, value, k) => sum + value * facing[other][k], 0);
    return dot < SHARP && dot > FOLDED;
  };
  const edges = [];
  for (const [edge, numbers] of seen) {
    // The simplification of a surface leaves triangles without an area: a facet meets the facets at their other edges.
    const [one, other] = numbers.filter(hasArea), flat = numbers.filter((number) => !hasArea(number));
    const beyond = () => flat.flatMap((number) => edgesOf(triangles[number]).flatMap((key) => seen.get(key))).filter((number) => number !== one && hasArea(number));
    const sharp = one === undefined ? false : other !== undefined ? isSharp(one, other) : !flat.length || beyond().some((number) => isSharp(one, number));
    if (sharp) edges.push([Math.floor(edge / count), edge % count]);
  }
  return edges;
}

// Lines through pairs of points, with a gap after each, by coordinate.
export function lines(points, edges, scale) {
  const found = { x: [], y: [], z: [] };
  for (const [a, b] of edges) {
    ["x", "y", "z"].forEach((name, k) => found[name].push(points[a][k] * scale, points[b][k] * scale, null));
  }
  return found;
}

export function moved(vertices, displacement, factor) {
  return vertices.map((point, place) => point.map((one, k) => one + factor * displacement[place][k]));
}

export const column = (points, k, scale) => points.map((point) => point[k] * scale);
export const lengths = (vectors) => vectors.map((one) => Math.hypot(...one));

export function spansOf(vertices) {
  return [0, 1, 2].map((k) => {
    let low = Infinity, high = -Infinity;
    for (const point of vertices) { low = Math.min(low, point[k]); high = Math.max(high, point[k]); }
    return high - low;
  });
}

const FLAT = 0.01; // of the longest axis: the least length of an axis

// The lengths of the axes of a drawing, true to scale but for a flat part.
export function boxOf(points) {
  const spans = spansOf(points), longest = Math.max(...spans);
  const [x, y, z] = spans.map((one) => Math.max(one / longest, FLAT));
  return { x, y, z };
}

export const extent = (vertices) => Math.hypot(...spansOf(vertices));
