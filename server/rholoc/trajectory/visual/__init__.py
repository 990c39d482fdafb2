"""What the pictures measure: corners and features from frame to frame, and how the camera turned and went between."""
