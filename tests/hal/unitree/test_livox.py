"""livox_ros_driver2's CustomMsg: our bytes against the DDS library's, and over loopback."""

from __future__ import annotations

import os
import time

import numpy as np
import pytest

from hal.lidar.config import only
from hal.types import NS
from hal.unitree.config import UnitreeConfig
from hal.unitree.connect import open_link
from hal.unitree.link import CUSTOM
from hal.unitree.livox import POINT, decode_livox, encode_livox
from tests.hal.unitree.test_lidars import ring

idl = pytest.importorskip("hal.unitree.idl", reason="cyclonedds is not installed")
DOMAIN = 221 + os.getpid() % 10
TOPIC = "rt/livox/lidar"


@pytest.mark.parametrize("frame", ["livox_frame", "l", ""])
def test_our_bytes_are_those_of_the_library(frame: str) -> None:
    data = encode_livox(1_700_000_000 * NS + 5, frame, ring())
    theirs = idl.CustomMsg.__idl__.deserialize(data)
    cloud = decode_livox(data)
    assert (theirs.header.frame_id, theirs.timebase, theirs.point_num) == (frame, cloud.stamp, 200)
    for name in POINT.names or ():
        want = np.array([getattr(point, name) for point in theirs.points]).astype(POINT[name])
        np.testing.assert_array_equal(cloud.points[name], want, name)


def test_both_types_of_one_topic_are_taken_and_named_on_the_network() -> None:
    from cyclonedds.domain import DomainParticipant
    from cyclonedds.pub import DataWriter
    from cyclonedds.topic import Topic

    link = open_link("lo", DOMAIN, UnitreeConfig(lidars=only("mid360")))
    try:
        driver = DomainParticipant(DOMAIN)
        elsewhere = DataWriter(driver, Topic(driver, "rt/livox/other", idl.PointCloud2))
        writer = DataWriter(driver, Topic(driver, TOPIC, idl.CustomMsg))
        data = encode_livox(7 * NS, "livox_frame", ring())
        got: list[bytes] = []
        end = time.monotonic() + 20.0
        while not got:  # best effort: nothing is kept for a reader that was not found yet
            assert time.monotonic() < end
            writer.write(idl.CustomMsg.of(data))
            got = link.take(TOPIC + CUSTOM)
        assert got[0][: len(data)] == data
        assert link.take(TOPIC) == []
        found = {"rt/livox/other": "PointCloud2", TOPIC: "CustomMsg"}
        assert link.clouds() == found
        del elsewhere, writer, driver
        while link.clouds():
            assert time.monotonic() < end
    finally:
        link.close()
