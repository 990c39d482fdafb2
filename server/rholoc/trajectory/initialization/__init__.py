"""Where an adjustment starts: all rotations, then all positions, from no guess."""
