"""Messages that no package of the index has for rclpy, and the quality of service that nodes of ROS give their topics, for Cyclone DDS."""
import time
from dataclasses import dataclass

import cyclonedds.idl.types as T
from cyclonedds.core import Policy, Qos
from cyclonedds.idl import IdlStruct
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration


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
class SaveMapRequest(IdlStruct, typename="slam_toolbox::srv::dds_::SaveMap_Request_"):
    name: str


@dataclass
class SaveMapResponse(IdlStruct, typename="slam_toolbox::srv::dds_::SaveMap_Response_"):
    result: T.uint8


@dataclass
class PauseRequest(IdlStruct, typename="slam_toolbox::srv::dds_::Pause_Request_"):
    nothing: T.uint8


@dataclass
class PauseResponse(IdlStruct, typename="slam_toolbox::srv::dds_::Pause_Response_"):
    status: bool


@dataclass
class ResetRequest(IdlStruct, typename="slam_toolbox::srv::dds_::Reset_Request_"):
    pause_new_measurements: bool


@dataclass
class ResetResponse(IdlStruct, typename="slam_toolbox::srv::dds_::Reset_Response_"):
    result: T.uint8


@dataclass
class SerializeRequest(IdlStruct, typename="slam_toolbox::srv::dds_::SerializePoseGraph_Request_"):
    filename: str


@dataclass
class SerializeResponse(IdlStruct, typename="slam_toolbox::srv::dds_::SerializePoseGraph_Response_"):
    result: T.uint8


@dataclass
class DeserializeRequest(IdlStruct, typename="slam_toolbox::srv::dds_::DeserializePoseGraph_Request_"):
    filename: str
    match_type: T.int8
    x: float
    y: float
    theta: float


@dataclass
class DeserializeResponse(IdlStruct, typename="slam_toolbox::srv::dds_::DeserializePoseGraph_Response_"):
    result: T.uint8


@dataclass
class LoadMapRequest(IdlStruct, typename="nav2_msgs::srv::dds_::LoadMap_Request_"):
    map_url: str


@dataclass
class LoadMapResponse(IdlStruct, typename="nav2_msgs::srv::dds_::LoadMap_Response_"):
    map: OccupancyGrid
    result: T.uint8


@dataclass
class NavigationSaveRequest(IdlStruct, typename="nav2_msgs::srv::dds_::SaveMap_Request_"):
    map_topic: str
    map_url: str
    image_format: str
    map_mode: str
    free_thresh: T.float32
    occupied_thresh: T.float32


@dataclass
class NavigationSaveResponse(IdlStruct, typename="nav2_msgs::srv::dds_::SaveMap_Response_"):
    result: bool


# What nodes of rmw_cyclonedds_cpp write before each call and answer: who has called, and which call it was.
@dataclass
class GetStateByHeader(IdlStruct, typename="lifecycle_msgs::srv::dds_::GetState_Request_"):
    guid: T.uint64
    sequence: T.int64
    nothing: T.uint8


@dataclass
class StateByHeader(IdlStruct, typename="lifecycle_msgs::srv::dds_::GetState_Response_"):
    guid: T.uint64
    sequence: T.int64
    id: T.uint8
    label: str


SERVICES = {
    "nav2_msgs/LoadMap": (LoadMapRequest, LoadMapResponse),
    "nav2_msgs/SaveMap": (NavigationSaveRequest, NavigationSaveResponse),
    "lifecycle_msgs/GetState by header": (GetStateByHeader, StateByHeader),
    "slam_toolbox/SaveMap": (SaveMapRequest, SaveMapResponse),
    "slam_toolbox/Pause": (PauseRequest, PauseResponse),
    "slam_toolbox/Reset": (ResetRequest, ResetResponse),
    "slam_toolbox/SerializePoseGraph": (SerializeRequest, SerializeResponse),
    "slam_toolbox/DeserializePoseGraph": (DeserializeRequest, DeserializeResponse),
}
RELIABLE = Policy.Reliability.Reliable(duration(seconds=1))
VOLATILE = Qos(RELIABLE, Policy.Durability.Volatile, Policy.History.KeepLast(100))
LATCHED = Qos(RELIABLE, Policy.Durability.TransientLocal, Policy.History.KeepLast(1))


def writer(participant, topic, kind, qos=VOLATILE):
    return DataWriter(participant, Topic(participant, topic, kind, qos=qos), qos=qos)


def reader(participant, topic, kind, qos=VOLATILE):
    return DataReader(participant, Topic(participant, topic, kind, qos=qos), qos=qos)


def call(participant, kind, name, fields, limit_s):
    """Calls a service; the answer's fields. Answers to other callers are not told apart: there are none."""
    request, response = SERVICES[kind]
    answers = reader(participant, "rr" + name + "Reply", response)
    requests = writer(participant, "rq" + name + "Request", request)
    deadline = time.monotonic() + limit_s
    while not (requests.get_matched_subscriptions() and answers.get_matched_publications()):
        if time.monotonic() > deadline:
            return None
        time.sleep(0.01)
    # The other side may know of this one a little later than this one of it.
    time.sleep(0.1)
    requests.write(request(**fields))
    while time.monotonic() < deadline:
        for answer in answers.take(N=1):
            return fields_of(answer)
        time.sleep(0.005)
    return None


def fields_of(message):
    if hasattr(message, "__dataclass_fields__"):
        return {name: fields_of(getattr(message, name)) for name in message.__dataclass_fields__}
    return message


def stamp(stamp_ns):
    return Time(stamp_ns // 10**9, stamp_ns % 10**9)


def nanoseconds(time):
    return time.sec * 10**9 + time.nanosec
