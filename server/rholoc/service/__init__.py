"""The HTTP service: routes, schemas, errors, settings."""

from rholoc.service.app import create_app
from rholoc.service.settings import Settings

__all__ = ["Settings", "create_app"]
