"""Plots of comparisons, tracks and optical flow."""
