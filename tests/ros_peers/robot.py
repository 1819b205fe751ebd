"""A robot in the graph: plays the scans of a CARMEN log on /scan and its odometry on /tf, and notes what comes back on /tf and /pose.

robot.py LOG RATE NAMESPACE OUT [WHEELS]
WHEELS: its odometry goes so much farther than the log's, and begins anew at zero in the middle of the drive; and the time of the graph is
that of the log, by /clock.
A line of standard output says `playing`, and `done` when all was sent and the last answers have come. OUT gets what was noted, as JSON.
"""
import gc
import json
import math
import os
import sys
import time

import rclpy
from cyclonedds.domain import DomainParticipant
from cyclone_types import (
    LATCHED,
    Header,
    Quaternion,
    TFMessage,
    Transform,
    TransformStamped,
    Vector3,
    nanoseconds,
    reader,
    stamp,
    writer,
)
from geometry_msgs.msg import PoseWithCovarianceStamped
from rclpy.qos import QoSProfile, qos_profile_sensor_data
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import LaserScan


def scans(path):
    """Stamp, first angle, step, ranges, pose of the lidar and pose of the robot of each scan."""
    for line in open(path):
        kind, *fields = line.split()
        if kind == "ROBOTLASER1":
            start, step, beams = float(fields[1]), float(fields[3]), int(fields[7])
            ranges, rest = fields[8 : 8 + beams], fields[8 + beams :]
            rest = rest[1 + int(rest[0]) :]
            poses, stamped = rest[:6], rest[11]
        elif kind == "FLASER":
            beams = int(fields[0])
            start, step = -math.pi / 2, math.radians(1.0 if beams <= 181 else 0.5)
            ranges, poses, stamped = fields[1 : 1 + beams], fields[1 + beams : 7 + beams], fields[7 + beams]
        else:
            continue
        poses = [float(number) for number in poses]
        yield round(float(stamped) * 1e9), start, step, [float(range_m) for range_m in ranges], poses[:3], poses[3:]


def transform(stamp_ns, parent, child, x, y, heading):
    turn = Quaternion(0.0, 0.0, math.sin(heading / 2), math.cos(heading / 2))
    return TransformStamped(Header(stamp(stamp_ns), parent), child, Transform(Vector3(x, y, 0.0), turn))


# What is noted grows, and looking through it for garbage would be measured.
gc.disable()
log, rate, namespace, out = sys.argv[1:5]
rate, wheels = float(rate), float(sys.argv[5]) if len(sys.argv) > 5 else None


class Wheels:
    """Odometry that goes too far."""

    def __init__(self, count):
        self.left, self.pose, self.before = count // 2, (0.0, 0.0, 0.0), None

    def pose_at(self, robot):
        x, y, heading = self.pose
        x0, y0, heading0 = self.before or robot
        dx, dy = robot[0] - x0, robot[1] - y0
        along = wheels * (math.cos(heading0) * dx + math.sin(heading0) * dy)
        across = wheels * (math.cos(heading0) * dy - math.sin(heading0) * dx)
        x, y = x + math.cos(heading) * along - math.sin(heading) * across, y + math.sin(heading) * along + math.cos(heading) * across
        self.left, self.before = self.left - 1, robot
        self.pose = (0.0, 0.0, 0.0) if self.left == 0 else (x, y, heading + robot[2] - heading0)
        return list(self.pose)


rclpy.init()
node = rclpy.create_node("robot", namespace=namespace)
participant = DomainParticipant(int(os.environ["ROS_DOMAIN_ID"]))
noted = {"corrections": [], "poses": [], "sent": []}


def take_pose(message):
    at, turn = message.pose.pose.position, message.pose.pose.orientation
    stamp_ns = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
    noted["poses"].append([stamp_ns, at.x, at.y, 2 * math.atan2(turn.z, turn.w), time.monotonic_ns()])


node.create_subscription(PoseWithCovarianceStamped, "pose", take_pose, QoSProfile(depth=100))
publisher = node.create_publisher(LaserScan, "scan", qos_profile_sensor_data)
moving = writer(participant, "rt/tf", TFMessage)
fixed = writer(participant, "rt/tf_static", TFMessage, LATCHED)
heard = reader(participant, "rt/tf", TFMessage)


def tick(stamp_ns):
    """The time of the log goes on between scans, too."""
    message = Clock()
    message.clock.sec, message.clock.nanosec = divmod(stamp_ns, 10**9)
    clock.publish(message)


def look():
    rclpy.spin_once(node, timeout_sec=0)
    for message in heard.take(N=100):
        for found in message.transforms:
            if found.header.frame_id == "map" and found.child_frame_id == "odom":
                at, turn = found.transform.translation, found.transform.rotation
                noted["corrections"].append(
                    [nanoseconds(found.header.stamp), at.x, at.y, 2 * math.atan2(turn.z, turn.w), time.monotonic_ns()]
                )


deadline = time.monotonic() + 20
while publisher.get_subscription_count() == 0:
    assert time.monotonic() < deadline, "nobody hears /scan"
    look()
    time.sleep(0.01)
# Cyclone DDS finds its readers for itself.
while not moving.get_matched_subscriptions():
    assert time.monotonic() < deadline, "nobody hears /tf"
    time.sleep(0.01)
clock = node.create_publisher(Clock, "/clock", qos_profile_sensor_data)
odometry = wheels and Wheels(sum(1 for _ in scans(log)))
print("playing", flush=True)
began, first_ns, ticked = time.monotonic(), None, 0.0
for stamp_ns, start, step, ranges, laser, robot in scans(log):
    if first_ns is None:
        first_ns = stamp_ns
        dx, dy, turn = laser[0] - robot[0], laser[1] - robot[1], robot[2]
        x, y = math.cos(turn) * dx + math.sin(turn) * dy, math.cos(turn) * dy - math.sin(turn) * dx
        fixed.write(TFMessage([transform(stamp_ns, "base_footprint", "laser", x, y, laser[2] - robot[2])]))
    robot = odometry.pose_at(robot) if odometry else robot
    due = began + (stamp_ns - first_ns) * 1e-9 / rate
    while time.monotonic() < due:
        if wheels and time.monotonic() > ticked + 0.01:
            ticked = time.monotonic()
            tick(first_ns + round((ticked - began) * rate * 1e9))
        look()
        time.sleep(0.0005)
    message = LaserScan()
    message.header.frame_id = "laser"
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, 10**9)
    message.angle_min, message.angle_increment = start, step
    message.angle_max = message.angle_min + message.angle_increment * (len(ranges) - 1)
    message.range_min, message.range_max = 0.0, 80.0
    message.ranges = ranges
    moving.write(TFMessage([transform(stamp_ns, "odom", "base_footprint", *robot)]))
    noted["sent"].append([stamp_ns, *robot, time.monotonic_ns()])
    publisher.publish(message)
until = time.monotonic() + 3
while time.monotonic() < until and (not noted["poses"] or noted["poses"][-1][0] < noted["sent"][-1][0]):
    look()
    time.sleep(0.001)
until = time.monotonic() + 0.3
while time.monotonic() < until:
    look()
    time.sleep(0.001)
json.dump(noted, open(out, "w"))
print("done", len(noted["sent"]), flush=True)
