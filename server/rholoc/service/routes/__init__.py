"""The routes: one module per resource."""

from rholoc.service.routes import (
    audit,
    budgets,
    cameras,
    health,
    jobs,
    keys,
    learning,
    live,
    localize,
    maps,
    recordings,
    sites,
    track,
    uploads,
)

_RESOURCES = (
    localize,
    track,
    maps,
    learning,
    sites,
    live,
    cameras,
    recordings,
    uploads,
    jobs,
    keys,
    budgets,
    audit,
    health,
)
ROUTERS = tuple(resource.router for resource in _RESOURCES)

__all__ = ["ROUTERS"]
