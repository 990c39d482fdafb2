"""ROS 2 node of rholoc: pictures and odometry in, a robot's pose in a map out.

Only :mod:`.node` imports rclpy and message packages. All other modules are plain Python on NumPy and ``rholoc_client``.
"""
