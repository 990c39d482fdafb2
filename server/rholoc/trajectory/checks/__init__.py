"""Checks of frame poses: waypoints, gaps, a second reconstruction."""
