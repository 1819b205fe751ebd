"""A robot in a graph of rmw_zenoh, by the library of zenoh and the messages of ROS: plays the scans of a CARMEN log on /scan and its
odometry on /tf, and notes what comes back; then reads the map late, calls services, and looks at what the other node announces.

zenoh_robot.py PORT LOG RATE OUT
PORT: a router is opened there; all others meet by it, as in the defaults of rmw_zenoh. A line of standard output says `ready` when it is
open. OUT gets what was noted, as JSON. Hashes of types are those of the JSON files of their packages.
"""
import json
import os
import struct
import sys
import time
import traceback
from pathlib import Path

import zenoh
import zenoh.ext
from cyclone_types import TFMessage, corrections, transform
from geometry_msgs.msg import PoseWithCovarianceStamped
from lifecycle_msgs.srv import GetState
from nav_msgs.msg import OccupancyGrid
from nav_msgs.srv import GetMap
from played_log import laser_scan, mounting, paced, pose_row
from rcl_interfaces.srv import GetParameters
from rclpy.serialization import deserialize_message, serialize_message

LIMIT_S = 20
DOMAIN = os.environ["ROS_DOMAIN_ID"]
# The index has no package of it; `ros2 topic info --verbose` of Jazzy says so.
TF_HASH = "RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087"
GID = bytes(range(16))
RELIABLE, LATCHED = "::,100:,:,:,,", ":1:,1:,:,:,,"


def published_hash(name):
    """As the package of a type has it; None where the index has no such package."""
    if name == "tf2_msgs/msg/TFMessage":
        return TF_HASH
    found = Path(sys.prefix, "share", name).with_suffix(".json")
    return json.loads(found.read_text())["type_hashes"][0]["hash_string"] if found.is_file() else None


def key(topic, name):
    package, of, kind = name.split("/")
    return f"{DOMAIN}/{topic.strip('/')}/{package}::{of}::dds_::{kind}_/{published_hash(name)}"


def beside(sequence):
    return struct.pack("<qqB", sequence, time.time_ns(), 16) + GID


def wait_until(is_so):
    deadline = time.monotonic() + LIMIT_S
    while not is_so():
        assert time.monotonic() < deadline, is_so
        time.sleep(0.01)


def opened(mode, **endpoints):
    configuration = zenoh.Config()
    configuration.insert_json5("mode", json.dumps(mode))
    configuration.insert_json5("scouting/multicast/enabled", "false")
    for side, endpoint in endpoints.items():
        configuration.insert_json5(f"{side}/endpoints", json.dumps([endpoint]))
    return zenoh.open(configuration)


def fail(kind, error, trace):
    traceback.print_exception(kind, error, trace)
    end(1)


def end(code):
    """Sessions that are open keep the interpreter from ending by itself."""
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)


sys.excepthook = fail
port, log, rate, out = sys.argv[1:5]
router = opened("router", listen=f"tcp/127.0.0.1:{port}")
session = opened("peer", connect=f"tcp/127.0.0.1:{port}", listen="tcp/127.0.0.1:0")
print("ready", flush=True)
noted = {"corrections": [], "poses": [], "sent": [], "beside": []}
kept = []


def announce(number, kind, topic, name, quality):
    package, of, of_kind = name.split("/")
    head = f"@ros2_lv/{DOMAIN}/{session.info.zid()}/0/{number}/{kind}/%/%/robot"
    entity = f"{topic.replace('/', '%')}/{package}::{of}::dds_::{of_kind}_/{published_hash(name)}/{quality}"
    kept.append(session.liveliness().declare_token(f"{head}/{entity}"))


def hear(topic, name, take):
    def heard(sample):
        attachment = bytes(sample.attachment)
        # What this one sends comes back.
        if attachment[17:] != GID:
            noted["beside"].append([topic, attachment.hex()])
            take(bytes(sample.payload))

    kept.append(session.declare_subscriber(key(topic, name), heard))


def announced():
    return sorted(str(reply.ok.key_expr) for reply in session.liveliness().get(f"@ros2_lv/{DOMAIN}/**") if reply.ok)


def call(service, name, kind, request):
    """The answer to a call, and whether what stands beside it is what stood beside the call."""
    replies = session.get(
        key(service, name),
        payload=serialize_message(request),
        attachment=beside(7),
        target=zenoh.QueryTarget.ALL_COMPLETE,
        consolidation=zenoh.ConsolidationMode.NONE,
        timeout=LIMIT_S,
    )
    sample = next(reply.ok for reply in replies if reply.ok)
    attachment = bytes(sample.attachment)
    return deserialize_message(bytes(sample.payload), kind.Response), attachment[:8] == beside(7)[:8] and attachment[16:] == beside(7)[16:]


