// The load range, as the twelve edges of a box.
export function box(about, columns, shade) {
  const spans = columns.map((k) => [...about.range.force, ...about.range.moment][k]).map(([low, high]) => [Math.min(low, 0), Math.max(high, 0)]);
  const found = { x: [], y: [], z: [] };
  for (let along = 0; along < 3; along += 1) {
    for (let corner = 0; corner < 4; corner += 1) {
      const ends = [0, 1].map((end) => [0, 1, 2].map((k) => {
        const bit = k === along ? end : (corner >> ((k - along + 3) % 3 - 1)) & 1;
        return spans[k][bit];
      }));
      ["x", "y", "z"].forEach((name, k) => found[name].push(ends[0][k], ends[1][k], null));
    }
  }
  return { type: "scatter3d", mode: "lines", ...found, line: { color: shade.muted, width: 1.5 }, hoverinfo: "skip" };
}
