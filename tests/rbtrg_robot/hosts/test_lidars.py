"""Two LiDARs in a closed loop: a lane as wide as a rescue lane, and what a silent LiDAR does to the robot."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from hal.lidar.config import LidarConfig, only
from hal.robots import Robot, describe
from hal.scenes import Scene
from hal.types import NS, LidarScan, Sample
from rbtrg_robot import topics as t
from rbtrg_robot.config import StackConfig, load
from rbtrg_robot.hosts.lockstep import Lockstep
from rbtrg_robot.stages.navigation.goal import GoalState
from rbtrg_robot.wire.messages import stamp_of
from tests.rbtrg_robot.hosts.test_guard import by_hand

RESOLUTION = 0.02
WIDTH = 1.12


def ramps(x: np.ndarray) -> np.ndarray:
    """Of 15 deg."""
    return np.abs((np.maximum(x, 1.2) - 1.2 + 0.6) % 1.2 - 0.6) * math.tan(math.radians(15.0)) * (x < 3.6)


def pit(x: np.ndarray) -> np.ndarray:
    """Its near edge is nearer than the 1.9 m from which on the main LiDAR sees level ground."""
    return -0.6 * ((x >= 0.95) & (x < 1.5))


def plate(x: np.ndarray) -> np.ndarray:
    """Two kerbs of 0.2 m, one up and one down."""
    return 0.2 * ((x >= 1.0) & (x < 2.2))


def lane(ground: Callable[[np.ndarray], np.ndarray] = ramps, first: float = -1.5) -> Scene:
    """A lane 1.12 m wide from x = `first` on, with a fence around so that the odometry sees how far it came."""
    x = np.arange(first, 5.5, RESOLUTION)
    y = np.arange(-1.5, 1.5, RESOLUTION)
    height = np.tile(ground(x).astype(np.float32), (len(y), 1))
    wall = (np.abs(np.abs(y) - WIDTH / 2 - 0.03) < 0.03)[:, None] & ((x > first + 0.7) & (x < 4.8))[None, :]
    height[wall] = 0.6
    height[:4], height[-4:], height[:, :4], height[:, -4:] = 1.2, 1.2, 1.2, 1.2
    return Scene("lane", height, RESOLUTION, (first, -1.5), (0.0, 0.0, 0.0), {})


@pytest.fixture
def in_lane(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = lane()
    monkeypatch.setattr(StackConfig, "load_scene", lambda self: scene)


def stack(lidars: tuple[LidarConfig, ...], step: int = 4) -> Lockstep:
    """Sees every `step`-th firing of the main LiDAR."""
    return Lockstep(load(None, ["record=false", f"sim.lidar_step={step}"], lidars=lidars))


def mute(stack: Lockstep, name: str) -> None:
    """One LiDAR falls silent."""
    read = stack.robot.backend.read

    def without(now: int) -> list[Sample]:
        return [s for s in read(now) if not (isinstance(s, LidarScan) and s.name == name)]

    stack.robot.backend.read = without  # type: ignore[method-assign]


def moved(stack: Lockstep) -> float:
    return float(stack.newest[t.TRUTH].pose.pose.position.x)


def run(stack: Lockstep, seconds: float) -> None:
    end = stack.seconds + seconds
    while stack.seconds < end:
        stack.step()


@pytest.mark.usefixtures("in_lane")
def test_a_robot_without_a_head_lidar_starts_in_a_narrow_lane() -> None:
    with stack(only("xt16")) as made:
        made.wait_ready()
        run(made, 0.5)
        assert "taken for granted" in made.newest[t.MAP_STATUS].warning
        made.send_goal(4.0, 0.0)
        made.run_until(lambda: moved(made) > 0.8, 20.0, "a start")


@pytest.mark.usefixtures("in_lane")
def test_ground_ahead_is_seen_to_the_first_crest_and_a_silent_head_lidar_is_told() -> None:
    with stack(describe().lidars, step=1) as made:
        made.wait_ready()
        run(made, 1.5)
        patch = made.host.stage("elevation").map.window(0.9, 0.0, 0.5)
        x = patch.origin[0] + 0.04 * np.arange(patch.layers["trusted"].shape[1])
        y = patch.origin[1] + 0.04 * np.arange(patch.layers["trusted"].shape[0])
        strip = patch.layers["trusted"][np.ix_(np.abs(y) < 0.3, (x > 0.4) & (x < 1.4))]
        assert strip.mean() >= 0.95
        mute(made, "head")
        run(made, 1.5)
        assert "nothing from the head LiDAR" in made.newest[t.MAP_STATUS].warning
        assert made.newest[t.ROBOT_STATE].phase == "ready"


def pit_is_trusted(stack: Lockstep) -> bool:
    """Whether the map calls ground what nobody saw."""
    patch = stack.host.stage("elevation").map.window(1.2, 0.0, 0.1)
    return bool(((patch.layers["trusted"] > 0) & (patch.layers["elevation"] > -0.3)).any())


def test_a_robot_whose_head_lidar_never_spoke_does_not_drive_into_a_pit_before_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    scene = lane(pit)
    monkeypatch.setattr(StackConfig, "load_scene", lambda self: scene)
    with stack(describe().lidars) as made:
        mute(made, "head")
        made.wait_ready()
        run(made, 1.0)
        assert "the ground at the feet is not seen" in made.newest[t.MAP_STATUS].warning
        assert not pit_is_trusted(made)
        made.send_goal(4.0, 0.0)
        made.run_until(lambda: made.statuses[-1].state == "aborted", 8.0, "an end")
        assert made.statuses[-1].reason == "start_not_on_graph"
        assert "drive it by hand, slowly" in made.statuses[-1].detail
        assert abs(moved(made)) < 0.3
        assert made.newest[t.ROBOT_STATE].phase == "ready"


@pytest.mark.campaign
@pytest.mark.parametrize("creep", [0.0, 0.1])
def test_a_robot_whose_head_lidar_falls_silent_does_not_drive_into_a_pit_behind_it(
    creep: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whether its wheels feel edges or not."""
    own = Robot.capabilities
    monkeypatch.setattr(Robot, "capabilities", lambda self, name: replace(own(self, name), creep=creep))
    scene = lane(lambda x: pit(-x), first=-4.5)
    monkeypatch.setattr(StackConfig, "load_scene", lambda self: scene)
    with stack(describe().lidars, step=1) as made:
        made.wait_ready()
        run(made, 1.0)
        mute(made, "head")
        run(made, 1.0)
        assert "the ground at the feet is not seen" in made.newest[t.MAP_STATUS].warning
        made.send_goal(-3.5, 0.0)
        run(made, 0.1)
        end = made.seconds + (20.0 if creep == 0.0 else 80.0)
        while made.seconds < end and not GoalState(made.statuses[-1].state).terminal:
            run(made, 0.1)
            assert (
                moved(made) > (-0.74 if creep == 0.0 else -0.84)
            )  # its wheels stand before the pit, or feel its edge; one that turned beside it fell from -0.86 on
        assert (made.statuses[-1].state, made.statuses[-1].reason) == ("aborted", "no_route")
        reason = "drive it by hand, slowly" if creep == 0.0 else "the wheels felt an edge that goes down"
        assert reason in made.statuses[-1].detail
        assert not made.newest[t.ROBOT_STATE].estop


