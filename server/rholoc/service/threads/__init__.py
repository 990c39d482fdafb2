"""Threads beside the event loop: for computing, and for what waits for a disk, a database or a storage."""
