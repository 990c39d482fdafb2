"""HTTP: bodies, connections, middlewares, the OpenAPI document, the page's files."""
