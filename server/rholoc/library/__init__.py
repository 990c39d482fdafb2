"""A server's stored objects: maps, recordings, queries, cameras and sites."""
