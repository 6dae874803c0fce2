"""Messages and conversions keep every value, and broken bytes are refused."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hal.robots.go2w.facts import MOTORS
from hal.types import POINT_DTYPE, ImuSample, JointSample, LidarScan
from mapping.elevation.exchange import PATCH_LAYERS, MapPatch
from rbtrg_robot import topics
from rbtrg_robot.config import load
from rbtrg_robot.scope import Scope
from rbtrg_robot.wire import convert, messages
from rbtrg_robot.wire import keys as wire
from rbtrg_robot.wire.messages import MessageError, decode, encode


@pytest.mark.parametrize("topic", topics.TOPICS, ids=lambda t: t.name)
def test_every_topic_has_a_type_that_survives_the_wire(topic: topics.Topic) -> None:
    message = topic.kind()
    again = decode(encode(message), topic.kind)
    assert encode(again) == encode(message)
    assert messages.type_hash(topic.type).startswith("RIHS01_")
    assert messages.definition(topic.type)


@pytest.mark.parametrize("topic", topics.TOPICS, ids=lambda t: t.name)
def test_the_stamp_is_found_in_the_bytes(topic: topics.Topic) -> None:
    message = topic.kind()
    if hasattr(message, "header"):
        message.header = messages.header(12_345_678_901, "map")
    elif hasattr(message, "clock"):
        message.clock = messages.time_msg(12_345_678_901)
    assert messages.stamp_in(encode(message), topic.type) == messages.stamp_of(message)


@pytest.mark.parametrize("second", [0, 2**31 - 1, -(2**31)])
def test_a_stamp_with_too_many_nanoseconds_can_be_sent_again(second: int) -> None:
    message = topics.CLOCK.kind(clock=messages.Time(second, 2**32 - 1))
    stamp = messages.stamp_of(message)
    assert stamp == messages.stamp_in(encode(message), topics.CLOCK.type)
    again = topics.CLOCK.kind(clock=messages.time_msg(stamp))
    assert messages.stamp_of(decode(encode(again), topics.CLOCK.kind)) == stamp


def test_hashes_are_those_of_ros() -> None:
    known = "RIHS01_9198cabf7da3796ae6fe19c4cb3bdd3525492988c70522628af5daa124bae2b5"
    assert messages.type_hash("sensor_msgs/msg/PointCloud2") == known


def test_topic_names_are_unique_and_owned_by_processes() -> None:
    from rbtrg_robot.processes import BY_NAME, SUPERVISOR

    assert len({t.name for t in topics.TOPICS}) == len(topics.TOPICS)
    assert {t.owner for t in topics.TOPICS} - {""} <= {*BY_NAME, SUPERVISOR, topics.STACK}


def test_what_moves_a_robot_is_never_safe_to_replay() -> None:
    unsafe = {t.name for t in topics.TOPICS if not t.safe_to_replay}
    assert unsafe == {
        "/robot/command",
        "/robot/stop",
        "/teleop/cmd_vel",
        "/teleop/trunk",
        "/guard/limits",
        "/mission/request",
        "/mission/order",
        "/operator/presence",
        "/cmd_vel",
        "/cmd_trunk",
        "/goal/request",
        "/goal_pose",
        "/dock/pose",
        "/elevation_map/closed",
        "/initialpose",
        "/elevation_map/prior",
        "/track/path",
        "/areas",
        "/areas/request",
    }


def test_imu_round_trip() -> None:
    sample = ImuSample(1_234_567_890_123, np.array([0.1, -0.2, 0.3]), np.array([0.0, 0.5, 9.81]))
    again = convert.imu_sample(decode(encode(convert.imu_msg(sample)), topics.IMU.kind))
    assert again.stamp == sample.stamp
    np.testing.assert_array_equal(again.gyro, sample.gyro)
    np.testing.assert_array_equal(again.accel, sample.accel)


def test_joint_round_trip_and_foreign_names() -> None:
    values = np.arange(16.0)
    sample = JointSample(7, values, values + 1, values + 2)
    message = decode(encode(convert.joint_msg(sample)), topics.JOINTS.kind)
    assert tuple(message.name) == MOTORS
    np.testing.assert_array_equal(convert.joint_sample(message).effort, values + 2)
    message.name[0] = "elbow"
    with pytest.raises(convert.LayoutError):
        convert.joint_sample(message)


def test_scan_round_trip_and_foreign_fields() -> None:
    points = np.zeros(5, POINT_DTYPE)
    points["x"] = np.arange(5)
    points["time"] = np.linspace(0, 0.1, 5)
    points["ring"] = np.arange(5)
    message = decode(encode(convert.scan_msg(LidarScan(99, points))), topics.POINTS.type)
    again = convert.lidar_scan(message)
    assert again.stamp == 99
    np.testing.assert_array_equal(again.points, points)
    message.fields[0].name = "range"
    with pytest.raises(convert.LayoutError):
        convert.lidar_scan(message)


@settings(max_examples=30, deadline=None)
@given(rows=st.integers(1, 7), cols=st.integers(1, 7), row=st.integers(-50, 50), col=st.integers(-50, 50))
def test_patch_round_trip(rows: int, cols: int, row: int, col: int) -> None:
    rng = np.random.default_rng(rows * 8 + cols)
    layers = {name: rng.normal(size=(rows, cols)).astype(np.float32) for name in PATCH_LAYERS}
    patch = MapPatch((col * 0.04, row * 0.04), 0.04, 5, 3, layers)
    again = convert.map_patch(decode(encode(convert.patch_msg(patch)), topics.MAP_UPDATE.kind), 3)
    assert again.cell == patch.cell
    assert again.epoch == 3
    for name in PATCH_LAYERS:
        np.testing.assert_array_equal(again.layers[name], layers[name])


def test_grid_map_counts_from_the_far_corner() -> None:
    """grid_map's first element is the cell with the largest x and y (its index 0, 0)."""
    elevation = np.array([[1, 2, 3], [4, 5, 6]], np.float32)  # rows along y, columns along x
    layers = dict.fromkeys(PATCH_LAYERS, elevation)
    message = convert.patch_msg(MapPatch((0.0, 0.0), 0.5, 0, 0, layers))
    assert message.data[0].data[0] == 6
    # Column-major over x first: the next element has one x less, same y.
    assert message.data[0].data[1] == 5
    assert (message.info.length_x, message.info.length_y) == (1.5, 1.0)
    assert (message.info.pose.position.x, message.info.pose.position.y) == (0.5, 0.25)


