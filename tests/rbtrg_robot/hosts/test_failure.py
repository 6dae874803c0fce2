"""A robot process that fails in the middle of a drive."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from hal.lidar.config import only
from hal.types import NS, Phase
from hal.unitree.api import Sport
from hal.unitree.config import UnitreeConfig
from rbtrg_robot import topics as t
from rbtrg_robot.config import load
from rbtrg_robot.hosts import robot as robot_process
from rbtrg_robot.topics import Topic
from rbtrg_robot.wire.convert import odometry_msg
from rbtrg_robot.wire.messages import header
from tests.hal.unitree.world import World
from tests.rbtrg_robot.hearsay import all_clear
from tests.rbtrg_robot.hosts.test_wall_clock import FakeBus, Time, clocks

__all__ = ["clocks"]


@pytest.mark.parametrize("fails", [True, False])
def test_the_robot_is_stopped_and_lies_down_at_the_end_of_the_stack_alone(
    fails: bool, clocks: Time, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whatever ends the process by an error, another one starts: until then the robot stands where it is, on a stair
    too."""
    world = World(options=UnitreeConfig(lidars=only("xt16")))
    monkeypatch.setattr(robot_process, "_hardware", lambda _config, _clock: world.backend)
    loaded: list[int] = []
    monkeypatch.setattr(robot_process, "keep_what_is_loaded", lambda: loaded.append(len(world.sent)))
    bus = FakeBus(clocks, world.advance)
    end = 4 * NS

    def hear() -> list[tuple[Topic, Any]]:
        if fails and clocks.elapsed >= end:
            assert world.body.v > 0.3
            raise ZeroDivisionError
        command = t.CMD_VEL.kind(header=header(bus.clock(), "base_link"))
        command.twist.linear.x = 0.5
        pose = odometry_msg(
            bus.clock(), np.zeros(3), (0, 0, 0, 1), np.array([world.body.v, 0, 0]), np.zeros(3)
        )
        return [(t.CMD_VEL, command), (t.POSE, pose), (t.MOTION_LIMITS, all_clear(bus.clock()))]

    bus.hear = hear
    config = load(None, ["backend=unitree", "interface=lo", "record=false"])
    try:
        robot_process.main(config, bus, lambda: not fails and clocks.elapsed >= end, {})  # type: ignore[arg-type]
    except ZeroDivisionError:
        assert fails
    assert loaded == [0], "before the first word to the robot, which then waits for the next"
    world.advance(2.0)
    assert abs(world.body.v) < 0.05
    assert (Sport.STAND_DOWN in world.apis()) is not fails
    assert world.body.phase is (Phase.READY if fails else Phase.SITTING)
