"""Other processes: starts, watches, limits and ends them, together with those that they started in turn."""
