"""Threads beside the event loop, for computing and for blocking calls."""
