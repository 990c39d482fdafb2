"""Calibration of the IMU against the cameras."""
