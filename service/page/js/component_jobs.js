// The jobs of one component.

import { jobList } from "./job_list.js";
import { el, put } from "./dom.js";

export async function show(root, about, signal) {
  const card = el("section", { class: "card" });
  put(root, card);
  await jobList(card, about.name, signal);
}
