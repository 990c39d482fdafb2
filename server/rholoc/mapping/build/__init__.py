"""Recording → map."""
