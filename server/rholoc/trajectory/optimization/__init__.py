"""One least-squares problem over all measurements, and loop closures."""
