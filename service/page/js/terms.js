// Terms: the words of this page, each in a sentence.

import { el, put } from "./dom.js";

const TERMS = [
  ["Component", "A part that bends, with its table. Its mesh and materials are a bundle; a component of measured rows has a table only."],
  ["Interface", "The place where the simulation loads the part: a section of the mesh with a reference point and axes. Loads and displacements are given at this point in these axes."],
  ["Wrench", "Three forces, N, and three moments, N·m, that act on the component at the interface point. Its axes are those of the undeformed interface."],
  ["Displacement", "Three translations, m, and a rotation vector, rad, of the interface point under a wrench."],
  ["Row", "One wrench with its displacement, from a solve by finite elements or from a measurement."],
  ["Table", "All rows of a component. A query interpolates between them in microseconds."],
  ["Table version", "A number that grows with each change of a table: rows added, withdrawn or restored. The versions of all tables of a server count on together, so that it is no count of rows."],
  ["Packed table", "A table in one file (.wbt) that answers without a server. It keeps a version of the table."],
  ["Axis x, y, z", "A group of three loads that act on one axis: Fx, My and Mz on x, Fy, Mz and Mx on y, Fz, Mx and My on z. Rows with loads of one axis only are the basis of the methods griddata and additive."],
  ["Error bar", "Half the width of the interval about an answer that holds the true value in 95 % of queries. Its parts are interpolation (more rows lower it), discretisation (a finer mesh lowers it), in a linear analysis linearity, and of measured rows hysteresis and drift; their noise is in the interpolation error."],
  ["Covered", "The interpolation error of the answer is known and within the tolerance."],
  ["Thin", "The interpolation error is larger than the tolerance or not known. The answer is an estimate; a query queues a solve there, and its row can make the wrench covered."],
  ["Outside", "The wrench is beyond the load range, has a load that no row varies, or is beyond the rows for a method that does not extrapolate. Widen [range], or add rows there."],
  ["Tolerance", "The error of an answer that the user accepts. It stands in component.toml; without it, 1 % of the range of each output."],
  ["Method", "How a table answers. Kriging: a regression that gives an error bar everywhere. Griddata: linear interpolation within the Delaunay simplices of each axis. Additive: the sum of the axes' answers. Linear: one compliance for all loads. Without a choice the table takes the one with the least error at rows left out."],
  ["Compliance", "The 6 by 6 matrix of displacements per unit load, m/N and rad/(N·m)."],
  ["Fill", "Solves at the wrenches where the error bar is largest, until the tolerance is met or the budget is spent."],
  ["Demand", "The queries of a component that its table did not cover, counted by their wrenches. A fill for the demand solves there first."],
  ["Scene", "One simulation: its components, the loads that occur, and the outputs that it reads. What a scene does not need is not solved."],
  ["Tare", "The reading of a rig at no load, subtracted from the readings under load."],
];

export function show(root) {
  document.title = "Terms · wrenchbook";
  put(root, el("div", { class: "head" }, el("div", {}, el("h1", {}, "Terms"), el("p", { class: "muted" }, "The words of this page. API lists the calls of the server; the command wrenchbook --help lists the commands."))),
    el("section", { class: "card" }, el("dl", { class: "terms" }, TERMS.map(([name, text]) => [el("dt", {}, name), el("dd", {}, text)]))));
}
