"""The tracker as a stage: it drives on fresh inputs only, whatever it was sent."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from hal.safety.monitors import TRACKER_STALE, taken_out
from hal.safety.trunk import STANDING_TIME, TILT_RATE
from hal.types import NS
from rbtrg_robot import topics as t
from rbtrg_robot.config import load
from rbtrg_robot.stages import tracker
from rbtrg_robot.stages.looking import HOLD_TIME
from rbtrg_robot.topics import Topic
from rbtrg_robot.wire.convert import odometry_msg, rpy_quaternion
from rbtrg_robot.wire.messages import header
from tests.rbtrg_robot.hearsay import map_offset

STILL = rpy_quaternion((0.0, 0.0, 0.0))


class Inputs:
    """Everything the tracker relies on, at 50 Hz; topics in `silent` stop."""

    def __init__(self, *, placed: bool = True) -> None:
        self.stage = tracker.build(load(None, [], scene="flat"))
        self.now = 0
        self.silent: set[Topic] = set()
        self.late: dict[Topic, float] = {}
        """[s] by which the stamps of a topic are older than its messages."""
        self.state: Any = None
        self.pitches: list[tuple[int, float]] = []
        """Tilts that were commanded: when [ns], nose down [rad]."""
        if placed:
            self.stage.on(t.TF_STATIC, map_offset())

    def path(self, path_id: str) -> None:
        """One metre straight ahead."""
        line = np.linspace(0.0, 1.0, 51)
        zero, speed = 0 * line, 0 * line + 0.5
        fields = {"x": line, "y": zero, "z": zero, "yaw": zero, "speed": speed}
        self.stage.on(t.PATH_COMMAND, t.PATH_COMMAND.kind(id=path_id, **fields))

    def _told(self, topic: Topic) -> int:
        return max(0, self.now - round(self.late.get(topic, 0.0) * NS))

    def run(self, seconds: float) -> list[float]:
        """Forward speeds [m/s] that were commanded."""
        speeds = []
        for _ in range(round(seconds * 50)):
            self.now += NS // 50
            for topic in (t.POSE, t.ODOM):
                if topic not in self.silent:
                    pose = odometry_msg(self._told(topic), np.zeros(3), STILL, np.zeros(3), np.zeros(3))
                    self.stage.on(topic, pose)
            for topic in (t.MAP_STATUS, t.GOAL_STATUS):
                if topic not in self.silent:
                    self.stage.on(topic, topic.kind(header=header(self._told(topic), "map")))
            for topic, message in self.stage.tick(self.now):
                if topic is t.CMD_VEL:
                    speeds.append(message.twist.linear.x)
                elif topic is t.TRUNK:
                    self.pitches.append((self.now, message.pitch))
                else:
                    self.state = message
        return speeds


@pytest.mark.parametrize("path_id", ["", "goal/1"])
@pytest.mark.parametrize(
    ("topic", "limit"), [(t.POSE, 0.12), (t.ODOM, 0.8), (t.MAP_STATUS, 1.2), (t.GOAL_STATUS, 1.0)]
)
def test_no_path_is_driven_on_old_inputs_whatever_its_id(path_id: str, topic: Topic, limit: float) -> None:
    world = Inputs()
    world.run(0.1)
    world.path(path_id)
    assert max(world.run(1.0)) > 0.3
    world.silent = {topic}
    speeds, ticks = world.run(4.0), round(50 * limit)
    assert min(speeds[: ticks - 1]) > 0.0
    assert set(speeds[ticks:]) == {0.0}
    assert world.state.phase == "stopped"
    assert topic.name in world.state.hold


@pytest.mark.parametrize(
    ("topic", "limit"), [(t.POSE, 0.12), (t.ODOM, 0.8), (t.MAP_STATUS, 1.2), (t.GOAL_STATUS, 1.0)]
)
def test_what_comes_in_time_and_tells_of_long_ago_is_old(topic: Topic, limit: float) -> None:
    """A process that repeats what it said last, or a link that delays everything, came in time before."""
    world = Inputs()
    world.run(0.1)
    world.path("goal/1")
    assert max(world.run(1.0)) > 0.3
    world.late = {topic: 0.9 * limit}
    assert min(world.run(0.5)) > 0.0
    world.late = {topic: 1.1 * limit}
    assert set(world.run(0.5)) == {0.0}
    assert f"{topic.name} tells of " in world.state.hold
    with taken_out(TRACKER_STALE.name):
        assert max(world.run(0.5)) > 0.0


def test_no_path_is_driven_on_a_pose_from_the_future() -> None:
    world = Inputs()
    world.path("goal/1")
    assert max(world.run(1.0)) > 0.3
    world.silent = {t.POSE}
    later = world.now + 60 * NS
    for _ in range(10):  # they come in time, but for their stamps
        world.stage.on(t.POSE, odometry_msg(later, np.zeros(3), STILL, np.zeros(3), np.zeros(3)))
        assert set(world.run(0.02)) == {0.0}
    assert "ahead of the clock" in world.state.hold
    world.silent = set()
    assert max(world.run(1.0)) > 0.3


def test_no_path_is_driven_while_localization_is_lost() -> None:
    world = Inputs()
    world.path("goal/1")
    assert max(world.run(1.0)) > 0.3
    world.stage.on(t.ODOM_HEALTH, t.ODOM_HEALTH.kind(health="lost", reason="no scan fits"))
    assert set(world.run(1.0)) == {0.0}
    assert world.state.hold == "localization lost: no scan fits"
    world.stage.on(t.ODOM_HEALTH, t.ODOM_HEALTH.kind(health="good"))
    assert max(world.run(1.0)) > 0.3


def test_no_path_is_driven_before_the_start_in_the_map_is_known() -> None:
    world = Inputs(placed=False)
    world.path("goal/1")
    assert set(world.run(1.0)) == {0.0}
    assert world.state.hold == "no /tf_static yet"


def look(world: Inputs, path_id: str = "goal/look-1", pitch: float = 0.25) -> None:
    world.stage.on(t.PATH_COMMAND, t.PATH_COMMAND.kind(id=path_id, look=pitch))


def test_a_look_tilts_the_trunk_and_is_done_when_it_is_level_again() -> None:
    world = Inputs()
    world.path("goal/1")
    assert max(world.run(1.0)) > 0.3
    look(world)
    speeds = world.run(0.8)
    braked = world.now - (len(speeds) - 1 - np.flatnonzero(speeds)[-1]) * NS // 50
    assert world.state.phase == "looking"
    world.run(2.0)
    assert world.state.phase == "done"
    times = [now - braked for now, _ in world.pitches]
    assert {pitch for _, pitch in world.pitches} == {0.25}
    assert times[0] >= STANDING_TIME * NS, "the gate refuses it before"
    assert (times[-1] - times[0]) / NS == pytest.approx(0.25 / TILT_RATE + HOLD_TIME, abs=0.03)
    look(world)  # a repeat of the order
    world.run(0.5)
    assert world.pitches[-1][0] - braked == times[-1]


@pytest.mark.parametrize("trouble", ["path", "stand", "old input"])
def test_a_look_ends_with_another_order_and_on_old_inputs(trouble: str) -> None:
    world = Inputs()
    world.run(1.0)
    look(world)
    world.run(0.2)
    assert world.pitches
    if trouble == "path":
        world.path("goal/2")
    elif trouble == "stand":
        world.stage.on(t.PATH_COMMAND, t.PATH_COMMAND.kind(id=""))
    else:
        world.silent = {t.POSE}
        world.run(0.2)  # until its pose is old
    world.pitches = []
    world.run(0.3)
    assert world.pitches == []
    assert world.state.phase != "looking"


@pytest.mark.parametrize("pitch", [np.inf, 1e38, -0.1, np.nan])
def test_a_look_that_nobody_can_do_is_refused(pitch: float) -> None:
    world = Inputs()
    world.run(1.0)
    look(world, pitch=pitch)
    world.run(1.0)
    assert world.pitches == []
    assert "path refused: nobody looks down by" in world.state.hold