def test_a_robot_whose_head_lidar_falls_silent_while_it_drives_stops_before_a_pit(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    near = 1.5  # nearer than what the main LiDAR sees of level ground, further than the head's saw from the start
    scene = lane(lambda x: pit(x - near + 0.95))
    monkeypatch.setattr(StackConfig, "load_scene", lambda self: scene)
    with stack(describe().lidars) as made:
        made.wait_ready()
        made.send_goal(4.0, 0.0)
        made.run_until(lambda: moved(made) > 0.05, 20.0, "a start")
        mute(made, "head")
        furthest = 0.0
        for _ in range(35):
            run(made, 0.1)
            furthest = max(furthest, moved(made))
        assert 0.5 < furthest < near - 0.3  # its front wheels stand before the pit
        assert "the ground at the feet is not seen" in made.newest[t.MAP_STATUS].warning
        assert not made.newest[t.ROBOT_STATE].estop


@pytest.mark.usefixtures("in_lane")
def test_the_head_lidar_carries_the_robot_on_where_the_main_one_is_silent() -> None:
    with stack(describe().lidars) as made:
        made.wait_ready()
        run(made, 0.5)
        assert "taken for granted" not in made.newest[t.MAP_STATUS].warning
        made.send_goal(4.0, 0.0)
        made.run_until(lambda: moved(made) > 0.8, 20.0, "a start")
        mute(made, "main")
        run(made, 2.0)
        health: Any = made.newest[t.ODOM_HEALTH]
        assert (health.health, "the main LiDAR is silent" in health.reason) == ("degraded", True)
        assert "nothing from the main LiDAR" in made.newest[t.MAP_STATUS].warning
        run(made, 1.5)
        held = made.newest[t.ODOM].pose.pose.position
        assert abs(held.x - moved(made)) < 0.15
        assert made.newest[t.ROBOT_STATE].hold == ""


@pytest.mark.campaign
def test_over_kerbs_in_a_narrow_lane_odometry_keeps_its_height(monkeypatch: pytest.MonkeyPatch) -> None:
    """The main LiDAR sees little ground there, and a wheel that climbs a face tells a velocity that it does not
    have."""
    scene = lane(plate)
    monkeypatch.setattr(StackConfig, "load_scene", lambda self: scene)
    with stack(describe().lidars) as robot:
        robot.wait_ready()
        true, told = [], []
        while robot.newest[t.TRUTH].pose.pose.position.x < 3.0:
            assert robot.seconds < 16.0
            by_hand(robot, 0.04, 0.45)
            for rows, topic in ((true, t.TRUTH), (told, t.ODOM)):
                rows.append((stamp_of(robot.newest[topic]) / NS, robot.newest[topic].pose.pose.position.z))
    stamps, high = np.array(told).T
    assert high.max() > 0.5, "it was up there"
    assert np.abs(high - np.interp(stamps, *np.array(true).T)).max() < 0.03, "0.114 before"
