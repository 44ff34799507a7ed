// The page's query as a command of a shell and as Python, to copy.

import { base, key, of } from "./api.js";
import { el, notify } from "./dom.js";
import { named } from "./inputs.js";

const numeral = (value) => (Number.isFinite(value) ? String(value) : "0");
const list = (values) => `[${values.map(numeral).join(", ")}]`;
const server = () => base.href.replace(/\/$/, "");

// JSON, which is Python too.
function literal(value) {
  if (Array.isArray(value)) return list(value);
  return typeof value === "object" ? `{${entries(value)}}` : numeral(value);
}

const entries = (values) => Object.entries(values).map(([name, value]) => `"${name}": ${literal(value)}`).join(", ");

// The inputs of a request; an interface without loads may be left out.
function loaded(about, wrench) {
  const body = named(about, wrench);
  if (!body.loads) return body;
  const acting = Object.entries(body.loads).filter(([, load]) => [...load.force, ...load.moment].some((value) => value !== 0));
  return { ...body, loads: acting.length ? Object.fromEntries(acting) : body.loads };
}

export function curlOf(about, wrench, options) {
  const { name } = about, body = `{${entries(loaded(about, wrench))}${optionsOf(options, (option) => `"${option}": `)}}`;
  const lines = [`curl -X POST ${server()}/${of(name)}/displacement`, "-H 'Content-Type: application/json'"];
  if (key()) lines.push('-H "Authorization: Bearer $WRENCHBOOK_KEY"');
  lines.push(`-d '${body}'`);
  return lines.join(" \\\n  ");
}

// The options of a request that differ from the server's defaults; `label` writes a name for JSON or Python.
const optionsOf = ({ onThin, method }, label) => (onThin === "queue" ? "" : `, ${label("on_thin")}"${onThin}"`) + (method ? `, ${label("method")}"${method}"` : "");

export function pythonOf(about, wrench, options) {
  const { name } = about, { loads, force, moment, inputs } = loaded(about, wrench);
  const keyed = key() ? ', key=os.environ["WRENCHBOOK_KEY"]' : "";
  const args = [loads ? "loads=loads" : "force, moment", ...(inputs ? [`inputs=${literal(inputs)}`] : [])].join(", ");
  return [
    ...(key() ? ["import os", ""] : []),
    "from wrenchbook import Client",
    "",
    `with Client("${server()}"${keyed}) as client:`,
    loads ? `    loads = {\n${Object.entries(loads).map(([at, load]) => `        "${at}": ${literal(load)},`).join("\n")}\n    }` : `    force, moment = ${list(force)}, ${list(moment)}`,
    `    answer = client.displacement("${name}", ${args}${optionsOf(options, (option) => `${option}=`)})`,
    loads ? "    for name, one in answer.interfaces.items():\n        print(name, one.translation, one.rotation, answer.coverage)" : "    print(answer.translation, answer.rotation, answer.error, answer.coverage)",
  ].join("\n");
}

export function snippet(title) {
  const text = el("pre", { tabindex: "0", "aria-label": title });
  const copy = async () => {
    try {
      await navigator.clipboard.writeText(text.textContent);
      notify(`${title}: copied.`);
    } catch {
      getSelection().selectAllChildren(text); // the clipboard is not ours here: ready for Ctrl+C
    }
  };
  const root = el("section", { class: "stack" },
    el("div", { class: "line ends" }, el("h3", {}, title), el("button", { type: "button", class: "small", onclick: copy }, "Copy")), text);
  return { root, say: (content) => { text.textContent = content; } };
}
