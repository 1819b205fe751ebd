"""A node of the graph that obeys: a line of JSON on the standard input is a command, each is answered by one.

graph                        names of nodes, topics with types, services with types
map OUT                      a late subscriber of /map: writes the cells to OUT, says size, origin and how long it took
call TYPE NAME FIELDS        calls a service
parameters NODE NAMES        values; set NODE NAME VALUE sets one; all parameters NODE: the values of all that it lists
bond ID                      begins to keep a bond as nav2's lifecycle manager does; bonded: whether the other side is alive
diagnostics                  the last status of each name
listen TYPE NAME             begins to hear a topic, and what it said last where it keeps that; heard NAME [LAST]: how many messages came, and the last of them
say TYPE NAME FIELDS         publishes one message to whoever hears the topic
serve_map PGM RESOLUTION X Y publishes a picture as nav2's map server does
follow                       begins to keep a map by /map and its changes; followed: how many came, and whether changes bring it nearer to the next map
qos NODE TOPIC               reliability and durability that a node publishes or hears a topic with
correct                      publishes map → odom for a second, as another node would
seen NODE TOPIC              seconds from the start of this node until the other was in its lists and had found its topic /scan
"""
import importlib
import json
import os
import sys
import threading
import time

import rclpy
from cyclone_types import LATCHED as LATCHED_BY_CYCLONE
from cyclone_types import (
    LIMIT_S,
    SERVICES,
    BondStatus,
    Header,
    OccupancyGridUpdate,
    TFMessage,
    reader,
    stamp,
    transform,
    wait_until,
    writer,
)
from cyclone_types import OccupancyGrid as GridByCyclone
from cyclone_types import call as call_by_cyclone
from cyclonedds.domain import DomainParticipant
from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import OccupancyGrid
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

QUIET_S = 1.0
HEARTBEAT_S, PATIENCE_S = 0.1, 4.0
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL, reliability=ReliabilityPolicy.RELIABLE)

LINES = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL, reliability=ReliabilityPolicy.RELIABLE)

born = time.monotonic()
rclpy.init()
node = rclpy.create_node(sys.argv[1])
executor = SingleThreadedExecutor()
executor.add_node(node)
threading.Thread(target=executor.spin, daemon=True).start()
diagnostics, topics = {}, {}


def take_diagnostics(message):
    for status in message.status:
        diagnostics[status.name] = [int.from_bytes(status.level, "little"), status.message]


node.create_subscription(DiagnosticArray, "/diagnostics", take_diagnostics, 10)


def wait(future):
    return future.result() if wait_until(future.done) else None


def graph():
    names = [f"{space.rstrip('/')}/{name}" for name, space in node.get_node_names_and_namespaces()]
    return {
        "nodes": sorted(names),
        "topics": dict(node.get_topic_names_and_types()),
        "services": dict(node.get_service_names_and_types()),
    }


def late_map(out):
    began, found = time.monotonic(), []
    subscription = node.create_subscription(OccupancyGrid, "/map", found.append, LATCHED)
    wait_until(lambda: found)
    seconds = time.monotonic() - began
    # An older map may come before the newest.
    count = 0
    while len(found) > count:
        count = len(found)
        wait_until(lambda: len(found) > count, QUIET_S)
    node.destroy_subscription(subscription)
    if not found:
        return None
    grid = found[-1]
    open(out, "wb").write(bytes(value & 255 for value in grid.data))
    origin = grid.info.origin.position
    return {
        "seconds": seconds,
        "maps": len(found),
        "width": grid.info.width,
        "height": grid.info.height,
        "resolution": grid.info.resolution,
        "origin": [origin.x, origin.y],
        "frame": grid.header.frame_id,
    }


def fill(message, fields):
    for name, value in fields.items():
        if isinstance(value, dict):
            fill(getattr(message, name), value)
        else:
            setattr(message, name, value)


def plain(message):
    if hasattr(message, "get_fields_and_field_types"):
        return {name: plain(getattr(message, name)) for name in message.get_fields_and_field_types()}
    if hasattr(message, "tolist"):
        return message.tolist()
    if isinstance(message, (list, tuple)) or type(message).__name__ == "array":
        return [plain(part) for part in message]
    if isinstance(message, bytes):
        return int.from_bytes(message, "little")
    return message


