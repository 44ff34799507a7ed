// What is drawn of a surface: its outline, its displaced points, the size of both.

const SHARP = Math.cos(Math.PI / 6); // cosine between normals: above it two facets look like one smooth face
const FOLDED = -0.999; // cosine between normals: the simplification of a surface turns small facets of a flat face over

export function normals(vertices, triangles) {
  return triangles.map(([a, b, c]) => {
    const [p, q, r] = [vertices[a], vertices[b], vertices[c]];
    const u = q.map((value, k) => value - p[k]), v = r.map((value, k) => value - p[k]);
    const n = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
    const length = Math.hypot(...n) || 1;
    return n.map((value) => value / length);
  });
}

// The edges at which the surface ends or bends sharply, as pairs of vertices.
export function outline(vertices, triangles) {
  const facing = normals(vertices, triangles), facetsAt = new Map(), count = vertices.length;
  const edgesOf = ([a, b, c]) => [[a, b], [b, c], [c, a]].map((ends) => Math.min(...ends) * count + Math.max(...ends));
  triangles.forEach((corners, number) => {
    for (const edge of edgesOf(corners)) facetsAt.set(edge, [...(facetsAt.get(edge) ?? []), number]);
  });
  const hasArea = (number) => facing[number].some((value) => value);
  const isSharp = (first, second) => {
    const cosine = facing[first].reduce((sum, value, k) => sum + value * facing[second][k], 0);
    return cosine < SHARP && cosine > FOLDED;
  };
  const isDrawn = (facets) => {
    const [first, second] = facets.filter(hasArea);
    if (first === undefined) return false;
    if (second !== undefined) return isSharp(first, second);
    // The simplification of a surface leaves triangles without an area: the facets at their other edges are the neighbours.
    const flat = facets.filter((number) => !hasArea(number));
    const neighbours = flat.flatMap((number) => edgesOf(triangles[number])).flatMap((edge) => facetsAt.get(edge));
    return !flat.length || neighbours.some((number) => number !== first && hasArea(number) && isSharp(first, number));
  };
  return [...facetsAt].filter(([, facets]) => isDrawn(facets)).map(([edge]) => [Math.floor(edge / count), edge % count]);
}

// Lines through pairs of points, with a gap after each, by coordinate.
export function lines(points, edges, scale) {
  const coordinates = { x: [], y: [], z: [] };
  for (const [a, b] of edges) {
    ["x", "y", "z"].forEach((name, k) => coordinates[name].push(points[a][k] * scale, points[b][k] * scale, null));
  }
  return coordinates;
}

export function moved(vertices, displacement, factor) {
  return vertices.map((point, number) => point.map((value, k) => value + factor * displacement[number][k]));
}

export const column = (points, k, scale) => points.map((point) => point[k] * scale);
export const lengths = (vectors) => vectors.map((vector) => Math.hypot(...vector));

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