@settings(max_examples=200, deadline=None)
@given(st.binary(max_size=400), st.sampled_from(topics.TOPICS))
def test_broken_bytes_are_refused_with_our_error(data: bytes, topic: topics.Topic) -> None:
    for head in (b"", b"\x00\x01\x00\x00"):  # with the encapsulation the bytes get as far as the fields
        try:
            decoded = decode(head + data, topic.kind)
        except MessageError:
            continue
        assert type(decoded) is topic.kind


def test_attachment_is_what_rmw_zenoh_reads() -> None:
    data = wire.attachment(3, 17, bytes(range(16)))
    assert len(data) == 33
    assert data[:8] == (3).to_bytes(8, "little")
    assert data[16] == 16
    assert data[17:] == bytes(range(16))
    assert wire.parse_attachment(data) == (3, 17)
    assert wire.parse_attachment(b"short") == (0, 0)


def test_keys_are_those_of_rmw_zenoh() -> None:
    key = wire.key(topics.POINTS, Scope())
    assert (
        key
        == f"0/lidar/main/points/sensor_msgs::msg::dds_::PointCloud2_/{messages.type_hash(topics.POINTS.type)}"
    )
    token = wire.endpoint_token(Scope(), "abc", "robot", topics.POINTS, 4, "MP")
    assert token.startswith(
        "@ros2_lv/0/abc/0/4/MP/%/%/robot/%lidar%main%points/sensor_msgs::msg::dds_::PointCloud2_/"
    )
    assert all(token.split("/"))


def test_a_robot_with_a_name_has_it_as_its_namespace_as_rmw_zenoh_writes_one() -> None:
    a = Scope.of(3, "a")
    hashed = messages.type_hash(topics.ODOM.type)
    assert wire.key(topics.ODOM, a) == f"3/a/odom/nav_msgs::msg::dds_::Odometry_/{hashed}"
    assert wire.node_token(a, "abc", "tracker") == "@ros2_lv/3/abc/0/0/NN/%/%a/tracker"
    assert wire.endpoint_token(a, "abc", "robot", topics.ODOM, 4, "MS").startswith(
        "@ros2_lv/3/abc/0/4/MS/%/%a/robot/%a%odom/nav_msgs::msg::dds_::Odometry_/"
    )
    assert Scope.of(3, load().robot) == Scope(3), "a robot that was given no name"


def test_yaw_and_tilt_of_quaternions() -> None:
    q = convert.quaternion(convert.rpy_quaternion((0.0, 0.0, 1.2)))
    assert convert.yaw_of(q) == pytest.approx(1.2)
    assert convert.up_tilt(q) == pytest.approx(0.0, abs=1e-6)
    q = convert.quaternion(convert.rpy_quaternion((0.3, 0.0, -2.0)))
    assert convert.up_tilt(q) == pytest.approx(0.3, abs=1e-6)
