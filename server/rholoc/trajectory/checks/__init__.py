"""What speaks against frame poses: waypoints, gaps, a second reconstruction."""
