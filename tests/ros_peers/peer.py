"""A node of the graph that obeys: a line of JSON on the standard input is a command, each is answered by one.

graph                        names of nodes, topics with types, services with types
map OUT                      a late subscriber of /map: writes the cells to OUT, says size, origin and how long it took
call TYPE NAME FIELDS        calls a service
parameters NODE NAMES        values; set NODE NAME VALUE sets one
bond ID                      begins to keep a bond as nav2's lifecycle manager does; bonded: whether the other side is alive
diagnostics                  the last status of each name
"""
import importlib
import json
import os
import sys
import threading
import time

import rclpy
from cyclone_types import SERVICES, BondStatus, Header, reader, stamp, writer
from cyclone_types import call as call_by_cyclone
from cyclonedds.domain import DomainParticipant
from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import OccupancyGrid
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

LIMIT_S = 20
QUIET_S = 1.0
HEARTBEAT_S, PATIENCE_S = 0.1, 4.0
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL, reliability=ReliabilityPolicy.RELIABLE)

rclpy.init()
node = rclpy.create_node(sys.argv[1])
executor = SingleThreadedExecutor()
executor.add_node(node)
diagnostics = {}


def take_diagnostics(message):
    for status in message.status:
        diagnostics[status.name] = [int.from_bytes(status.level, "little"), status.message]


node.create_subscription(DiagnosticArray, "/diagnostics", take_diagnostics, 10)


def wait(future):
    executor.spin_until_future_complete(future, timeout_sec=LIMIT_S)
    return future.result() if future.done() else None


def graph():
    executor.spin_once(timeout_sec=0.05)
    names = [f"{space.rstrip('/')}/{name}" for name, space in node.get_node_names_and_namespaces()]
    return {
        "nodes": sorted(names),
        "topics": dict(node.get_topic_names_and_types()),
        "services": dict(node.get_service_names_and_types()),
    }


def late_map(out):
    began, found = time.monotonic(), []
    subscription = node.create_subscription(OccupancyGrid, "/map", found.append, LATCHED)
    while not found and time.monotonic() < began + LIMIT_S:
        executor.spin_once(timeout_sec=0.1)
    seconds = time.monotonic() - began
    # An older map may come before the newest.
    quiet = time.monotonic() + QUIET_S
    while found and time.monotonic() < quiet:
        before = len(found)
        executor.spin_once(timeout_sec=0.1)
        if len(found) > before:
            quiet = time.monotonic() + QUIET_S
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
    return message


def call(kind, name, fields):
    if kind in SERVICES:
        return call_by_cyclone(DomainParticipant(int(os.environ["ROS_DOMAIN_ID"])), kind, name, fields, LIMIT_S)
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


bond = None
for line in sys.stdin:
    command, *rest = json.loads(line)
    answer = None
    if command == "graph":
        answer = graph()
    elif command == "map":
        answer = late_map(*rest)
    elif command == "call":
        answer = call(*rest)
    elif command == "parameters":
        answer = parameters(*rest)
    elif command == "set":
        answer = set_parameter(*rest)
    elif command == "diagnostics":
        until = time.monotonic() + 0.05
        while time.monotonic() < until:
            executor.spin_once(timeout_sec=0.01)
        answer = diagnostics
    elif command == "bond":
        if bond:
            bond.ended = True
        bond = Bond(*rest)
        answer = True
    elif command == "bonded":
        answer = bond.state()
    print(json.dumps(answer), flush=True)
