"""Whatever else may come over a network: random and broken datagrams at the ports of a node, messages that are none of their type or
claim to be giant, and more messages than anybody needs.

hostile.py SECONDS RATE PORT…
RATE: messages a second on /tf; 0 for none, and no broken messages of DDS either. A line of standard output says what was sent.
"""
import os
import random
import socket
import struct
import sys
import threading
import time
from dataclasses import dataclass

import cyclonedds.idl.types as T
from cyclone_types import Header, TFMessage, Time, transform, writer
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct

GIANT = 0xFFFFFFF0


@dataclass
class ClaimedTransforms(IdlStruct, typename="tf2_msgs::msg::dds_::TFMessage_"):
    count: T.uint32


@dataclass
class ClaimedScan(IdlStruct, typename="sensor_msgs::msg::dds_::LaserScan_"):
    header: Header
    shape: T.array[T.float32, 7]
    count: T.uint32


@dataclass
class OtherScan(IdlStruct, typename="sensor_msgs::msg::dds_::LaserScan_"):
    numbers: T.sequence[T.uint64]


seconds, rate = float(sys.argv[1]), float(sys.argv[2])
ports = [int(port) for port in sys.argv[3:]]
chance = random.Random(7)
sent = {"datagrams": 0, "messages": 0, "broken": 0}
until = time.monotonic() + seconds


def submessage():
    """A submessage of any kind, the numbers in which are as often as not the largest that fit."""
    kind = chance.choice([0x06, 0x07, 0x08, 0x09, 0x0C, 0x0E, 0x12, 0x13, 0x15, 0x15, 0x16, 0x16, chance.randrange(256)])
    words = [chance.choice([0, 1, 256, GIANT, chance.getrandbits(32)]) for _ in range(chance.randrange(24))]
    # A reader that exists in every participant: that of others' announcements.
    body = struct.pack("<HH", 0, 16) + bytes.fromhex(chance.choice(["00000000", "000100c7", "000003c7", "000004c7"]))
    body += bytes.fromhex(chance.choice(["000100c2", "000003c2", "000004c2", "00000803"]))
    body += b"".join(struct.pack("<I", word) for word in words)
    length = chance.choice([len(body), len(body), chance.getrandbits(16)])
    return struct.pack("<BBH", kind, chance.choice([1, 5, 7, 3, chance.randrange(256)]), length) + body


def datagram():
    kind = chance.randrange(4)
    if kind == 0:
        return chance.randbytes(chance.randrange(1500))
    head = b"RTPS" + bytes([2, 3, 1, 15]) + chance.randbytes(12)
    if kind == 1:
        return head + chance.randbytes(chance.randrange(600))
    return head + b"".join(submessage() for _ in range(chance.randrange(1, 6)))


def throw():
    out = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    while time.monotonic() < until:
        for port in ports:
            out.sendto(datagram(), ("127.0.0.1", port))
            sent["datagrams"] += 1
        time.sleep(0.002)


threading.Thread(target=throw, daemon=True).start()
if rate:
    participant = DomainParticipant(int(os.environ["ROS_DOMAIN_ID"]))
    claims = writer(participant, "rt/tf", ClaimedTransforms)
    scans = writer(participant, "rt/scan", ClaimedScan)
    others = writer(DomainParticipant(int(os.environ["ROS_DOMAIN_ID"])), "rt/scan", OtherScan)
    floods = writer(DomainParticipant(int(os.environ["ROS_DOMAIN_ID"])), "rt/tf", TFMessage)
    began = time.monotonic()
    while time.monotonic() < until:
        if sent["messages"] % 100 == 0:
            claims.write(ClaimedTransforms(GIANT))
            scans.write(ClaimedScan(Header(Time(1, 1), "laser"), [0.0] * 7, GIANT))
            others.write(OtherScan(list(range(chance.randrange(2000)))))
            sent["broken"] += 3
        floods.write(TFMessage([transform(time.time_ns(), "base_footprint", "wheel", float(sent["messages"]), 0.0, 0.0)]))
        sent["messages"] += 1
        ahead = began + sent["messages"] / rate - time.monotonic()
        if ahead > 0.002:
            time.sleep(ahead)
while time.monotonic() < until:
    time.sleep(0.01)
print(sent["datagrams"], sent["messages"], sent["broken"], flush=True)
