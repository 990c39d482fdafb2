"""Maps of rooms in one frame: links between them, and the poses that follow."""
