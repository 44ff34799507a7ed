// The calls, shown by Swagger UI from this server alone.

import "./theme.js";

// Swagger UI has light colours alone.
const system = matchMedia("(prefers-color-scheme: dark)");
const paint = () => document.documentElement.classList.toggle("dark", document.documentElement.style.colorScheme === "dark" || (document.documentElement.style.colorScheme !== "light" && system.matches));
window.addEventListener("theme", paint);
paint();

const rank = (tag) => (tag === "displacement" ? 0 : tag === "umbridge" ? 2 : 1); // the main call first
const key = sessionStorage.getItem("wrenchbook-key");
window.SwaggerUIBundle({
  url: new URL("openapi.json", new URL(".", document.baseURI)).href,
  dom_id: "#calls",
  deepLinking: true,
  docExpansion: "list",
  tagsSorter: (one, other) => rank(one) - rank(other),
  defaultModelsExpandDepth: -1,
  validatorUrl: null, // it would ask another host
  requestInterceptor: (request) => {
    if (key) request.headers.Authorization = `Bearer ${key}`;
    return request;
  },
});
