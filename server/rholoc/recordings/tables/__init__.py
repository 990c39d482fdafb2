"""The tables of a recording: IMU, frame times, poses, waypoints."""
