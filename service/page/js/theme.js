// The button of the colours, on each page that has the header.

const THEMES = { auto: ["◐ Auto", "light dark"], light: ["○ Light", "light"], dark: ["● Dark", "dark"] };

function setTheme(name) {
  const [text, scheme] = THEMES[name] || THEMES.auto;
  document.documentElement.style.colorScheme = scheme;
  const button = document.getElementById("theme");
  button.textContent = text;
  button.title = `Colours: ${text}. Click for the next scheme.`;
  button.setAttribute("aria-label", `Colours: ${text}`);
  window.dispatchEvent(new Event("theme"));
}

function nextTheme() {
  const names = Object.keys(THEMES);
  const now = localStorage.getItem("wrenchbook-theme") || "auto";
  const next = names[(names.indexOf(now) + 1) % names.length];
  localStorage.setItem("wrenchbook-theme", next);
  setTheme(next);
}

document.getElementById("theme").addEventListener("click", nextTheme);
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => window.dispatchEvent(new Event("theme")));
setTheme(localStorage.getItem("wrenchbook-theme") || "auto");
