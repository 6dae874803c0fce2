"""Our CDR is that of rosbags, both ways, for every topic."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from rosbags.interfaces import Nodetype
from rosbags.serde import SerdeError

from rbtrg_robot import topics
from rbtrg_robot.wire.messages import CODEC, STORE, MessageError, decode, encode

TYPES = sorted({topic.type for topic in topics.TOPICS})
WHOLE = {
    "int8": 7,
    "int16": 15,
    "int32": 31,
    "int64": 63,
    "uint8": 8,
    "byte": 7,
    "char": 8,
    "uint16": 16,
    "uint32": 32,
    "uint64": 64,
}


def drawn(desc: Any, random: np.random.Generator) -> Any:
    """A random value of a field."""
    node, detail = desc
    if node == Nodetype.NAME:
        fields = STORE.fielddefs[detail][1]
        return STORE.types[detail](*(drawn(inner, random) for _, inner in fields))
    if node == Nodetype.BASE:
        name = detail[0]
        if name == "string":
            return "".join(random.choice(list("abcä€ "), random.integers(6)))
        if name == "bool":
            return bool(random.integers(2))
        return (
            int(random.integers(2 ** min(WHOLE[name], 62)))
            if name in WHOLE
            else float(np.float32(random.normal()))
        )
    inner, length = detail
    count = length if node == Nodetype.ARRAY else int(random.integers(4))
    values = [drawn(inner, random) for _ in range(count)]
    return np.array(values, inner[1][0]) if inner[0] == Nodetype.BASE and inner[1][0] != "string" else values


@pytest.mark.parametrize("name", TYPES)
def test_the_bytes_are_those_of_rosbags(name: str) -> None:
    random = np.random.default_rng(5)
    for _ in range(30):
        message = drawn((Nodetype.NAME, name), random)
        payload = encode(message)
        assert payload == bytes(STORE.serialize_cdr(message, name))
        assert bytes(STORE.serialize_cdr(CODEC.decode(payload, name), name)) == payload


@pytest.mark.parametrize("name", TYPES)
def test_bytes_that_rosbags_refuses_are_refused(name: str) -> None:
    random = np.random.default_rng(6)
    payload = encode(drawn((Nodetype.NAME, name), random))
    for cut in {*range(0, len(payload) - 4, max(1, len(payload) // 20))}:
        with pytest.raises(MessageError):
            decode(payload[:cut], name)
    with pytest.raises(MessageError, match="too many"):
        decode(payload + bytes(8), name)


def test_arrays_of_the_wrong_size_are_not_encoded() -> None:
    imu = topics.IMU.kind()
    imu.orientation_covariance = np.zeros(8)
    with pytest.raises(SerdeError, match="expected 9"):
        encode(imu)
    joints = topics.JOINTS.kind()
    joints.position = np.zeros((2, 3))
    with pytest.raises(SerdeError, match="expected 8"):
        encode(joints)


def test_arrays_of_a_message_are_aligned_and_read_only() -> None:
    joints = topics.JOINTS.kind(name=["a"], position=np.arange(3.0))
    again = decode(encode(joints), topics.JOINTS.kind)
    assert again.position.flags.aligned
    assert not again.position.flags.writeable
    assert CODEC.decode(encode(joints), topics.JOINTS.type).position.tolist() == [0.0, 1.0, 2.0]
