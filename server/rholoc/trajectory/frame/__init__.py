"""From a reconstruction's own frame to the map's: up, waypoints, scale."""
