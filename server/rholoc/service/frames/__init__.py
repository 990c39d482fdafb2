"""A frame → its pose: queries, localizers, the choice of maps, answers."""
