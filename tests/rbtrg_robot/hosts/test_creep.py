"""The whole stack before ground that sends no ray back (water, black, wet): a robot whose wheels feel edges creeps over
it, and stops at what is no ground."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from hal.lidar.caster import Float32, NumbaCaster, Surface, TerrainCaster
from hal.robots import Robot
from hal.scenes import Scene
from rbtrg_robot import topics as t
from rbtrg_robot.config import StackConfig, load
from rbtrg_robot.hosts.lockstep import Lockstep
from rbtrg_robot.stages.navigation.goal import GoalState
from rbtrg_robot.wire.messages import header

RES, FIRST, WIDTH = 0.02, -1.5, 1.12
DARK = (1.3, 2.1)
"""x [m] between which the floor of the lane sends no ray back."""
GOAL = (3.6, 0.0)


class Dark:
    """Terrain whose floor is black in places: it is as level as elsewhere, whatever the robot stands on."""

    def __init__(self, surface: Surface) -> None:
        self._lit = NumbaCaster(surface)

    def cast(self, origins: Float32, directions: Float32) -> Float32:
        return self.returns(origins, directions)[0]

    def returns(self, origins: Float32, directions: Float32) -> tuple[Float32, Float32]:
        ranges, cosine = self._lit.returns(origins, directions)
        with np.errstate(invalid="ignore"):
            x, _, z = (origins + ranges[:, None] * directions).T
        dark = (x > DARK[0]) & (x < DARK[1]) & (z < 0.02)
        return np.where(dark, np.float32(np.inf), ranges), np.where(dark, np.float32(0.0), cosine)


class DarkScene(Scene):
    def caster(self) -> TerrainCaster:
        level = np.where(self.height < 0.0, np.float32(0.0), self.height)
        return Dark(Surface(level, self.resolution, self.origin))


def below(kind: str, beyond: np.ndarray) -> np.ndarray:
    """Height [m] of the dark floor, `beyond` [m] its edge."""
    if kind == "stairs":
        return -0.17 * np.clip(np.ceil(beyond / 0.25), 0.0, 3.0)
    depth = {"level": 0.0, "pit": 0.7, "platform": 0.5}[kind]
    return np.where((beyond > 0.0) & ((beyond < 0.4) | (kind != "pit")), -depth, 0.0)


def lane(kind: str, askew: float = 0.0) -> Scene:
    """With walls on both sides; 0.2 m behind its begin the dark floor goes down, the edge turned by `askew` [rad]."""
    x, y = np.arange(FIRST, 4.5, RES), np.arange(-1.5, 1.5, RES)
    ahead, left = np.meshgrid(x, y)
    beyond = (ahead - DARK[0] - 0.2) * math.cos(askew) + left * math.sin(askew)
    dark = (ahead > DARK[0]) & (ahead < DARK[1])
    height = np.where(dark, below(kind, beyond), 0.0).astype(np.float32)
    height[np.abs(np.abs(left) - WIDTH / 2 - 0.03) < 0.03] = 0.6
    height[(ahead < FIRST + 0.7) | (ahead > 4.2) | (np.abs(left) > 1.4)] = 1.2
    return DarkScene("lane", height, RES, (FIRST, -1.5), (0.0, 0.0, 0.0), {})


CREEPING, BACKING = "creeping over ground nobody saw", "backing out"


def drive(
    monkeypatch: pytest.MonkeyPatch,
    scene: Scene,
    controller: str = "hybrid",
    friction: float = 0.8,
    until: str = "never",
) -> tuple[Lockstep, list[str], float]:
    """To the end of the goal, or until what came after `until`, on its wheels: the stack, what the goal said on the
    way, and how far the robot came [m]."""
    monkeypatch.setattr(StackConfig, "load_scene", lambda self: scene)
    sets = ["record=false", "sim.lidar_step=4", f"sim.friction={friction}"]
    said, furthest, creeps = [""], 0.0, 0
    with Lockstep(load(None, sets, controller=controller)) as stack:
        stack.wait_ready()
        stack.run(0.5)
        stack.send_goal(*GOAL)
        stack.run(0.2)
        while not GoalState(stack.newest[t.GOAL_STATUS].state).terminal:
            if until in said[:-1]:
                cancel = t.GOAL_REQUEST.kind(header=header(stack.now, "map"), action=1)
                stack.host.inject(t.GOAL_REQUEST, cancel)
            stack.run(0.1)
            place, detail = stack.newest[t.TRUTH].pose.pose.position, stack.newest[t.GOAL_STATUS].detail
            furthest = max(furthest, place.x)
            said += [detail] if detail != said[-1] else []
            creeps = creeps + 1 if detail == CREEPING else 0
            assert creeps < 4 or stack.newest[t.ROBOT_STATE].vx <= 0.1 + 1e-6, "once it was braked"
            assert place.z > 0.28, f"fell at x {place.x:.2f} after {stack.seconds:.1f} s"
            assert stack.seconds < 60.0
        stack.run(1.0)
        assert stack.newest[t.ROBOT_STATE].phase == "ready"
    return stack, said, furthest


@pytest.mark.campaign
def test_over_ground_that_sends_no_ray_back_it_creeps_to_the_goal(monkeypatch: pytest.MonkeyPatch) -> None:
    stack, said, _ = drive(monkeypatch, lane("level"))
    assert stack.newest[t.GOAL_STATUS].state == "reached"
    assert CREEPING in said


def test_at_an_edge_that_nobody_saw_it_stops_and_backs_out(monkeypatch: pytest.MonkeyPatch) -> None:
    _, said, furthest = drive(monkeypatch, lane("pit"), friction=0.6, until=BACKING)
    assert CREEPING in said[: said.index(BACKING)]
    assert DARK[0] - 0.1 < furthest < DARK[0] + 0.2


@pytest.mark.campaign
@pytest.mark.parametrize(
    ("kind", "askew", "friction", "controller"),
    [
        ("pit", 0.0, 0.6, "hybrid"),
        ("stairs", 0.3, 0.8, "hybrid"),
        ("platform", -0.7, 1.0, "vmc"),
    ],
)
def test_at_an_edge_that_nobody_saw_it_stops_and_tells_of_it(
    kind: str, askew: float, friction: float, controller: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    stack, said, furthest = drive(monkeypatch, lane(kind, askew), controller, friction)
    status = stack.newest[t.GOAL_STATUS]
    assert CREEPING in said
    assert (status.state, status.reason) == ("aborted", "no_route")
    assert status.detail.startswith("the wheels felt an edge that goes down at x 1.")
    assert furthest < DARK[0] + 0.2


@pytest.mark.campaign
def test_who_does_not_feel_edges_does_not_creep_and_says_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    own = Robot.capabilities
    monkeypatch.setattr(Robot, "capabilities", lambda self, name: replace(own(self, name), creep=0.0))
    stack, said, furthest = drive(monkeypatch, lane("pit"))
    status = stack.newest[t.GOAL_STATUS]
    assert CREEPING not in said
    assert any("drive it by hand, slowly" in detail for detail in said)
    assert (status.state, status.reason) == ("aborted", "no_route")
    assert furthest < DARK[0] - 0.1
