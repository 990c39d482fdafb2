"""The Python client of the rholoc service."""
