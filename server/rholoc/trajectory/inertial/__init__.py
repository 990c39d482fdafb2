"""What the IMU measures against the cameras."""
