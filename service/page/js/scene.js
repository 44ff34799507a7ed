// Scene plan: what one simulation needs of its components, and what that saves.

import { listed, of, post, trouble } from "./api.js";
import { el, facts, field, note, notify, pill, put, working } from "./dom.js";
import { count, counted, number, quantity, seconds, sentence, unitOfOutput } from "./format.js";
import { inputsOf, label, mark, named, outputsOf, spansOf } from "./inputs.js";

export async function show(root, _, signal) {
  document.title = "Scene plan · wrenchbook";
  const { components } = await listed(signal);
  const chosen = new Map();
  const forms = el("div", { class: "stack" }), plan = el("div", { class: "cards", "aria-live": "polite" });
  const make = el("button", { class: "first", disabled: true }, "Plan"), hint = el("span", { class: "muted small" }, "Choose a component above.");
  const toggle = (one) => (event) => {
    if (event.target.checked) chosen.set(one.name, needForm(one)); else chosen.delete(one.name);
    put(forms, [...chosen.values()].map((form) => form.root));
    make.disabled = chosen.size === 0;
    hint.hidden = !make.disabled;
  };
  const ask = async (event) => {
    event.preventDefault();
    make.disabled = true;
    put(plan, working("The plan is computed …"));
    try {
      const body = { components: Object.fromEntries([...chosen].map(([name, form]) => [name, form.read()])) };
      const reply = await post("v1/scenes/plan", body, signal);
      put(plan, Object.entries(reply.components).map(([name, one]) => planned(name, one, components.find((other) => other.name === name), body.components[name])));
    } catch (error) { if (!signal.aborted) put(plan, trouble(error)); }
    make.disabled = chosen.size === 0;
    plan.scrollIntoView({ block: "nearest" });
  };
  put(root,
    el("div", { class: "head" }, el("div", {}, el("h1", {}, "Scene plan"),
      el("p", { class: "muted" }, "Enter the loads that can occur and the outputs that the simulation reads. Other loads and outputs are not solved, stored or computed."))),
    el("form", { class: "stack", onsubmit: ask },
      el("fieldset", { class: "card" }, el("legend", {}, "Components of the scene"),
        el("div", { class: "line" }, components.map((one) => el("label", { class: "check" }, el("input", { type: "checkbox", onchange: toggle(one) }), one.name)))),
      forms, el("div", { class: "line" }, make, hint)),
    plan);
}

function needForm(one) {
  const spans = spansOf(one), known = outputsOf(one);
  const loads = inputsOf(one).map(({ name: load, unit, zero = 0 }, place) => {
    const acts = el("input", { type: "checkbox", checked: true, "aria-label": `${load} acts` });
    const [low, high] = spans[place].map((end, which) => el("input", { type: "number", step: "any", value: String(end), "aria-label": `${load} ${which ? "to" : "from"}` }));
    acts.addEventListener("change", () => { low.disabled = high.disabled = !acts.checked; });
    const ordered = () => high.setCustomValidity(Number(low.value) > Number(high.value) ? `${label(load)}: “from” must not be above “to”.` : "");
    low.addEventListener("input", ordered);
    high.addEventListener("input", ordered);
    const root = el("div", { class: "line load" }, el("label", { class: "check" }, acts, mark(load)), low, el("span", { class: "muted small" }, "to"), high, el("span", { class: "muted small" }, unit));
    return { root, read: () => (acts.checked ? [Number(low.value), Number(high.value)] : [zero, zero]) };
  });
  const outputs = known.map((output) => el("input", { type: "checkbox", checked: true, value: output }));
  const limits = ["translation", "rotation"].map((kind) => el("input", { type: "number", step: "any", min: 0, value: one.tolerance ? String(Number((1e3 * one.tolerance[kind]).toPrecision(12))) : "" }));
  const read = () => {
    const need = { ...named(one, loads.map((load) => load.read())), outputs: outputs.filter((box) => box.checked).map((box) => box.value) };
    if (limits.every((limit) => Number(limit.value) > 0)) need.tolerance = { translation: Number(limits[0].value) / 1e3, rotation: Number(limits[1].value) / 1e3 };
    return need;
  };
  const root = el("section", { class: "card" }, el("h2", {}, one.name),
    el("div", { class: "halves" },
      el("fieldset", {}, el("legend", {}, "Loads that occur"), loads.map((load) => load.root)),
      el("div", { class: "stack" },
        el("fieldset", {}, el("legend", {}, "Outputs that are read"), el("div", { class: "line" }, known.map((output, place) => el("label", { class: "check" }, outputs[place], mark(output))))),
        el("fieldset", {}, el("legend", {}, "Tolerance"), el("div", { class: "three" }, field("Translation, mm", limits[0]), field("Rotation, mrad", limits[1]))))));
  return { root, read };
}

