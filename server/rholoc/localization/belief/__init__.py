"""Pose → belief: whether it is the right place, how exact it is, and why a frame was refused."""
