"""Datasets for research, in the layouts that their authors publish."""