// Queues the first solves of the table that a scene needs, and shows the jobs.
function fillButton(name, { outputs, tolerance, ...range }, budget) {
  const fill = async (event) => {
    event.target.disabled = true;
    try {
      const reply = await post(`${of(name)}/fill`, { range, outputs, tolerance, budget });
      notify(reply.jobs.length ? `${reply.jobs.length} ${reply.jobs.length === 1 ? "solve is" : "solves are"} queued. ${reply.reason || ""}` : reply.reason || "Nothing to solve.");
      if (reply.jobs.length) location.hash = `#/c/${encodeURIComponent(name)}/jobs`;
    } catch (error) { notify(error.message, "wrong"); }
    event.target.disabled = false;
  };
  return el("div", {}, el("button", { type: "button", "aria-label": `Fill ${name} for this scene`, onclick: fill }, "Fill for this scene"));
}

// Whether a scene needs less than the whole table.
function isNarrowed(about, { outputs, ...range }) {
  const spans = spansOf({ range });
  return outputs.length < outputsOf(about).length || spansOf(about).some((ends, place) => ends.some((end, which) => end !== spans[place][which]));
}

function planned(name, one, about, need) {
  const outputs = outputsOf(about), unit = (output) => unitOfOutput(output.split(".").at(-1));
  const bound = one.displacement_bound.map((value, place) => [label(outputs[place]), value === null ? "not known" : quantity(value, unit(outputs[place]))]);
  const saved = one.saves;
  return el("section", { class: "card" },
    el("div", { class: "line ends" }, el("h2", {}, name), pill(one.decision, "")),
    el("p", {}, `${sentence(one.reason.replace(/^the rows do not show the error of this answer/, "the rows do not show the error over these loads").replace("near it", "there"))}.`),
    facts([
      ["Loads", one.loads.map(label).join(", ")],
      ["Axes", Object.entries(one.axes).map(([axis, held]) => `${axis}: ${held.inputs.map(label).join(", ")} (${held.dimensions}-D)`).join("; ")],
      ["Outputs", one.outputs.map(label).join(", ")],
      ["First solves", about.has_fea ? `${count(one.solves.scene)} of ${count(one.solves.whole)} of an empty table${about.rows ? `; the table has ${counted(about.rows, "row")}, and a fill solves only what they leave` : ""}` : ""],
      ["Saves", isNarrowed(about, need) ? [saved.build_s > 0 ? `${saved.build_s < 1 ? quantity(saved.build_s, "s") : seconds(saved.build_s)} of building` : "", saved.memory_bytes > 0 ? saved.memory_bytes < 1e6 ? `${number(saved.memory_bytes / 1e3, 3)} kB` : `${number(saved.memory_bytes / 1e6, 3)} MB` : "", saved.us_per_answer > 0 ? `${number(saved.us_per_answer, 3)} µs an answer` : ""].filter(Boolean).join(", ").replace(/.$/, `$&, compared with the table of the whole load range (version ${one.table_version})`) : "nothing: the scene needs the whole table"],
    ]),
    el("details", {}, el("summary", {}, "Largest displacements"), facts(bound)),
    about.has_fea && one.decision !== "rigid" ? fillButton(name, need, Math.max(1, one.solves.scene)) : null,
    one.decision === "rigid" ? note("covered", "Leave it out: the bound is below the tolerance.") : null);
}
