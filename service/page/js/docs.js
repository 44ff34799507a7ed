// The calls, shown by Swagger UI from this server alone.

const key = sessionStorage.getItem("wrenchbook-key");
window.SwaggerUIBundle({
  url: new URL("openapi.json", new URL(".", document.baseURI)).href,
  dom_id: "#calls",
  deepLinking: true,
  docExpansion: "list",
  defaultModelsExpandDepth: -1,
  validatorUrl: null, // it would ask another host
  requestInterceptor: (request) => {
    if (key) request.headers.Authorization = `Bearer ${key}`;
    return request;
  },
});
