"""The routes: one module per resource."""

from rholoc.service.routes import health, jobs, localize, maps, recordings

ROUTERS = (localize.router, maps.router, recordings.router, jobs.router, health.router)

__all__ = ["ROUTERS"]
