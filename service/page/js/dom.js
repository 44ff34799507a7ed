// Elements, made in one call: el("a", {href: "#/"}, "Library").

export function el(tag, attributes = {}, ...children) {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (value === null || value === undefined || value === false) continue;
    if (name.startsWith("on")) made.addEventListener(name.slice(2), value);
    else if (name === "value" || name === "checked" || name === "disabled") made[name] = value;
    else made.setAttribute(name, value === true ? "" : value);
  }
  made.append(...children.flat(Infinity).filter((one) => one !== null && one !== undefined && one !== false));
  return made;
}

export function put(place, ...children) {
  place.replaceChildren(...children.flat(Infinity).filter((one) => one !== null && one !== undefined && one !== false));
  return place;
}

export function pill(text, kind = text) {
  return el("span", { class: `pill ${kind}` }, text);
}

// A call whose end is not known: its name, and the seconds since it began, which no screen reader speaks.
export function working(text) {
  const began = Date.now(), took = el("span", { class: "muted small", "aria-hidden": "true" });
  const root = el("div", { class: "stack tight" }, el("div", { class: "working", role: "status" }, el("span", {}, text), el("progress", { "aria-label": text })), took);
  const timer = setInterval(() => {
    if (root.isConnected) put(took, `for ${Math.round((Date.now() - began) / 1000)} s`);
    else clearInterval(timer);
  }, 1000);
  return root;
}

// A place on which a file can be dropped; `take(file)` gets it.
export function dropPlace(take, ...children) {
  const root = el("div", { class: "drop" }, children);
  const over = (event) => { event.preventDefault(); root.classList.add("over"); };
  root.addEventListener("dragenter", over);
  root.addEventListener("dragover", over);
  root.addEventListener("dragleave", () => root.classList.remove("over"));
  root.addEventListener("drop", (event) => { event.preventDefault(); root.classList.remove("over"); take(event.dataTransfer.files[0]); });
  return root;
}

export function note(kind, ...children) {
  return el("div", { class: `note ${kind}` }, ...children);
}

export function facts(pairs) {
  const shown = pairs.filter(([, value]) => value !== null && value !== undefined && value !== "");
  return el("dl", { class: "facts" }, shown.map(([name, value]) => [el("dt", {}, name), el("dd", {}, value)]));
}

// A table from texts or elements; columns that start with "#" hold numbers. Of class "folds named" it becomes cards on a telephone, each cell after its heading.
export function table(head, lines, attributes = {}) {
  const numeric = head.map((one) => one.startsWith("#"));
  const heads = head.map((one) => one.replace("#", "").replace(/^[a-z](?=[a-z]{2}|o$|f )/, (first) => first.toUpperCase()));
  const cell = (tag) => (content, place) =>
    el(tag, { class: numeric[place] ? "number" : null, scope: tag === "th" ? "col" : null, "data-head": tag === "td" ? heads[place] || null : null }, content);
  return el("div", { class: "wide", tabindex: attributes.scrolls ? "0" : null },
    el("table", { class: attributes.class },
      attributes.caption ? el("caption", {}, attributes.caption) : null,
      el("thead", {}, el("tr", {}, heads.map(cell("th")))),
      el("tbody", {}, lines.map((line) => el("tr", {}, line.map(cell("td")))))));
}

// One of few: radio buttons as one bar. `options` are [value, text].
export function choice(name, label, options, chosen, changed) {
  const radios = options.map(([value, text]) =>
    el("label", {},
      el("input", { type: "radio", name, value, checked: value === chosen, onchange: () => changed(value) }),
      el("span", {}, text)));
  return el("fieldset", {}, el("legend", {}, label), el("div", { class: "choice" }, radios));
}

export function field(label, input) {
  return el("label", {}, label, input);
}

export function select(options, chosen, changed) {
  return el("select", { onchange: (event) => changed?.(event.target.value) },
    options.map(([value, text]) => el("option", { value, selected: value === chosen }, text)));
}

let ids = 0;
export function id(prefix) {
  ids += 1;
  return `${prefix}-${ids}`;
}

export function notify(text, kind = "") {
  const place = document.getElementById("notices");
  const close = el("button", { type: "button", class: "quiet small", "aria-label": "Close", onclick: () => shown.remove() }, "×");
  const shown = el("div", { class: kind }, el("span", {}, text), close);
  place.append(shown);
  while (place.children.length > 4) place.firstChild.remove();
  setTimeout(() => shown.remove(), 12000);
}

export function save(blob, name) {
  const link = el("a", { href: URL.createObjectURL(blob), download: name });
  document.body.append(link);
  link.click();
  link.remove();
  setTimeout(() => URL.revokeObjectURL(link.href), 60000);
}
