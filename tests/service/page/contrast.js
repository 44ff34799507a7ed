// The contrast of every text on the page with what lies behind it, as WCAG counts it.
const canvas = new OffscreenCanvas(1, 1).getContext("2d", { willReadFrequently: true });
const rgba = (colour) => {
  canvas.clearRect(0, 0, 1, 1);
  canvas.fillStyle = colour;
  canvas.fillRect(0, 0, 1, 1);
  return [...canvas.getImageData(0, 0, 1, 1).data];
};
const light = (colour) => {
  const [r, g, b] = colour.map((one) => one / 255).map((one) => (one <= 0.04045 ? one / 12.92 : ((one + 0.055) / 1.055) ** 2.4));
  return 0.2126 * r + 0.7152 * g + 0.0722 * b;
};
const behind = (element) => {
  for (let at = element; at; at = at.parentElement) {
    const found = rgba(getComputedStyle(at).backgroundColor);
    if (found[3] === 255) return found;
  }
  return rgba(getComputedStyle(document.documentElement).backgroundColor);
};
const found = [];
const tell = (text, colour, element) => {
  const dim = [...(function* () { for (let at = element; at; at = at.parentElement) yield at; })()].reduce((all, at) => all * getComputedStyle(at).opacity, 1);
  const ground = behind(element), seen = rgba(colour).map((one, k) => dim * one + (1 - dim) * ground[k]);
  const [over, under] = [light(seen), light(ground)];
  found.push({ text: text.trim().slice(0, 30), ratio: Math.round(100 * (Math.max(over, under) + 0.05) / (Math.min(over, under) + 0.05)) / 100 });
};
for (const element of document.querySelectorAll("body *")) {
  const own = [...element.childNodes].filter((one) => one.nodeType === 3 && one.textContent.trim());
  if (!element.checkVisibility() || element.closest(".skip, .unseen, noscript, option, :disabled")) continue;
  if (element.placeholder && !element.value) tell(element.placeholder, getComputedStyle(element, "::placeholder").color, element);
  if (own.length) tell(own[0].textContent, getComputedStyle(element)[element.closest("svg") ? "fill" : "color"], element);
}
return found;
