"""Places beyond the demo's room: a building, and rooms whose furniture was moved."""
