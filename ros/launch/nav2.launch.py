"""Nav2 with AMCL replaced by rholoc, which broadcasts map→odom.

ros2 launch rholoc_ros nav2.launch.py map_name:=office map:=office.yaml nav2_params_file:=nav2_params.yaml
"""

from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import LifecycleNode, Node
from launch_ros.substitutions import FindPackageShare

from launch import LaunchDescription


def generate_launch_description():
    argument = LaunchConfiguration
    sim_time = {"use_sim_time": argument("use_sim_time")}
    rholoc = LifecycleNode(
        package="rholoc_ros",
        executable="localization",
        name="rholoc",
        namespace="",
        output="screen",
        parameters=[
            argument("params_file"),
            {"url": argument("url"), "map_name": argument("map_name"), "base_frame": argument("base_frame")},
            sim_time,
        ],
        remappings=[("image", argument("image")), ("camera_info", argument("camera_info"))],
    )
    map_server = LifecycleNode(
        package="nav2_map_server",
        executable="map_server",
        name="map_server",
        namespace="",
        output="screen",
        parameters=[argument("params_file"), {"yaml_filename": argument("map")}, sim_time],
    )
    manager = Node(
        package="nav2_lifecycle_manager",
        executable="lifecycle_manager",
        name="lifecycle_manager_localization",
        output="screen",
        # Nodes in Python have no bond with the manager.
        parameters=[{"autostart": True, "bond_timeout": 0.0, "node_names": ["map_server", "rholoc"]}, sim_time],
    )
    navigation = IncludeLaunchDescription(
        PythonLaunchDescriptionSource(
            PathJoinSubstitution([FindPackageShare("nav2_bringup"), "launch", "navigation_launch.py"])
        ),
        launch_arguments={
            "params_file": argument("nav2_params_file"),
            "use_sim_time": argument("use_sim_time"),
            "autostart": "true",
        }.items(),
    )
    config = PathJoinSubstitution([FindPackageShare("rholoc_ros"), "config", "nav2.yaml"])
    nav2_params = PathJoinSubstitution([FindPackageShare("nav2_bringup"), "params", "nav2_params.yaml"])
    return LaunchDescription(
        [
            DeclareLaunchArgument("map_name", description="rholoc's map"),
            DeclareLaunchArgument("map", description="yaml of the floor plan, as write_floor_plan writes it"),
            DeclareLaunchArgument("url", default_value="http://127.0.0.1:8080", description="the service"),
            DeclareLaunchArgument("image", default_value="image", description="topic of the pictures"),
            DeclareLaunchArgument("camera_info", default_value="camera_info", description="topic of the intrinsics"),
            DeclareLaunchArgument("base_frame", default_value="base_link", description="frame of the robot"),
            DeclareLaunchArgument(
                "use_sim_time", default_value="false", description="whether a simulator's clock is used"
            ),
            DeclareLaunchArgument(
                "params_file", default_value=config, description="rholoc's and map_server's parameters"
            ),
            DeclareLaunchArgument("nav2_params_file", default_value=nav2_params, description="Nav2's parameters"),
            rholoc,
            map_server,
            manager,
            navigation,
        ]
    )
