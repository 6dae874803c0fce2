"""The tracker as a stage: it drives on fresh inputs only, whatever it was sent."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from hal.types import NS
from rbtrg_robot import topics as t
from rbtrg_robot.config import load
from rbtrg_robot.stages import tracker
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
        self.state: Any = None
        if placed:
            self.stage.on(t.TF_STATIC, map_offset())

    def path(self, path_id: str) -> None:
        """One metre straight ahead."""
        line = np.linspace(0.0, 1.0, 51)
        zero, speed = 0 * line, 0 * line + 0.5
        fields = {"x": line, "y": zero, "z": zero, "yaw": zero, "speed": speed}
        self.stage.on(t.PATH_COMMAND, t.PATH_COMMAND.kind(id=path_id, **fields))

    def run(self, seconds: float) -> list[float]:
        """Forward speeds [m/s] that were commanded."""
        speeds = []
        for _ in range(round(seconds * 50)):
            self.now += NS // 50
            pose = odometry_msg(self.now, np.zeros(3), STILL, np.zeros(3), np.zeros(3))
            for topic in (t.POSE, t.ODOM):
                if topic not in self.silent:
                    self.stage.on(topic, pose)
            for topic in (t.MAP_STATUS, t.GOAL_STATUS):
                if topic not in self.silent:
                    self.stage.on(topic, topic.kind(header=header(self.now, "map")))
            for topic, message in self.stage.tick(self.now):
                if topic is t.CMD_VEL:
                    speeds.append(message.twist.linear.x)
                else:
                    self.state = message
        return speeds


@pytest.mark.parametrize("path_id", ["", "goal/1"])
@pytest.mark.parametrize("topic", [t.POSE, t.ODOM, t.MAP_STATUS, t.GOAL_STATUS])
def test_no_path_is_driven_on_old_inputs_whatever_its_id(path_id: str, topic: Topic) -> None:
    world = Inputs()
    world.run(0.1)
    world.path(path_id)
    assert max(world.run(1.0)) > 0.3
    world.silent = {topic}
    assert set(world.run(4.0)[75:]) == {0.0}
    assert world.state.phase == "stopped"
    assert topic.name in world.state.hold


def test_no_path_is_driven_before_the_start_in_the_map_is_known() -> None:
    world = Inputs(placed=False)
    world.path("goal/1")
    assert set(world.run(1.0)) == {0.0}
    assert world.state.hold == "no /tf_static yet"
