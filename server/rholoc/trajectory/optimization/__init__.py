"""One least-squares problem over all measurements, and the places seen again that it closes loops at."""
