// The API's description, shown by Swagger UI, which the server has from a package of its own.

import { rholoc } from "./api.js";

/** @type {any} */ (window).SwaggerUIBundle({
  url: new URL("../../openapi.json", import.meta.url).href,
  dom_id: "#docs",
  deepLinking: true,
  requestInterceptor: (request) => Object.assign(request, { headers: { ...request.headers, ...rholoc.authorization } }),
});
