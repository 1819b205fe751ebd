"""A robot in the graph: plays the scans of a CARMEN log on /scan and its odometry on /tf, and notes what comes back on /tf and /pose.

robot.py LOG RATE NAMESPACE OUT [WHEELS [ROUNDS]]
WHEELS: its odometry goes so much farther than the log's, and begins anew at zero in the middle of the drive; and the time of the graph is
that of the log, by /clock. ROUNDS: the log is played so often, and time goes back in between, as with `ros2 bag play --loop --clock`.
A line of standard output says `playing`, and `done` when all was sent and the last answers have come. OUT gets what was noted, as JSON.
"""
import gc
import json
import math
import os
import sys
import threading
import time

import rclpy
from cyclonedds.core import InstanceState, ReadCondition, SampleState, ViewState, WaitSet
from cyclonedds.domain import DomainParticipant
from cyclonedds.util import duration
from cyclone_types import LATCHED, TFMessage, corrections, reader, transform, writer
from geometry_msgs.msg import PoseWithCovarianceStamped
from played_log import laser_scan, mounting, paced, pose_row, scans
from rclpy.qos import QoSProfile, qos_profile_sensor_data
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import LaserScan

# What is noted grows, and looking through it for garbage would be measured.
gc.disable()
log, rate, namespace, out = sys.argv[1:5]
rate, wheels = float(rate), float(sys.argv[5]) if len(sys.argv) > 5 else None
rounds = int(sys.argv[6]) if len(sys.argv) > 6 else 1


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


poses = node.create_subscription(PoseWithCovarianceStamped, "pose", lambda message: noted["poses"].append(pose_row(message)), QoSProfile(depth=100))
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


def hear(is_over):
    """Notes transforms when they come: between two looks a millisecond may pass."""
    waiting = WaitSet(participant)
    waiting.attach(ReadCondition(heard, SampleState.Any | ViewState.Any | InstanceState.Any))
    while not is_over.is_set():
        waiting.wait(duration(milliseconds=100))
        for message in heard.take(N=100):
            noted["corrections"].extend(row + [time.monotonic_ns()] for row in corrections(message))


deadline = time.monotonic() + 20
# Who publishes poses may know of this one a little later than this one of it: /scan and /tf are waited for after it.
while publisher.get_subscription_count() == 0 or node.count_publishers(poses.topic_name) == 0:
    assert time.monotonic() < deadline, "nobody hears /scan, or publishes poses"
    look()
    time.sleep(0.01)
# Cyclone DDS finds its readers for itself.
while not moving.get_matched_subscriptions():
    assert time.monotonic() < deadline, "nobody hears /tf"
    time.sleep(0.01)
clock = node.create_publisher(Clock, "/clock", qos_profile_sensor_data)
count = sum(1 for _ in scans(log))
if wheels:
    while clock.get_subscription_count() == 0:
        assert time.monotonic() < deadline, "nobody hears /clock"
        look()
        time.sleep(0.01)
    # A simulation says the time before its first scan.
    tick(next(scans(log))[0])
    time.sleep(0.1)
over = threading.Event()
hearing = threading.Thread(target=hear, args=[over])
hearing.start()
print("playing", flush=True)
ticked = 0.0


def wait(now_ns):
    global ticked
    if wheels and time.monotonic() > ticked + 0.01:
        ticked = time.monotonic()
        tick(now_ns)
    look()
    time.sleep(0.0005)


def play():
    odometry = wheels and Wheels(count)
    for stamp_ns, start, step, ranges, laser, robot in paced(log, rate, wait):
        if not noted["sent"]:
            fixed.write(TFMessage([transform(stamp_ns, "base_footprint", "laser", *mounting(laser, robot))]))
        robot = odometry.pose_at(robot) if odometry else robot
        message = laser_scan(stamp_ns, start, step, ranges)
        moving.write(TFMessage([transform(stamp_ns, "odom", "base_footprint", *robot)]))
        noted["sent"].append([stamp_ns, *robot, time.monotonic_ns()])
        publisher.publish(message)


for _ in range(rounds):
    play()
until = time.monotonic() + 3
while time.monotonic() < until and (not noted["poses"] or noted["poses"][-1][0] != noted["sent"][-1][0]):
    look()
    time.sleep(0.001)
until = time.monotonic() + 0.3
while time.monotonic() < until:
    look()
    time.sleep(0.001)
over.set()
hearing.join()
json.dump(noted, open(out, "w"))
print("done", len(noted["sent"]), flush=True)
