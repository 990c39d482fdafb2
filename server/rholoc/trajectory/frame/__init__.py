"""Align a reconstruction with the map frame: up, waypoints, scale."""
