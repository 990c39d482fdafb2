"""HTTP itself: bodies, connections, errors' bodies, middlewares, the OpenAPI document, the page's files."""
