"""Routes of frames."""
