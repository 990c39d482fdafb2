"""The files that a map is read from and written to."""
