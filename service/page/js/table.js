// A table in and out: check a file, mend its bad rows, import, withdraw imports; export in a format and units.

import { el, field, put, save, select } from "./dom.js";
import { get, of, send, trouble } from "./api.js";
import { listenToTable } from "./events.js";
import { importForm } from "./import.js";
import { history } from "./imports.js";
import { stiffnessForm } from "./stiffness.js";

const FORMATS = [["csv", "CSV"], ["xlsx", "Excel (XLSX)"], ["parquet", "Parquet"], ["hdf5", "HDF5"], ["json", "JSON"], ["packed", "Packed table"],
  ["bushing displacement", "Bushing (CSV), no displacement on other axes"], ["bushing load", "Bushing (CSV), no load on other axes"]];
const ENDINGS = { hdf5: "h5", packed: "wbt", bushing: "csv" };
const UNITS = { force: ["N", "kN", "lbf"], moment: ["N*m", "N*mm", "lbf*ft"], translation: ["m", "mm", "um", "inch"], rotation: ["rad", "mrad", "deg"] };
const IN_UNITS = ["csv", "xlsx"]; // programs read the others: always SI

export async function show(root, about, signal) {
  const imports = el("section", { class: "card", id: "imports" }), stiffness = el("section", { class: "card", hidden: !about.measured }, el("h2", {}, "Measured stiffness"), stiffnessForm(about, signal));
  put(root, el("div", { class: "stack" },
    el("section", { class: "card" }, el("h2", {}, "Import rows"), importForm(about, signal)), imports,
    el("section", { class: "card" }, el("h2", {}, "Export the table"), exportForm(about, signal)), stiffness));
  listenToTable(about.name, about.table_version ?? 0, signal, () => {
    get(of(about.name), signal).then(({ measured }) => { stiffness.hidden = !measured; }).catch(() => {});
    history(imports, about, signal).catch(() => {});
  });
  await history(imports, about, signal);
}

function exportForm(about, signal) {
  const state = el("div", { "aria-live": "polite" });
  const units = Object.entries(UNITS).map(([kind, list]) => [kind, select(list.map((one) => [one, one.replace("*", "·").replace("um", "µm")]), list[0])]);
  const chosen = select(FORMATS, "csv", (value) => { for (const [, one] of units) one.disabled = !IN_UNITS.includes(value); });
  chosen.id = "export-format";
  const take = async (event) => {
    event.preventDefault();
    const [format, others] = chosen.value.split(" "), asked = new URLSearchParams({ format });
    if (others) asked.set("others", others);
    if (IN_UNITS.includes(format)) for (const [kind, one] of units) asked.set(kind, one.value);
    try {
      const reply = await send("GET", `${of(about.name)}/table?${asked}`);
      const named = reply.headers.get("Content-Disposition")?.match(/filename="([^"]+)"/);
      save(await reply.blob(), named ? named[1] : `${about.name}.${ENDINGS[format] || format}`);
      put(state);
    } catch (error) { put(state, trouble(error)); }
  };
  return el("form", { class: "stack", onsubmit: take },
    el("div", { class: "few" }, field("Format", chosen), units.map(([kind, one]) => field(kind[0].toUpperCase() + kind.slice(1), one))), el("div", {}, el("button", {}, "Export")), state);
}