def call(kind, name, fields):
    if kind in SERVICES:
        return call_by_cyclone(int(os.environ["ROS_DOMAIN_ID"]), kind, name, fields)
    package, kind = kind.split("/")
    kind = getattr(importlib.import_module(package + ".srv"), kind)
    client = node.create_client(kind, name)
    if not client.wait_for_service(timeout_sec=LIMIT_S):
        return None
    request = kind.Request()
    fill(request, fields)
    answer = wait(client.call_async(request))
    node.destroy_client(client)
    return answer and plain(answer)


def parameters(of, names):
    client = AsyncParameterClient(node, of)
    if not client.wait_for_services(LIMIT_S):
        return None
    answer = wait(client.get_parameters(names))
    return answer and [Parameter.from_parameter_msg(rclpy.parameter.ParameterMsg(name="x", value=value)).value for value in answer.values]


def set_parameter(of, name, value):
    client = AsyncParameterClient(node, of)
    if not client.wait_for_services(LIMIT_S):
        return None
    answer = wait(client.set_parameters([Parameter(name, value=value)]))
    return answer and [answer.results[0].successful, answer.results[0].reason]


def all_parameters(of):
    client = AsyncParameterClient(node, of)
    if not client.wait_for_services(LIMIT_S):
        return None
    return parameters(of, wait(client.list_parameters([], 10)).result.names)


class Bond:
    """The manager's side of a bond: it breaks when the other side is silent for too long, or says that it ends it, or another comes."""

    def __init__(self, name):
        self.name, self.heard_at, self.sister, self.broken, self.ended = name, None, None, None, False
        participant = DomainParticipant(int(os.environ["ROS_DOMAIN_ID"]))
        self.sends, self.hears = writer(participant, "rt/bond", BondStatus), reader(participant, "rt/bond", BondStatus)
        self.thread = threading.Thread(target=self.keep, daemon=True)
        self.thread.start()

    def keep(self):
        while not self.ended:
            now_ns = time.time_ns()
            self.sends.write(BondStatus(Header(stamp(now_ns), ""), self.name, "manager", True, PATIENCE_S, HEARTBEAT_S))
            for status in self.hears.take(N=100):
                if status.id != self.name or status.instance_id == "manager":
                    continue
                self.sister = self.sister or status.instance_id
                if status.instance_id != self.sister:
                    self.broken = self.broken or "another instance"
                elif not status.active:
                    self.broken = self.broken or "ended"
                else:
                    self.heard_at = time.monotonic()
            if self.heard_at and time.monotonic() - self.heard_at > PATIENCE_S:
                self.broken = self.broken or "silence"
            time.sleep(HEARTBEAT_S)

    def state(self):
        return {"formed": self.heard_at is not None, "broken": self.broken, "instance": self.sister}


def kind_of(name):
    package, kind = name.split("/")
    return getattr(importlib.import_module(package + ".msg"), kind)


def listen(kind, name):
    topics[name] = []
    node.create_subscription(kind_of(kind), name, topics[name].append, LINES if name == "/rosout" else 10)
    return True


def heard(name, last=20):
    return {"count": len(topics[name]), "last": [plain(message) for message in topics[name][-last:]]}


def say(kind, name, fields):
    message = kind_of(kind)()
    fill(message, fields)
    publisher = node.create_publisher(kind_of(kind), name, 10)
    if not wait_until(lambda: publisher.get_subscription_count() > 0):
        return False
    # The other side may know of this one a little later than this one of it.
    time.sleep(0.2)
    publisher.publish(message)
    return True


def qos(name, topic):
    ends = node.get_publishers_info_by_topic(topic) + node.get_subscriptions_info_by_topic(topic)
    found = [end.qos_profile for end in ends if end.node_name == name]
    return [[profile.reliability.name, profile.durability.name] for profile in found]


