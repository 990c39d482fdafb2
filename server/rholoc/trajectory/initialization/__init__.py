"""Initial values for the adjustment: all rotations, then all positions, without a first guess."""
