// The latest queries of this tab, to be shown among the rows.

const KEPT = 40;
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
