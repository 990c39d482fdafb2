"""Measurements from pictures: corners and features across frames, and the relative poses between them."""
