"""Messages that no package of the index has for rclpy, and the quality of service that nodes of ROS give their topics, for Cyclone DDS."""
import math
import sys
import time
from dataclasses import dataclass

import cyclonedds.idl.types as T
from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct, make_idl_struct
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

LIMIT_S = 40
DISCOVERY_S, ANSWER_S = 5, 15


@dataclass
class Time(IdlStruct, typename="builtin_interfaces::msg::dds_::Time_"):
    sec: T.int32
    nanosec: T.uint32


@dataclass
class Header(IdlStruct, typename="std_msgs::msg::dds_::Header_"):
    stamp: Time
    frame_id: str


@dataclass
class Vector3(IdlStruct, typename="geometry_msgs::msg::dds_::Vector3_"):
    x: float
    y: float
    z: float


@dataclass
class Quaternion(IdlStruct, typename="geometry_msgs::msg::dds_::Quaternion_"):
    x: float
    y: float
    z: float
    w: float


@dataclass
class Transform(IdlStruct, typename="geometry_msgs::msg::dds_::Transform_"):
    translation: Vector3
    rotation: Quaternion


@dataclass
class TransformStamped(IdlStruct, typename="geometry_msgs::msg::dds_::TransformStamped_"):
    header: Header
    child_frame_id: str
    transform: Transform


@dataclass
class TFMessage(IdlStruct, typename="tf2_msgs::msg::dds_::TFMessage_"):
    transforms: T.sequence[TransformStamped]


@dataclass
class Pose(IdlStruct, typename="geometry_msgs::msg::dds_::Pose_"):
    position: Vector3
    orientation: Quaternion


@dataclass
class MapMetaData(IdlStruct, typename="nav_msgs::msg::dds_::MapMetaData_"):
    map_load_time: Time
    resolution: T.float32
    width: T.uint32
    height: T.uint32
    origin: Pose


@dataclass
class OccupancyGrid(IdlStruct, typename="nav_msgs::msg::dds_::OccupancyGrid_"):
    header: Header
    info: MapMetaData
    data: T.sequence[T.int8]


@dataclass
class OccupancyGridUpdate(IdlStruct, typename="map_msgs::msg::dds_::OccupancyGridUpdate_"):
    header: Header
    x: T.int32
    y: T.int32
    width: T.uint32
    height: T.uint32
    data: T.sequence[T.int8]


@dataclass
class BondStatus(IdlStruct, typename="bond::msg::dds_::Status_"):
    header: Header
    id: str
    instance_id: str
    active: bool
    heartbeat_timeout: T.float32
    heartbeat_period: T.float32


@dataclass
class ParameterValue(IdlStruct, typename="rcl_interfaces::msg::dds_::ParameterValue_"):
    type: T.uint8
    bool_value: bool
    integer_value: T.int64
    double_value: T.float64
    string_value: str
    byte_array_value: T.sequence[T.uint8]
    bool_array_value: T.sequence[bool]
    integer_array_value: T.sequence[T.int64]
    double_array_value: T.sequence[T.float64]
    string_array_value: T.sequence[str]


@dataclass
class Parameter(IdlStruct, typename="rcl_interfaces::msg::dds_::Parameter_"):
    name: str
    value: ParameterValue


@dataclass
class SetParametersResult(IdlStruct, typename="rcl_interfaces::msg::dds_::SetParametersResult_"):
    successful: bool
    reason: str


@dataclass
class ListParametersResult(IdlStruct, typename="rcl_interfaces::msg::dds_::ListParametersResult_"):
    names: T.sequence[str]
    prefixes: T.sequence[str]


@dataclass
class Transition(IdlStruct, typename="lifecycle_msgs::msg::dds_::Transition_"):
    id: T.uint8
    label: str


@dataclass
class State(IdlStruct, typename="lifecycle_msgs::msg::dds_::State_"):
    id: T.uint8
    label: str


@dataclass
class TransitionDescription(IdlStruct, typename="lifecycle_msgs::msg::dds_::TransitionDescription_"):
    transition: Transition
    start_state: State
    goal_state: State


def parameter(name, value):
    """A parameter that is a number."""
    return Parameter(name, ParameterValue(3, False, 0, value, "", [], [], [], [], []))


def service(package, name, request, response):
    """The request and the response of a service, with these fields."""

    def part(kind, fields):
        return make_idl_struct(f"{name}{kind}", f"{package}::srv::dds_::{name}_{kind}_", fields)

    return part("Request", request), part("Response", response)


