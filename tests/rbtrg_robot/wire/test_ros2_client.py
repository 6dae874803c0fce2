"""A ROS 2 client that is not ours sees the robot as a ROS graph: topics, types, data, latched messages for late
joiners, goals."""

from __future__ import annotations

import json
import os
import subprocess
import threading
from pathlib import Path

import numpy as np
import pytest
import zenoh
from zenoh import ext
from zenoh.handlers import Callback

from hal.types import POINT_DTYPE, ImuSample, LidarScan
from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.scope import Scope
from rbtrg_robot.wire.bus import Bus
from rbtrg_robot.wire.convert import BASE, IMU, LIDAR, imu_msg, odometry_msg, scan_msg, transform_msg
from rbtrg_robot.wire.keys import key
from rbtrg_robot.wire.session import session_config
from tests.rbtrg_robot.wire.ros2_files import client_command, write_definitions
from tools.bench.ports import free_endpoint

pytest.importorskip("zenoh_ros2_sdk")
STILL = (0.0, 0.0, 0.0)
LEVEL = (0.0, 0.0, 0.0, 1.0)


@pytest.fixture
def endpoint() -> str:
    """A free loopback endpoint."""
    return free_endpoint()


@pytest.fixture
def definitions(tmp_path: Path) -> Path:
    """Our topics' types as .msg files."""
    return write_definitions(tmp_path)


def test_an_independent_client_discovers_reads_joins_late_and_sends_a_goal(
    definitions: Path, endpoint: str
) -> None:
    port = endpoint.rpartition(":")[2]
    with Bus(endpoint, "supervisor", router=True), Bus(endpoint, "robot") as robot:
        robot.subscribe([t.GOAL_POSE])
        mounts = [transform_msg(0, BASE, child, STILL, LEVEL) for child in (LIDAR, IMU)]
        robot.publish(t.TF_STATIC, msg.TFMessage(transforms=mounts), 0)
        client = subprocess.Popen(
            client_command(port, definitions, 1.5, -0.5),
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env={**os.environ, "HOME": str(definitions)},
        )
        limit = threading.Timer(60.0, client.kill)
        limit.start()
        goals: list[msg.PoseStamped] = []
        points = np.zeros(5, POINT_DTYPE)
        stamp = 0
        while client.poll() is None:
            stamp += 1
            robot.publish(t.ODOM, odometry_msg(stamp, (2.5, 0.0, 0.0), LEVEL, STILL, STILL), stamp)
            robot.publish(t.IMU, imu_msg(ImuSample(stamp, np.zeros(3), np.array([0.0, 0.0, 9.81]))), stamp)
            robot.publish(t.ROUTE, msg.Path(poses=[msg.PoseStamped()] * 3), stamp)
            robot.publish(t.POINTS, scan_msg(LidarScan(stamp, points)), stamp)
            goals += [received.decode() for received in robot.take(0.05)]
        out, err = client.communicate()
        limit.cancel()
    assert client.returncode == 0, err
    found = json.loads(out.splitlines()[-1])
    assert (
        found["topics"].items()
        >= {topic.name: [topic.type] for topic in (t.ODOM, t.TF_STATIC, t.GOAL_POSE)}.items()
    )
    assert found["got"] == {
        "/odom": 2.5,
        "/imu/data": 9.81,
        "/lidar/main/points": [5, 5 * POINT_DTYPE.itemsize],
        "/tf_static": [LIDAR, IMU],
        "/plan/path": 3,
    }, err
    assert (goals[0].pose.position.x, goals[0].pose.position.y, goals[0].header.frame_id) == (
        1.5,
        -0.5,
        "map",
    )


@pytest.mark.parametrize("topic", [t.TF_STATIC, t.ROUTE], ids=lambda x: x.name)
def test_a_late_advanced_subscriber_of_plain_zenoh_gets_what_is_latched(
    topic: t.Topic, endpoint: str
) -> None:
    """rmw_zenoh's transient-local subscription. The client above finds the latched publishers of topics without an
    inner slash only."""
    came = threading.Event()
    with Bus(endpoint, "supervisor", router=True), Bus(endpoint, "robot") as robot:
        robot.publish(topic, topic.kind(), 0)
        with zenoh.open(session_config(endpoint, router=False)) as session:
            history = ext.HistoryConfig(detect_late_publishers=True, max_samples=1)
            handler = Callback(lambda _sample: came.set(), indirect=False)
            held = ext.declare_advanced_subscriber(session, key(topic, Scope()), handler, history=history)
            assert came.wait(10.0)
            del held
