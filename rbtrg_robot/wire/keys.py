"""Topics on Zenoh: the keys, attachments and liveliness tokens of rmw_zenoh.

So RViz, `ros2 topic` and rosbag2 see a ROS 2 graph although no ROS is installed here.
"""

from __future__ import annotations

import hashlib
import struct

from rbtrg_robot.scope import Scope
from rbtrg_robot.topics import Qos, Topic
from rbtrg_robot.wire.messages import type_hash

OURS = b"rbtg"
"""In the gid of every publisher of ours."""

_QOS = {
    Qos.SENSOR: "2:2:1,5:,:,:,,",
    Qos.STATE: "1:2:1,10:,:,:,,",
    Qos.LATCHED: "1:1:1,1:,:,:,,",
    Qos.COMMAND: "1:2:1,1:,:,:,,",
}


def dds_type(typename: str) -> str:
    """`nav_msgs/msg/Odometry` -> `nav_msgs::msg::dds_::Odometry_`."""
    package, _, name = typename.split("/")
    return f"{package}::msg::dds_::{name}_"


def key(topic: Topic, scope: Scope) -> str:
    """Data key of a topic."""
    return f"{scope.prefix}/{topic.name.strip('/')}/{dds_type(topic.type)}/{type_hash(topic.type)}"


def service(name: str, scope: Scope) -> str:
    """Key of a question that the supervisor answers."""
    return f"{scope.prefix}/rbtrg/{name}"


def _mangled(name: str) -> str:
    """A name as a part of a token, which holds no slash; the empty enclave and namespace are `%`."""
    return name.replace("/", "%")


def node_token(scope: Scope, zid: str, node: str) -> str:
    """Liveliness token of a node; node id 0, empty enclave."""
    return f"@ros2_lv/{scope.domain}/{zid}/0/0/NN/%/{_mangled('/' + scope.namespace)}/{node}"


def process_of(token: str) -> str:
    """The process a node token belongs to."""
    return token.rsplit("/", 1)[1]


def session_of(token: str) -> str:
    """The id of the Zenoh session that holds a token."""
    return token.split("/", 3)[2]


def endpoint_token(scope: Scope, zid: str, node: str, topic: Topic, entity: int, kind: str) -> str:
    """Liveliness token of a publisher (`kind` MP) or subscription (MS)."""
    return (
        f"@ros2_lv/{scope.domain}/{zid}/0/{entity}/{kind}/%/{_mangled('/' + scope.namespace)}/{node}/"
        f"{_mangled(scope.topic(topic.name))}/{dds_type(topic.type)}/{type_hash(topic.type)}/{_QOS[topic.qos]}"
    )


def publishers(scope: Scope) -> str:
    """Matches the liveliness tokens of all publishers of a domain."""
    return f"@ros2_lv/{scope.domain}/*/*/*/MP/**"


def publisher_of(token: str) -> tuple[str, str]:
    """(node, full ROS name of its topic) of a publisher's token."""
    parts = token.split("/")
    return parts[8], parts[9].replace("%", "/")


def gid(token: str, key: str, proof: bytes) -> bytes:
    """16 bytes that name an endpoint: 4 from its token, the `proof` of its process, 8 from the data key it publishes
    under."""
    return hashlib.blake2b(token.encode(), digest_size=4).digest() + proof + mark(key)


def proof(stack: str, process: str) -> bytes:
    """4 bytes in the gid of every publisher of one process, also of one that was started anew. They are no secret."""
    return hashlib.blake2b(f"{stack}/{process}".encode(), digest_size=4).digest()


def proof_of(data: bytes) -> bytes:
    """The proof in an attachment; empty where it is not one of ours."""
    return data[21:25] if len(data) == 33 and data[25:29] == OURS else b""


def mark(key: str) -> bytes:
    """The last 8 bytes of the gid of our publishers under this key: `OURS`, 4 bytes of the key."""
    return OURS + hashlib.blake2b(key.encode(), digest_size=4).digest()


def astray(data: bytes, expected: bytes) -> bool:
    """Whether one of our publishers sent the message of this attachment under another key than that of the `mark`
    expected.

    For up to 1.5 s after a session has come back (its router hung for longer than the lease), Zenoh 1.10 delivers
    messages under each other's keys. Publishers that are not ours cannot be told so; their messages pass.
    """
    told = data[-len(expected) :]
    return told != expected and told.startswith(OURS)


def attachment(sequence: int, stamp: int, endpoint: bytes) -> bytes:
    """33 bytes: int64 sequence from 1, int64 source time [ns], length byte, 16-byte gid."""
    return struct.pack("<qqB16s", sequence, stamp, 16, endpoint)


def sender_of(data: bytes) -> str:
    """The endpoint that an attachment names; empty where it is not one of ours."""
    return data[17:].hex() if len(data) == 33 else ""


def parse_attachment(data: bytes) -> tuple[int, int]:
    """(sequence, source time [ns]) of an attachment; (0, 0) where it is not one of ours."""
    if len(data) != 33:
        return 0, 0
    sequence, stamp = struct.unpack_from("<qq", data)
    return sequence, stamp
