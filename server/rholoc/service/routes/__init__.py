"""The routes: one module per resource."""

from rholoc.service.routes import cameras, health, jobs, localize, maps, recordings, uploads

ROUTERS = (localize.router, maps.router, cameras.router, recordings.router, uploads.router, jobs.router, health.router)

__all__ = ["ROUTERS"]
