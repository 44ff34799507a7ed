// The same question from a shell and from Python, to take along.

import { base, key, of } from "./api.js";
import { el, notify } from "./dom.js";

const list = (values) => `[${values.map((one) => (Number.isFinite(one) ? String(one) : "0")).join(", ")}]`;
const server = () => base.href.replace(/\/$/, "");

export function curlOf(name, wrench, options) {
  const body = `{"force": ${list(wrench.slice(0, 3))}, "moment": ${list(wrench.slice(3))}${extra(options)}}`;
  const quote = options.version === null ? "" : "'"; // a shell takes a ? for a pattern
  const lines = [`curl -X POST ${quote}${server()}/${of(name)}/displacement${versionQuery(options)}${quote}`, "-H 'Content-Type: application/json'"];
  if (key()) lines.push('-H "Authorization: Bearer $WRENCHBOOK_KEY"');
  lines.push(`-d '${body}'`);
  return lines.join(" \\\n  ");
}

export const versionQuery = ({ version }) => (version === null ? "" : `?table_version=${version}`);

function extra({ onThin, method }) {
  return (onThin === "queue" ? "" : `, "on_thin": "${onThin}"`) + (method ? `, "method": "${method}"` : "");
}

export function pythonOf(name, wrench, { onThin, method, version }) {
  const keyed = key() ? ', key=os.environ["WRENCHBOOK_KEY"]' : "";
  const more = (onThin === "queue" ? "" : `, on_thin="${onThin}"`) + (method ? `, method="${method}"` : "") + (version === null ? "" : `, table_version=${version}`);
  return [
    ...(key() ? ["import os", ""] : []),
    "from wrenchbook import Client",
    "",
    `with Client("${server()}"${keyed}) as client:`,
    `    force, moment = ${list(wrench.slice(0, 3))}, ${list(wrench.slice(3))}`,
    `    answer = client.displacement("${name}", force, moment${more})`,
    "    print(answer.translation, answer.rotation, answer.error, answer.coverage)",
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
  return { root, say: (said) => { text.textContent = said; } };
}
