"""Starts a set as a node of the graph, in place of slam_toolbox: ros2 launch flockslam flockslam.launch.py slam_params_file:=parameters.yaml"""
from pathlib import Path

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess
from launch.substitutions import LaunchConfiguration

# In the package the files lie in share/flockslam/config; in the sources beside this one.
HERE = Path(__file__).resolve().parent
INSTALLED = HERE.parent / "config"
CONFIG = INSTALLED if INSTALLED.is_dir() else HERE

GIVEN = {
    "set": (str(CONFIG / "robot.toml"), "description of the process set"),
    "slam_params_file": (str(CONFIG / "parameters.yaml"), "parameters of the node; a file for slam_toolbox works, too"),
    "namespace": ("/", "namespace of the node"),
    "use_sim_time": ("false", "time comes from /clock"),
    "autostart": ("true", "with use_lifecycle_manager false: the node is active at once"),
    "use_lifecycle_manager": ("false", "the node waits for nav2's lifecycle manager"),
}


def generate_launch_description():
    argument = LaunchConfiguration
    parameters = []
    for name in ("use_sim_time", "autostart", "use_lifecycle_manager"):
        parameters += ["-p", [name + ":=", argument(name)]]
    up = ExecuteProcess(
        cmd=["flockslam", "up", argument("set"), "--ros-args", "--params-file", argument("slam_params_file")]
        + ["-r", ["__ns:=", argument("namespace")]]
        + parameters,
        output="screen",
        sigterm_timeout="10",
    )
    declared = [DeclareLaunchArgument(name, default_value=value, description=text) for name, (value, text) in GIVEN.items()]
    return LaunchDescription(declared + [up])
