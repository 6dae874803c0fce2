"""From verdicts to what is told, in a room that looks the same from two sides."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mapping.elevation.exchange import MapPatch
from mapping.elevation.sensor import XT16
from rbtrg_robot import msg
from rbtrg_robot.stages.location import LOOK_SCANS, Location, State, pose_of
from rbtrg_robot.stages.navigation.reasons import Reason, unlocated
from rbtrg_robot.wire.convert import MAP, odometry_msg, point, yaw_quaternion
from rbtrg_robot.wire.frames import MapFrame, offset_of
from rbtrg_robot.wire.messages import header
from tests.mapping.relocalise.rooms import BELOW, floor, room, seen_from

PLACE = (1.0, -0.5, 0.5)
"""Where the robot stands in the room."""


def patch() -> MapPatch:
    shape = (150, 200)
    flat = np.zeros(shape, np.float32)
    ones = np.ones(shape, np.float32)
    layers = {"elevation": flat, "variance": ones, "trusted": ones, "upper_bound": flat, "source": 2 * ones}
    return MapPatch((-4.0, -3.0), 0.04, 1, 0, layers)


def odom(x: float = 2.0, y: float = 3.0, yaw: float = 0.1, speed: float = 0.0) -> msg.Odometry:
    turned = np.array([0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2)])
    return odometry_msg(1, np.array([x, y, BELOW]), turned, np.array([speed, 0.0, 0.0]), np.zeros(3))


def searching(hint: tuple[float, float, float], cloud: np.ndarray | None = None) -> Location:
    made = room(4.0, 3.0) if cloud is None else cloud
    return Location.begin("hall.npz", [patch()], made.astype(np.float32), hint)


def scans(location: Location, seen: np.ndarray, message: msg.Odometry, count: int = LOOK_SCANS) -> None:
    for _ in range(count):
        location.scan(message, [(XT16, seen)], BELOW)


def pose(x: float, y: float, yaw: float) -> msg.PoseWithCovarianceStamped:
    message = msg.PoseWithCovarianceStamped(header=header(1, MAP))
    message.pose.pose.position, message.pose.pose.orientation = point((x, y, 0.0)), yaw_quaternion(yaw)
    return message


def settled(location: Location) -> bool:
    frame = MapFrame()
    assert location.offset is not None
    frame.x, frame.y, frame.yaw = location.offset
    return location.settle(frame)


def test_two_places_that_look_the_same_are_told_until_an_operator_decides() -> None:
    location = searching((50.0, 0.0, 0.0))
    assert location.state is State.SEARCHING
    seen = seen_from(room(4.0, 3.0), *PLACE)
    scans(location, seen, odom(), LOOK_SCANS - 1)
    assert location.state is State.SEARCHING
    scans(location, seen, odom(), 1)
    assert location.state is State.AMBIGUOUS
    assert location.words.startswith("ambiguous in hall.npz between ")
    told = location.report()["candidates"].reshape(-1, 3)
    np.testing.assert_allclose(np.sort(told[:, 0]), [-1.0, 1.0], atol=0.03)
    status = msg.MapStatus(**location.report())
    why = unlocated(status)
    assert why is not None
    assert why[0] is Reason.UNLOCATED
    assert "set the pose" in why[1]
    # The same view again tells nothing new; nor does one while the robot moves.
    scans(location, seen, odom())
    scans(location, seen, odom(x=4.0, speed=0.3))
    assert location.state is State.AMBIGUOUS
    # An operator who is half a metre off is helped to the right one.
    location.tell(pose(-1.4, 0.3, PLACE[2] - math.pi + 0.2), odom())
    assert location.state is State.SEARCHING
    scans(location, seen, odom())
    assert location.state is State.FOUND
    assert unlocated(msg.MapStatus(**location.report())) is not None
    assert not location.settle(MapFrame())
    assert settled(location)
    assert location.state is State.LOCATED
    assert unlocated(msg.MapStatus(**location.report())) is None
    assert location.offset is not None
    x, y, yaw = pose_of(location.offset, odom())
    assert (x, y) == pytest.approx((-1.0, 0.5), abs=0.03)
    assert math.remainder(yaw - PLACE[2] + math.pi, 2 * math.pi) == pytest.approx(0.0, abs=0.01)


def test_the_configured_start_decides_between_places_that_look_the_same() -> None:
    location = searching(offset_of((1.2, -0.4, 0.4), odom()))
    scans(location, seen_from(room(4.0, 3.0), *PLACE), odom())
    assert location.state is State.FOUND
    assert "the pose that was set decided" in location.words


def test_an_operator_is_believed_where_the_scans_show_nothing() -> None:
    location = searching((0.0, 0.0, 0.0))
    scans(location, seen_from(room(2.5, 1.5), 0.5, 0.2, 0.7), odom())
    assert location.state is State.NOT_FOUND
    location.tell(pose(1.0, 1.0, 0.0), odom())
    scans(location, seen_from(room(2.5, 1.5), 0.5, 0.2, 0.7), odom())
    assert location.state is State.FOUND
    assert location.offset == pytest.approx(offset_of((1.0, 1.0, 0.0), odom()))
    assert "told where the robot stands" in location.words
    assert settled(location)


def test_without_a_cloud_or_without_walls_the_start_pose_is_taken_and_that_is_said() -> None:
    location = searching((0.0, 0.0, 0.0), np.empty((0, 3)))
    assert location.state is State.ASSUMED
    assert "cannot be searched" in location.words
    location.tell(pose(1.0, 1.0, 0.0), odom())
    assert location.state is State.TOLD
    open_ground = searching((0.0, 0.0, 0.0))
    scans(open_ground, seen_from(floor(4.0, 3.0), 0.0, 0.0, 0.0), odom())
    assert open_ground.state is State.ASSUMED
    assert unlocated(msg.MapStatus(**open_ground.report())) is None


def test_a_pose_that_is_no_pose_and_one_of_a_moving_robot_are_not_taken() -> None:
    location = searching((0.0, 0.0, 0.0))
    location.tell(pose(math.nan, 0.0, 0.0), odom())
    location.tell(pose(1.0, 0.0, 0.0), odom(speed=0.5))
    assert location.words == "searching the robot in hall.npz"
