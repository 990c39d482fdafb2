"""The routes: one module per resource."""

from rholoc.service.routes import (
    audit,
    budgets,
    cameras,
    health,
    here,
    jobs,
    keys,
    learning,
    live,
    recordings,
    sites,
    uploads,
)
from rholoc.service.routes.frames import geopose, localize, track_stream
from rholoc.service.routes.maps import contents, editing, library

_RESOURCES = (
    localize,
    geopose,
    track_stream,
    library,
    contents,
    editing,
    learning,
    sites,
    here,
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
