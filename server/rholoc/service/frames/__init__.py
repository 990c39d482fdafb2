"""Localization of frames: queries, localizers, choice of maps, answers."""
