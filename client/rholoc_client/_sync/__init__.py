"""The blocking client: written by ``client/write_sync.py``."""
