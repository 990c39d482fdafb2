"""Baselines, comparisons and trackers measured on recordings with known truth."""
