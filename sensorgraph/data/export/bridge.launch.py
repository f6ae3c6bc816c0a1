"""Start the world in Gazebo and bridge its topics to ROS 2: ros2 launch ./bridge.launch.py

Then `ros2 bag record -s mcap /scan /odom /tf /tf_static /cmd_vel` records a run that `sensorgraph` can read.
"""

from pathlib import Path

from launch import LaunchDescription
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare

MOUNT = {"x": 0.0, "y": 0.0, "z": 0.0, "yaw": 0.0}
"""[m, m, m, rad] Pose of the laser in base_link, as in robot.yaml."""
WORLD = Path(__file__).resolve().parent / "world.sdf"
BRIDGED = [
    "/clock@rosgraph_msgs/msg/Clock[gz.msgs.Clock",
    "/scan@sensor_msgs/msg/LaserScan[gz.msgs.LaserScan",
    "/odom@nav_msgs/msg/Odometry[gz.msgs.Odometry",
    "/tf@tf2_msgs/msg/TFMessage[gz.msgs.Pose_V",
    "/cmd_vel@geometry_msgs/msg/Twist]gz.msgs.Twist",
]


def generate_launch_description() -> LaunchDescription:
    """Return the simulator, the bridge and the transform of the laser."""
    mount = [text for name, value in MOUNT.items() for text in (f"--{name}", str(value))]
    start = PathJoinSubstitution([FindPackageShare("ros_gz_sim"), "launch", "gz_sim.launch.py"])
    return LaunchDescription(
        [
            IncludeLaunchDescription(
                PythonLaunchDescriptionSource(start), launch_arguments={"gz_args": f"-r {WORLD}"}.items()
            ),
            Node(
                package="ros_gz_bridge",
                executable="parameter_bridge",
                arguments=BRIDGED,
                parameters=[{"use_sim_time": True}],
            ),
            Node(
                package="tf2_ros",
                executable="static_transform_publisher",
                arguments=[*mount, "--frame-id", "base_link", "--child-frame-id", "laser"],
                parameters=[{"use_sim_time": True}],
            ),
        ]
    )