def correct():
    sends = writer(DomainParticipant(int(os.environ["ROS_DOMAIN_ID"])), "rt/tf", TFMessage)
    for _ in range(20):
        sends.write(TFMessage([transform(time.time_ns(), "map", "odom", 1.0, 0.0, 0.0)]))
        time.sleep(0.05)
    return True


def seen(name, topic):
    """Both directions: what the other node publishes is in the lists, and it hears this one's scans."""
    publisher = node.create_publisher(kind_of("sensor_msgs/LaserScan"), topic + "/scan", 10)
    names = lambda: [f"{space.rstrip('/')}/{name}" for name, space in node.get_node_names_and_namespaces()]
    is_found = lambda: node.count_publishers(topic + "/map") > 0 and publisher.get_subscription_count() > 0
    found = wait_until(lambda: is_found() and name in names())
    node.destroy_publisher(publisher)
    return time.monotonic() - born if found else None


class FollowedMap:
    """The map by its topic and the changes of it: whether these bring it nearer to the next map."""

    def __init__(self):
        self.maps, self.changes, self.pending, self.nearer = 0, 0, 0, None
        self.size, self.cells, self.before = None, [], []
        participant = DomainParticipant(int(os.environ["ROS_DOMAIN_ID"]))
        self.hears_maps = reader(participant, "rt/map", GridByCyclone, LATCHED_BY_CYCLONE)
        self.hears_changes = reader(participant, "rt/map_updates", OccupancyGridUpdate)
        threading.Thread(target=self.keep, daemon=True).start()

    def keep(self):
        while True:
            for change in self.hears_changes.take(N=10):
                self.changes, self.pending = self.changes + 1, self.pending + 1
                for row in range(change.height):
                    at, end = row * change.width, (row + 1) * change.width
                    to = (change.y + row) * self.size[0] + change.x
                    self.cells[to : to + change.width] = change.data[at:end]
            for grid in self.hears_maps.take(N=10):
                size = (grid.info.width, grid.info.height)
                differing = lambda cells: sum(a != b for a, b in zip(cells, grid.data))
                if self.pending and size == self.size:
                    self.nearer = self.nearer is not False and differing(self.cells) < differing(self.before)
                self.maps, self.pending = self.maps + 1, 0
                self.size, self.cells, self.before = size, list(grid.data), list(grid.data)
            time.sleep(0.02)

    def state(self):
        return {"maps": self.maps, "changes": self.changes, "nearer": self.nearer}


def serve_map(picture, resolution, x, y):
    picture = open(picture, "rb").read()
    width, height = (int(word) for word in picture.split(None, 3)[1:3])
    pixels = picture[-width * height :]
    grid = OccupancyGrid()
    grid.header.frame_id = "map"
    grid.info.width, grid.info.height, grid.info.resolution = width, height, resolution
    grid.info.origin.position.x, grid.info.origin.position.y, grid.info.origin.orientation.w = x, y, 1.0
    value = {0: 100, 254: 0}
    rows = [pixels[row * width : (row + 1) * width] for row in reversed(range(height))]
    grid.data = [value.get(pixel, -1) for row in rows for pixel in row]
    served.append(node.create_publisher(OccupancyGrid, "/map", LATCHED))
    served[-1].publish(grid)
    return [width, height]


bond = followed = None
served = []


def follow():
    global followed
    followed = FollowedMap()
    return True


def begin_bond(name):
    global bond
    if bond:
        bond.ended = True
    bond = Bond(name)
    return True


COMMANDS = {
    "graph": graph,
    "map": late_map,
    "call": call,
    "parameters": parameters,
    "all parameters": all_parameters,
    "set": set_parameter,
    "diagnostics": lambda: diagnostics,
    "listen": listen,
    "heard": heard,
    "say": say,
    "qos": qos,
    "correct": correct,
    "seen": seen,
    "serve_map": serve_map,
    "follow": follow,
    "followed": lambda: followed.state(),
    "bond": begin_bond,
    "bonded": lambda: bond.state(),
}
for line in sys.stdin:
    command, *rest = json.loads(line)
    print(json.dumps(COMMANDS[command](*rest)), flush=True)
