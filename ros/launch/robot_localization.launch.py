"""rholoc's poses in robot_localization: one filter makes odom→base_link, another map→odom.

ros2 launch rholoc_ros robot_localization.launch.py map_name:=office
"""

from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare

from launch import LaunchDescription


def generate_launch_description():
    argument = LaunchConfiguration
    share = FindPackageShare("rholoc_ros")
    config = PathJoinSubstitution([share, "config", "robot_localization.yaml"])
    passed = ("map_name", "url", "image", "camera_info", "use_sim_time", "params_file")
    rholoc = IncludeLaunchDescription(
        PythonLaunchDescriptionSource(PathJoinSubstitution([share, "launch", "camera.launch.py"])),
        launch_arguments={name: argument(name) for name in passed}.items(),
    )

    def ekf(name, remappings):
        return Node(
            package="robot_localization",
            executable="ekf_node",
            name=name,
            output="screen",
            parameters=[argument("params_file"), {"use_sim_time": argument("use_sim_time")}],
            remappings=remappings,
        )

    return LaunchDescription(
        [
            DeclareLaunchArgument("map_name", description="the map to localize in"),
            DeclareLaunchArgument("url", default_value="http://127.0.0.1:8080", description="the service"),
            DeclareLaunchArgument("image", default_value="image", description="topic of the pictures"),
            DeclareLaunchArgument("camera_info", default_value="camera_info", description="topic of the intrinsics"),
            DeclareLaunchArgument("use_sim_time", default_value="false", description="whether a bag's clock is used"),
            DeclareLaunchArgument("params_file", default_value=config, description="all nodes' parameters"),
            ekf("ekf_odom", [("odometry/filtered", "odometry/local")]),
            ekf("ekf_map", [("odometry/filtered", "odometry/global")]),
            rholoc,
        ]
    )
