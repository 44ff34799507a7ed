// Which version of a table is asked or exported; the imports' versions are offered.

import { get, of } from "./api.js";
import { el, field, id } from "./dom.js";
import { time } from "./format.js";

export function versionField(about, signal, changed) {
  const list = el("datalist", { id: id("versions") });
  const input = el("input", {
    type: "number", min: 0, step: 1, placeholder: "the newest", list: list.id, name: "table_version", oninput: () => changed?.(),
    title: "An earlier version of the table gives its answers again, without the rows that came later",
  });
  get(`${of(about.name)}/imports`, signal).then(({ imports }) => {
    list.replaceChildren(...imports.filter((one) => one.table_version !== null).slice(0, 50)
      .map((one) => el("option", { value: one.table_version, label: `${one.filename || one.format}, ${time(one.when)}` })));
  }, () => {}); // only a help to type
  return { root: el("div", {}, field("Table version", input), list), read: () => (input.value === "" ? null : input.value) };
}
