"""Descriptions, corrections and exports of maps, site documents, and events of mapping jobs."""
