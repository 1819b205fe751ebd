"""Writes a CARMEN log of FLASER lines as a ROS 1 bag: scans, odometry, and where the lidar sits.

carmen_to_bag.py LOG BAG
"""
import math
import sys

import numpy
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

store = get_typestore(Stores.ROS1_NOETIC)
store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage"))
types = store.types
Header, Time = types["std_msgs/msg/Header"], types["builtin_interfaces/msg/Time"]
Point, Vector3 = types["geometry_msgs/msg/Point"], types["geometry_msgs/msg/Vector3"]
Quaternion, Pose = types["geometry_msgs/msg/Quaternion"], types["geometry_msgs/msg/Pose"]
Transform, Stamped = types["geometry_msgs/msg/Transform"], types["geometry_msgs/msg/TransformStamped"]
Scan, Odometry = types["sensor_msgs/msg/LaserScan"], types["nav_msgs/msg/Odometry"]
Twist, WithTwist = types["geometry_msgs/msg/Twist"], types["geometry_msgs/msg/TwistWithCovariance"]
WithPose, TfMessage = types["geometry_msgs/msg/PoseWithCovariance"], types["tf2_msgs/msg/TFMessage"]


def header(stamp_ns, frame):
    return Header(0, Time(stamp_ns // 10**9, stamp_ns % 10**9), frame)


def turned(heading):
    return Quaternion(0.0, 0.0, math.sin(heading / 2), math.cos(heading / 2))


def stamp_of(text):
    whole, _, part = text.partition(".")
    return int(whole) * 10**9 + int((part + "000000000")[:9])


def scans(path):
    for line in open(path):
        fields = line.split()
        if fields[:1] == ["FLASER"]:
            beams = int(fields[1])
            numbers = [float(field) for field in fields[2 : 8 + beams]]
            yield stamp_of(fields[8 + beams]), stamp_of(fields[10 + beams]), numbers[:beams], numbers[beams : beams + 3], numbers[beams + 3 :]


log, bag = sys.argv[1:]
nothing, covariance = Vector3(0.0, 0.0, 0.0), numpy.zeros(36)
with Writer(bag) as writer:
    topics = {
        name: writer.add_connection(name, kind, typestore=store)
        for name, kind in [
            ("/scan", Scan.__msgtype__),
            ("/odom", Odometry.__msgtype__),
            ("/tf_static", TfMessage.__msgtype__),
        ]
    }

    written_ns = 0

    def put(topic, logged_ns, message):
        global written_ns
        # A recorder's clock does not run backwards, as stamps in logs do: the order of the lines is kept.
        written_ns = max(logged_ns, written_ns + 1)
        connection = topics[topic]
        writer.write(connection, written_ns, store.serialize_ros1(message, connection.msgtype))

    for number, (stamp_ns, logged_ns, ranges, laser, robot) in enumerate(scans(log)):
        if number == 0:
            cos, sin = math.cos(robot[2]), math.sin(robot[2])
            ahead, left = laser[0] - robot[0], laser[1] - robot[1]
            # As exact as the poses in the log are written.
            place = Vector3(round(cos * ahead + sin * left, 5), round(cos * left - sin * ahead, 5), 0.0)
            transform = Transform(place, turned(laser[2] - robot[2]))
            put("/tf_static", logged_ns, TfMessage([Stamped(header(stamp_ns, "base_link"), "laser", transform)]))
        step = math.pi / (len(ranges) - len(ranges) % 2)
        ranges = numpy.array(ranges, dtype=numpy.float32)
        shape = (-math.pi / 2, math.pi / 2 - step, step, 0.0, 0.0, 0.0, 49.5)
        put("/scan", logged_ns, Scan(header(stamp_ns, "laser"), *shape, ranges, numpy.zeros(0, dtype=numpy.float32)))
        pose = WithPose(Pose(Point(robot[0], robot[1], 0.0), turned(robot[2])), covariance)
        twist = WithTwist(Twist(nothing, nothing), covariance)
        put("/odom", logged_ns, Odometry(header(stamp_ns, "odom"), "base_link", pose, twist))
