"""Starts a set as a node of the graph, in place of slam_toolbox: ros2 launch flockslam.launch.py set:=robot.toml params_file:=parameters.yaml"""
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess
from launch.substitutions import LaunchConfiguration


def generate_launch_description():
    given = {"set": "/etc/flockslam/ros2/robot.toml", "params_file": "/etc/flockslam/ros2/parameters.yaml", "namespace": "/", "use_sim_time": "false"}
    argument = LaunchConfiguration
    up = ExecuteProcess(
        cmd=["flockslam", "up", argument("set"), "--ros-args", "--params-file", argument("params_file")]
        + ["-r", ["__ns:=", argument("namespace")], "-p", ["use_sim_time:=", argument("use_sim_time")]],
        output="screen",
        sigterm_timeout="10",
    )
    return LaunchDescription([DeclareLaunchArgument(name, default_value=value) for name, value in given.items()] + [up])
