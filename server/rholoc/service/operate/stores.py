"""The stores that the settings name."""

from __future__ import annotations

from rholoc.jobs import Stores
from rholoc.jobs.stores import KEYS
from rholoc.service.access.keys import KeyStore
from rholoc.service.settings import Settings


def stores_of(settings: Settings) -> Stores:
    """Where the service keeps what it holds, not yet opened.

    Raises:
        InvalidInput: an URL is not valid.
    """
    return Stores(
        settings.maps_dir,
        settings.data_dir,
        settings.jobs_database,
        settings.shared_storage,
        settings.storage_cache_bytes,
        settings.map_cache_bytes,
    )


def open_keys(stores: Stores) -> KeyStore:
    """The API keys of the service."""
    return KeyStore(stores.data_dir, stores.documents(KEYS))
