"""The routes: one module per resource."""

from rholoc.service.routes import cameras, health, jobs, localize, maps, recordings, track, uploads

_RESOURCES = (localize, track, maps, cameras, recordings, uploads, jobs, health)
ROUTERS = tuple(resource.router for resource in _RESOURCES)

__all__ = ["ROUTERS"]