# What nodes of rmw_cyclonedds_cpp write before each call and answer: who has called, and which call it was.
CALLER = {"guid": T.uint64, "sequence": T.int64}
NOTHING, RESULT = {"nothing": T.uint8}, {"result": T.uint8}
PLACE = {"x": T.float64, "y": T.float64, "theta": T.float64}
SAVED = {"map_topic": str, "map_url": str, "image_format": str, "map_mode": str}
SAVED |= {"free_thresh": T.float32, "occupied_thresh": T.float32}
VALUES, RESULTS = {"values": T.sequence[ParameterValue]}, {"results": T.sequence[SetParametersResult]}
SERVICES = {
    "rcl_interfaces/GetParameters by header": service(
        "rcl_interfaces", "GetParameters", {**CALLER, "names": T.sequence[str]}, {**CALLER, **VALUES}
    ),
    "rcl_interfaces/SetParameters by header": service(
        "rcl_interfaces", "SetParameters", {**CALLER, "parameters": T.sequence[Parameter]}, {**CALLER, **RESULTS}
    ),
    "rcl_interfaces/ListParameters by header": service(
        "rcl_interfaces",
        "ListParameters",
        {**CALLER, "prefixes": T.sequence[str], "depth": T.uint64},
        {**CALLER, "result": ListParametersResult},
    ),
    "lifecycle_msgs/ChangeState by header": service(
        "lifecycle_msgs", "ChangeState", {**CALLER, "transition": Transition}, {**CALLER, "success": bool}
    ),
    "lifecycle_msgs/GetAvailableTransitions by header": service(
        "lifecycle_msgs",
        "GetAvailableTransitions",
        {**CALLER, **NOTHING},
        {**CALLER, "available_transitions": T.sequence[TransitionDescription]},
    ),
    "nav2_msgs/LoadMap": service("nav2_msgs", "LoadMap", {"map_url": str}, {"map": OccupancyGrid, **RESULT}),
    "nav2_msgs/SaveMap": service("nav2_msgs", "SaveMap", SAVED, {"result": bool}),
    "lifecycle_msgs/GetState by header": service(
        "lifecycle_msgs", "GetState", {**CALLER, **NOTHING}, {**CALLER, "id": T.uint8, "label": str}
    ),
    "slam_toolbox/SaveMap": service("slam_toolbox", "SaveMap", {"name": str}, RESULT),
    "slam_toolbox/Pause": service("slam_toolbox", "Pause", NOTHING, {"status": bool}),
    "slam_toolbox/Reset": service("slam_toolbox", "Reset", {"pause_new_measurements": bool}, RESULT),
    "slam_toolbox/SerializePoseGraph": service("slam_toolbox", "SerializePoseGraph", {"filename": str}, RESULT),
    "slam_toolbox/DeserializePoseGraph": service(
        "slam_toolbox", "DeserializePoseGraph", {"filename": str, "match_type": T.int8, **PLACE}, RESULT
    ),
}
RELIABLE = Policy.Reliability.Reliable(duration(seconds=1))
VOLATILE = Qos(RELIABLE, Policy.Durability.Volatile, Policy.History.KeepLast(100))
LATCHED = Qos(RELIABLE, Policy.Durability.TransientLocal, Policy.History.KeepLast(1))


def writer(participant, topic, kind, qos=VOLATILE):
    return DataWriter(participant, Topic(participant, topic, kind, qos=qos), qos=qos)


def reader(participant, topic, kind, qos=VOLATILE):
    return DataReader(participant, Topic(participant, topic, kind, qos=qos), qos=qos)


# Fields of requests that are no plain values.
BUILT = {
    "parameters": lambda pairs: [parameter(*pair) for pair in pairs],
    "transition": lambda number: Transition(number, ""),
}


def call(domain, kind, name, fields):
    """Calls a service; the answer's fields. Answers to other callers are not told apart: there are none."""
    request, response = SERVICES[kind]
    fields = {name: BUILT.get(name, lambda value: value)(value) for name, value in fields.items()}
    deadline = time.monotonic() + LIMIT_S
    while time.monotonic() < deadline:
        # A participant that began while the other side had no socket yet is announced to it only half a minute later.
        participant = DomainParticipant(domain)
        answers = reader(participant, "rr" + name + "Reply", response)
        requests = writer(participant, "rq" + name + "Request", request)
        are_matched = lambda: requests.get_matched_subscriptions() and answers.get_matched_publications()
        if not wait_until(are_matched, DISCOVERY_S):
            print(f"{name}: not found within {DISCOVERY_S} s", file=sys.stderr)
            continue
        # The other side may know of this one a little later than this one of it: an answer before that is lost.
        time.sleep(0.1)
        requests.write(request(**fields))
        found = []
        if wait_until(lambda: found.extend(answers.take(N=1)) or found, ANSWER_S):
            return fields_of(found[0])
        print(f"{name}: no answer within {ANSWER_S} s", file=sys.stderr)
    return None


def wait_until(is_so, limit_s=LIMIT_S):
    deadline = time.monotonic() + limit_s
    while not is_so() and time.monotonic() < deadline:
        time.sleep(0.005)
    return is_so()


def fields_of(message):
    if hasattr(message, "__dataclass_fields__"):
        return {name: fields_of(getattr(message, name)) for name in message.__dataclass_fields__}
    if isinstance(message, (list, bytes)):
        return [fields_of(part) for part in message]
    return message


def stamp(stamp_ns):
    return Time(stamp_ns // 10**9, stamp_ns % 10**9)


def nanoseconds(time):
    return time.sec * 10**9 + time.nanosec


def transform(stamp_ns, parent, child, x, y, heading):
    """A pose in the plane."""
    turn = Quaternion(0.0, 0.0, math.sin(heading / 2), math.cos(heading / 2))
    return TransformStamped(Header(stamp(stamp_ns), parent), child, Transform(Vector3(x, y, 0.0), turn))


def corrections(message):
    """Of a message of transforms those from the map to odometry: stamp in nanoseconds, x, y, heading."""
    for found in message.transforms:
        if found.header.frame_id == "map" and found.child_frame_id == "odom":
            at, turn = found.transform.translation, found.transform.rotation
            yield [nanoseconds(found.header.stamp), at.x, at.y, 2 * math.atan2(turn.z, turn.w)]
