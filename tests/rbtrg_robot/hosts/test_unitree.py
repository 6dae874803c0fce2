"""The whole stack drives the Unitree backend, with the simulated Go2-W behind the wire format: goals, and a fault on
the way."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import pytest

from hal.lidar.config import only
from hal.types import ModeRequest, PostureCommand, RobotState, Sample, VelocityCommand
from rbtrg_robot import topics as t
from rbtrg_robot.config import load
from rbtrg_robot.hosts import robot as robot_process
from rbtrg_robot.hosts.lockstep import Lockstep
from rbtrg_robot.orders.words import goal_line, robot_line
from rbtrg_robot.process.health import Health
from rbtrg_robot.wire.messages import decode
from tests.hal.unitree.robot import LOW_STATE_RATE, MujocoBody
from tests.hal.unitree.world import World


class Wired:
    """The Unitree backend on the lockstep clock: reading advances the robot's side first."""

    def __init__(self, config: Any) -> None:
        robot = config.facts
        controller = "vmc" if robot.wheeled else robot.usual
        how = {"robot": robot, "controller": controller, "lidars": config.lidars}
        body = MujocoBody(config.load_scene(), lidar_step=4, seed=3, **how)
        # At 125 Hz footfalls alias in the IMU: its height is off by 2 cm, and the Go2 steps no higher.
        self.world = World(options=config.unitree_options(), body=body, epoch=0, rate=LOW_STATE_RATE)
        self.backend = self.world.backend
        self.capabilities = self.backend.capabilities

    def connect(self) -> None:
        self.backend.connect()
        self.world.begin()

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

    def diagnostics(self) -> dict[str, float]:
        return self.backend.diagnostics()

    def close(self, *, lie_down: bool = True) -> None:
        self.backend.close(lie_down=lie_down)


@pytest.fixture
def wired(
    monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest
) -> Iterator[tuple[Lockstep, World]]:
    """A ready stack and the robot's world; indirect: the name of the robot."""
    made: list[Wired] = []

    def build(config: Any, *_rest: Any) -> Wired:
        made.append(Wired(config))
        return made[0]

    monkeypatch.setattr(robot_process, "_simulator", build)
    robot = getattr(request, "param", "go2w")
    with Lockstep(load(None, [], robot_model=robot, scene="flat", lidars=only("xt16"))) as stack:
        stack.wait_ready(30.0)
        yield stack, made[0].world


@dataclass(frozen=True)
class Fault:
    """What fails while the robot drives to a goal, and what `status` says after `LASTING`."""

    set: Callable[[World, bool], None]
    robot: str
    goal: str
    rest: float = 0.5
    """[s] until the robot stands."""
    ended: bool = True
    """The goal ended; otherwise it goes on by itself when the fault is over."""
    orders: tuple[str, ...] = ()
    """What `status` asks the operator for."""


LASTING = 3.5
"""[s]"""


def _cut(world: World, on: bool) -> None:
    world.cut = on


def _fault(name: str) -> Callable[[World, bool], None]:
    return lambda world, on: setattr(world.faults, name, on)


AWAY = "robot: disconnected (no LowState for 3.5 s: check cable and robot), held (imu is 3.5 s old)"
OUT = "goal: aborted (GOAL): the robot is out of contact: no LowState for 3."
SILENT = "robot fault: sport service is silent (motion service released?): request recover"
FAULTS = {
    # Without a sentry only the robot's own hold of the last Move ends this one.
    "cable": Fault(_cut, AWAY, OUT, rest=1.4),
    "LowState stops": Fault(_fault("low_silent"), AWAY, OUT),
    "LowState freezes": Fault(_fault("low_frozen"), AWAY, OUT),
    "sportmodestate": Fault(
        _fault("sport_silent"),
        f"robot: fault, E-STOP ({SILENT})",
        f"goal: aborted (GOAL): emergency stop: {SILENT}; `rbtrg-robot resume` releases it",
        rest=1.5,  # a second of patience
        orders=("recover", "resume"),
    ),
    "remote": Fault(
        lambda world, on: setattr(world.faults, "remote", (0.0, 0.0, 0.0, 0.0, 0.4 * on)),
        "E-STOP (the operator's remote drives)",
        "goal: aborted (GOAL): emergency stop: the operator's remote drives; `rbtrg-robot resume` releases it",
        rest=1.0,
        orders=("resume",),
    ),
    "LiDAR": Fault(_fault("lidar_silent"), "held (lidar is 3.", "goal: moving (GOAL)", rest=1.5, ended=False),
}


@pytest.mark.campaign
def test_whatever_fails_on_the_way_it_rests_says_why_and_reaches_the_next_goal(
    wired: tuple[Lockstep, World],
) -> None:
    stack, world = wired
    body, health = world.body, Health(simulated=True)

    def watch(topic: t.Topic[Any], data: bytes, _now: int) -> None:
        if topic in Health.WATCHED:
            health.take(topic, decode(data, topic.kind))

    stack.host.listen(watch)
    to = (body.x + 4.0, body.y)
    stack.send_goal(*to)
    for name, fault in FAULTS.items():
        stack.run_until(lambda: body.v > 0.3, 20.0, f"motion before {name}")
        fault.set(world, True)
        stack.run(fault.rest)
        assert abs(body.v) < 0.05, name
        stack.run(LASTING - fault.rest)
        row = health.robot_row()
        assert fault.robot in robot_line(row)
        assert goal_line(row).startswith(fault.goal.replace("GOAL", "{:.2f}, {:.2f}".format(*to)))
        assert abs(body.v) < 0.05, name
        fault.set(world, False)
        stack.run(1.0)
        for order in fault.orders:
            stack.command(order)
            stack.run(1.0)
        assert stack.newest[t.ROBOT_STATE].phase in ("ready", "moving"), name
        if fault.ended:
            assert abs(body.v) < 0.05, "it drives on only when told to"
            stack.send_goal(*to)
    status = stack.finish_goal(40.0)
    assert (status.state, status.reason) == ("reached", "")
    stack.run(1.0)
    assert math.dist((body.x, body.y), to) < 0.25
    assert abs(body.v) < 0.05


@pytest.mark.parametrize("wired", ["go2"], indirect=True)
def test_a_robot_on_feet_walks_to_its_goal(wired: tuple[Lockstep, World]) -> None:
    """The Go2 by its own sport service, as the trot of the simulation stands behind it."""
    stack, world = wired
    body = world.body
    to = (body.x + 1.0, body.y + 0.3)
    stack.send_goal(*to)
    status = stack.finish_goal(40.0)
    assert (status.state, status.reason) == ("reached", "")
    stack.run(2.0)
    assert math.dist((body.x, body.y), to) < 0.25
    there = body.x, body.y
    stack.run(1.0)
    assert math.dist((body.x, body.y), there) < 0.02, "it stands"
    assert world.robot.motion == "mcf"
