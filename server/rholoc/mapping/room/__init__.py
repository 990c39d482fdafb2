"""Surfaces of a room, for display: depth of its views, fused into a mesh. Localization does not use them."""
