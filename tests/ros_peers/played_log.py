"""A CARMEN log that is played: its scans as messages, where the lidar sits, and when each scan is due; and rows of poses that are noted."""
import math
import time

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


def mounting(laser, robot):
    """The pose of the lidar on the robot: x, y, heading."""
    dx, dy, turn = laser[0] - robot[0], laser[1] - robot[1], robot[2]
    x, y = math.cos(turn) * dx + math.sin(turn) * dy, math.cos(turn) * dy - math.sin(turn) * dx
    return x, y, laser[2] - robot[2]


def paced(path, rate, wait):
    """The scans, each when it is due at so many seconds of the log a second; `wait(stamp_ns)` is called until then, with the log's time."""
    began, first_ns = time.monotonic(), None
    for scan in scans(path):
        first_ns = scan[0] if first_ns is None else first_ns
        while time.monotonic() < began + (scan[0] - first_ns) * 1e-9 / rate:
            wait(first_ns + round((time.monotonic() - began) * rate * 1e9))
        yield scan


def laser_scan(stamp_ns, start, step, ranges):
    """A scan as a message."""
    message = LaserScan()
    message.header.frame_id = "laser"
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, 10**9)
    message.angle_min, message.angle_increment = start, step
    message.angle_max = message.angle_min + message.angle_increment * (len(ranges) - 1)
    message.range_min, message.range_max = 0.0, 80.0
    message.ranges = ranges
    return message


def pose_row(message):
    """Of a `PoseWithCovarianceStamped`: stamp in nanoseconds, x, y, heading, and when it was heard."""
    at, turn = message.pose.pose.position, message.pose.pose.orientation
    stamp_ns = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
    return [stamp_ns, at.x, at.y, 2 * math.atan2(turn.z, turn.w), time.monotonic_ns()]