def take_transforms(payload):
    noted["corrections"].extend(row + [time.monotonic_ns()] for row in corrections(TFMessage.deserialize(payload)))


SCAN, TF, POSE = "sensor_msgs/msg/LaserScan", "tf2_msgs/msg/TFMessage", "geometry_msgs/msg/PoseWithCovarianceStamped"
publisher, moving = session.declare_publisher(key("scan", SCAN)), session.declare_publisher(key("tf", TF))
fixed = zenoh.ext.declare_advanced_publisher(
    session,
    key("tf_static", TF),
    cache=zenoh.ext.CacheConfig(max_samples=1),
    publisher_detection=True,
    sample_miss_detection=zenoh.ext.MissDetectionConfig(),
)
hear("tf", TF, take_transforms)
hear("pose", POSE, lambda payload: noted["poses"].append(pose_row(deserialize_message(payload, PoseWithCovarianceStamped))))
kept.append(session.liveliness().declare_token(f"@ros2_lv/{DOMAIN}/{session.info.zid()}/0/0/NN/%/%/robot"))
announce(1, "MP", "/scan", SCAN, RELIABLE)
announce(2, "MS", "/pose", POSE, RELIABLE)
# Said before the other node is there: it gets it late.
mounted = False
wait_until(lambda: any("/MS/%/%/flockslam/%scan/" in token for token in announced()))
wait_until(lambda: publisher.matching_status.matching and moving.matching_status.matching)
for number, (stamp_ns, start, step, ranges, laser, robot) in enumerate(paced(log, float(rate), lambda _: time.sleep(0.0005)), 1):
    if not mounted:
        message = TFMessage([transform(stamp_ns, "base_footprint", "laser", *mounting(laser, robot))])
        fixed.put(message.serialize(), attachment=beside(1))
        mounted = True
    moving.put(TFMessage([transform(stamp_ns, "odom", "base_footprint", *robot)]).serialize(), attachment=beside(number))
    noted["sent"].append([stamp_ns, *robot, time.monotonic_ns()])
    publisher.put(serialize_message(laser_scan(stamp_ns, start, step, ranges)), attachment=beside(number))
wait_until(lambda: noted["poses"] and noted["poses"][-1][0] >= noted["sent"][-1][0])

# Somebody who comes late.
maps = []
late = opened("peer", connect=f"tcp/127.0.0.1:{port}", listen="tcp/127.0.0.1:0")
kept.append(
    zenoh.ext.declare_advanced_subscriber(
        late,
        key("map", "nav_msgs/msg/OccupancyGrid"),
        lambda sample: maps.append(deserialize_message(bytes(sample.payload), OccupancyGrid)),
        history=zenoh.ext.HistoryConfig(detect_late_publishers=True, max_samples=1),
    )
)
wait_until(lambda: maps)
state, has_caller = call("flockslam/get_state", "lifecycle_msgs/srv/GetState", GetState, GetState.Request())
asked = GetParameters.Request(names=["odom_frame", "resolution"])
values, _ = call("flockslam/get_parameters", "rcl_interfaces/srv/GetParameters", GetParameters, asked)
whole, _ = call("slam_toolbox/dynamic_map", "nav_msgs/srv/GetMap", GetMap, GetMap.Request())


def announced_by_the_node():
    tokens = [token.split("/") for token in announced() if "/flockslam" in token]
    return [token for token in tokens if token[8] == "flockslam"]


# An answer may lack some of it while the router is busy.
own = []


def all_is_announced():
    own[:] = announced_by_the_node()
    return len(own) > 20


wait_until(all_is_announced)
hashes = []
for token in own:
    if token[5] != "NN":
        package, of, kind = token[10].replace("::dds_", "").split("::")
        name = f"{package}/{of}/{kind.rstrip('_')}"
        hashes.append([name, token[11], published_hash(name)])
size = lambda grid: [grid.info.width, grid.info.height, sum(value == 100 for value in grid.data)]
found = {
    "map": size(maps[-1]),
    "whole": size(whole.map),
    "state": [state.current_state.label, has_caller],
    "parameters": [values.values[0].string_value, values.values[1].double_value],
    "tokens": ["/".join(token[5:]) for token in own],
    "hashes": hashes,
}
with open(out, "w") as file:
    json.dump(noted | found, file)
end(0)
