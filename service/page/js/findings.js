// Probable systematic errors of imports, each with its rows and a button that withdraws them.

import { of, send, trouble } from "./api.js";
import { el, note, notify, put } from "./dom.js";
import { count, pageWords, sentence } from "./format.js";
import { rowLinks } from "./rows.js";

const NAMED = 20; // rows that are named; the button withdraws all

// Withdraws the rows of an import, or restores them; of one finding where its cause is given.
export async function editImport(name, number, { restored = false, finding }, signal) {
  const path = `${of(name)}/imports/${number}${restored ? "/restore" : ""}${finding ? `?finding=${encodeURIComponent(finding)}` : ""}`;
  const { rows } = await (await send(restored ? "POST" : "DELETE", path, { signal })).json();
  const changed = `${count(rows)} ${rows === 1 ? "row is" : "rows are"}`;
  notify(restored ? `${changed} in the table again.` : `${changed} withdrawn; ${rows === 1 ? "it stays" : "they stay"} in the ledger and can be restored.`);
}

// `number` is that of the import, none before it is loaded; `done()` is called after a withdrawal.
export function findingNote(name, one, number, signal, done = () => {}) {
  const state = el("div", { "aria-live": "polite" });
  const withdraw = async (event) => {
    event.target.disabled = true;
    try {
      await editImport(name, number, { finding: one.cause }, signal);
      put(state, "Withdrawn.");
      await done();
    } catch (error) {
      event.target.disabled = false;
      if (!signal.aborted) put(state, trouble(error));
    }
  };
  const some = one.rows?.slice(0, NAMED) || [];
  const rows = some.length ? [number ? ["Table ", rowLinks(name, some, NAMED)] : `Rows of the file: ${some.join(", ")}`, one.count > NAMED ? ` and ${count(one.count - NAMED)} more.` : "."] : null;
  const words = one.message.replaceAll(/--(\w+)-point/g, "the $1 point");
  return note("thin", el("strong", {}, sentence(one.cause)), el("span", {}, `${pageWords(words)}.`), rows ? el("span", {}, rows) : null,
    number ? el("div", {}, el("button", { type: "button", class: "withdraw", onclick: withdraw }, one.count ? `Withdraw ${count(one.count)} ${one.count === 1 ? "row" : "rows"}` : "Withdraw this import")) : null, state);
}
