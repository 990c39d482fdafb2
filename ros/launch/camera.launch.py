"""A camera alone: poses on visual_localization/pose. The node configures and activates itself.

ros2 launch rholoc_ros camera.launch.py map_name:=testsite camera_frame:=camera_optical_frame
"""

from launch.actions import DeclareLaunchArgument, EmitEvent, RegisterEventHandler
from launch.conditions import IfCondition
from launch.events import matches_action
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution, PythonExpression
from launch_ros.actions import LifecycleNode, Node
from launch_ros.event_handlers import OnStateTransition
from launch_ros.events.lifecycle import ChangeState
from launch_ros.substitutions import FindPackageShare
from lifecycle_msgs.msg import Transition

from launch import LaunchDescription


def generate_launch_description():
    argument = LaunchConfiguration
    node = LifecycleNode(
        package="rholoc_ros",
        executable="localization",
        name="rholoc",
        namespace="",
        output="screen",
        parameters=[
            argument("params_file"),
            {"url": argument("url"), "map_name": argument("map_name"), "use_sim_time": argument("use_sim_time")},
        ],
        remappings=[("image", argument("image")), ("camera_info", argument("camera_info"))],
    )
    mounting = Node(  # REP 103: from the base (x forward, z up) to the optical frame (z forward, y down)
        package="tf2_ros",
        executable="static_transform_publisher",
        arguments=[
            *("--roll", "-1.5707963", "--yaw", "-1.5707963", "--frame-id", "base_link"),
            *("--child-frame-id", argument("camera_frame")),
        ],
        condition=IfCondition(PythonExpression(["'", argument("camera_frame"), "' != ''"])),
    )

    def change(transition):
        return EmitEvent(event=ChangeState(lifecycle_node_matcher=matches_action(node), transition_id=transition))

    activate = RegisterEventHandler(
        OnStateTransition(
            target_lifecycle_node=node,
            start_state="configuring",
            goal_state="inactive",
            entities=[change(Transition.TRANSITION_ACTIVATE)],
        )
    )
    config = PathJoinSubstitution([FindPackageShare("rholoc_ros"), "config", "camera.yaml"])
    return LaunchDescription(
        [
            DeclareLaunchArgument("map_name", description="the map to localize in"),
            DeclareLaunchArgument("url", default_value="http://127.0.0.1:8080", description="the service"),
            DeclareLaunchArgument("image", default_value="image", description="topic of the pictures"),
            DeclareLaunchArgument("camera_info", default_value="camera_info", description="topic of the intrinsics"),
            DeclareLaunchArgument("camera_frame", default_value="", description="optical frame to mount at base_link"),
            DeclareLaunchArgument("use_sim_time", default_value="false", description="whether a bag's clock is used"),
            DeclareLaunchArgument("params_file", default_value=config, description="the node's parameters"),
            mounting,
            node,
            activate,
            change(Transition.TRANSITION_CONFIGURE),
        ]
    )
