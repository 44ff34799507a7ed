// The latest queries of this tab, to be shown among the rows.

const KEPT = 40;
const latest = (name) => `wrenchbook-answer-${name}`;
const place = (name) => `wrenchbook-asked-${name}`;

export function asked(name) {
  try {
    return JSON.parse(sessionStorage.getItem(place(name))) || [];
  } catch {
    return [];
  }
}

export function remember(name, wrench, coverage) {
  const list = [{ wrench, coverage }, ...asked(name)].slice(0, KEPT);
  sessionStorage.setItem(place(name), JSON.stringify(list));
}

// The latest answer of a component, with its query: its view shows it again.
export const keepAnswer = (name, kept) => sessionStorage.setItem(latest(name), JSON.stringify(kept));

export function answerOf(name) {
  try {
    return JSON.parse(sessionStorage.getItem(latest(name)));
  } catch {
    return null;
  }
}
