"""The whole stack drives the Unitree backend, with the simulated Go2-W behind the wire format: goals, and a fault on the way."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import pytest

from hal.types import ModeRequest, PostureCommand, RobotState, Sample, VelocityCommand
from hal.unitree.options import UnitreeOptions
from rbtrg_robot import robot_process
from rbtrg_robot import topics as t
from rbtrg_robot.config import load
from rbtrg_robot.lockstep import Lockstep
from tests.unitree_robot import MujocoBody
from tests.unitree_world import World


class Wired:
    """The Unitree backend on the lockstep clock: reading advances the robot's side first."""

    def __init__(self, config: Any) -> None:
        body = MujocoBody(config.load_scene(), lidar_step=4, caster="numba", seed=3)
        self.world = World(options=UnitreeOptions(lidar="xt16"), body=body, epoch=0)
        self.backend = self.world.backend
        self.capabilities = self.backend.capabilities

    def connect(self) -> None:
        self.backend.connect()

    def read(self, now: int) -> list[Sample]:
        self.world.advance(max(now - self.world.now, 0) / 1e9)
        return self.backend.read(now)

    def drive(self, command: VelocityCommand) -> None:
        self.backend.drive(command)

    def posture(self, command: PostureCommand) -> None:
        self.backend.posture(command)

    def request(self, mode: ModeRequest) -> None:
        self.backend.request(mode)

    def state(self) -> RobotState:
        return self.backend.state()

    def close(self) -> None:
        self.backend.close()


@pytest.fixture
def wired(monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[Lockstep, World]]:
    """A ready stack and the robot's world."""
    made: list[Wired] = []

    def build(config: Any, _restored: Any) -> Wired:
        made.append(Wired(config))
        return made[0]

    monkeypatch.setattr(robot_process, "_simulator", build)
    with Lockstep(load(None, [], scene="flat")) as stack:
        stack.wait_ready(30.0)
        yield stack, made[0].world


def test_a_goal_is_reached_over_the_wire_and_a_silent_robot_on_the_way_ends_in_rest(
    wired: tuple[Lockstep, World],
) -> None:
    stack, world = wired
    body = world.body
    x, y = body.x + 1.6 * math.cos(body.yaw), body.y + 1.6 * math.sin(body.yaw)
    stack.send_goal(x, y)
    status = stack.finish_goal(40.0)
    assert (status.state, status.reason) == ("reached", "")
    stack.run(1.0)
    assert math.hypot(body.x - x, body.y - y) < 0.25
    assert abs(body.v) < 0.05

    # On the way back the robot goes silent for three seconds: it rests, says why, and the goal ends with a reason.
    stack.send_goal(x - 1.5 * math.cos(body.yaw), y - 1.5 * math.sin(body.yaw))
    stack.run_until(lambda: body.v > 0.3, 20.0, "motion")
    world.faults.low_silent = True
    stack.run(0.8)
    assert abs(body.v) < 0.05
    assert stack.newest[t.ROBOT_STATE].phase == "disconnected"
    assert "no LowState" in stack.newest[t.ROBOT_STATE].cause
    stack.run(2.2)
    world.faults.low_silent = False
    status = stack.finish_goal(60.0)
    assert status.state in ("reached", "aborted")
    assert status.state == "reached" or status.reason
    assert stack.newest[t.ROBOT_STATE].phase in ("ready", "moving")
