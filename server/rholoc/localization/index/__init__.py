"""The map as localization searches it: landmarks, views, which map and which place; matches."""
