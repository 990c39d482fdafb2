"""Recorder and scanner apps of phones, by their exports."""
