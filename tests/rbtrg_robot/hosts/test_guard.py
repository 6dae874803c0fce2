"""The guard in the closed loop: whoever moves the robot, its body touches nothing, and kerbs do not stop it."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.config import load
from rbtrg_robot.hosts.lockstep import Lockstep
from rbtrg_robot.wire.messages import header
from tests.rbtrg_robot.hosts.test_lockstep import _distance, config, put_box, speed, truth
from tools.bench.edge import push_to_edge

Box = tuple[tuple[float, float], tuple[float, float]]
"""Its extents along x and y [m]."""


def box(xs: tuple[float, float], ys: tuple[float, float], high: float, appear: float = 0.0) -> dict[str, Any]:
    """An obstacle of the simulator."""
    return {
        "centre": (sum(xs) / 2, sum(ys) / 2, high / 2),
        "size": (xs[1] - xs[0], ys[1] - ys[0], high),
        "appear": appear,
    }


def stack_with(*boxes: dict[str, Any], **flags: Any) -> Lockstep:
    """Flat ground, the robot at the origin, heading +x. Every fourth firing is harder for the guard and half the
    work."""
    sim = {"obstacles": list(boxes), "lidar_step": 4}
    return Lockstep(config(origin=(0.0, 0.0, 0.0), sim=sim, **flags))


def by_hand(stack: Lockstep, seconds: float, vx: float, wz: float = 0.0, near: Box | None = None) -> float:
    """Drive by hand at 25 Hz; the smallest distance [m] between body and the box meanwhile."""
    closest = math.inf
    for _ in range(round(seconds * 25)):
        command = msg.TwistStamped(header=header(stack.now, "base_link"))
        command.twist.linear.x, command.twist.angular.z = vx, wz
        stack.host.inject(t.TELEOP, command)
        stack.run(0.04)
        if near is not None:
            closest = min(closest, _distance(truth(stack), *near))
    return closest


def test_what_steps_behind_a_reversing_robot_is_not_touched() -> None:
    near = ((-1.75, -1.45), (-0.25, 0.25))
    with stack_with(box(*near, 0.5, appear=1000.0)) as stack:
        stack.wait_ready()
        by_hand(stack, 2.2, -0.4)
        put_box(stack, *box(*near, 0.5)["centre"])
        gap = truth(stack)[0] - 0.35 - near[0][1]
        assert 0.25 < gap < 0.7, "behind its tail, and further than it takes to brake"
        assert speed(stack) > 0.3
        assert by_hand(stack, 2.5, -0.4, near=near) > 0.0
        assert speed(stack) < 0.05
        for _ in range(8):  # it creeps up to the last centimetre
            if "behind" in stack.newest[t.ROBOT_STATE].hold:
                break
            assert by_hand(stack, 0.2, -0.4, near=near) > 0.0
        assert "behind" in stack.newest[t.ROBOT_STATE].hold
        by_hand(stack, 1.0, 0.3)
        assert speed(stack) > 0.2, "the way out is free"


def test_what_steps_before_a_driving_robot_is_not_touched_though_the_planner_is_dead() -> None:
    near = ((2.0, 2.3), (-0.3, 0.3))
    with stack_with(box(*near, 0.4, appear=1000.0)) as stack:
        stack.wait_ready()
        stack.host.kill("planner")
        by_hand(stack, 2.4, 0.5)
        put_box(stack, *box(*near, 0.4)["centre"])
        gap = near[0][0] - truth(stack)[0] - 0.35
        assert 0.25 < gap < 0.9, "before its nose, and further than it takes to brake"
        assert by_hand(stack, 2.5, 0.5, near=near) > 0.0
        assert speed(stack) < 0.05


@pytest.mark.parametrize("way", [1.0, pytest.param(-1.0, marks=pytest.mark.campaign)])
def test_nobody_drives_it_into_a_wall_by_hand(way: float) -> None:
    xs = (1.2, 1.5) if way > 0.0 else (-1.5, -1.2)
    near = (xs, (-2.0, 2.0))
    with stack_with(box(*near, 0.8)) as stack:
        stack.wait_ready()
        # No LiDAR looks backward past the body: ground that it has not seen ends that way before the wall does.
        assert 0.0 < by_hand(stack, 4.0, 0.6 * way, near=near) < (0.15 if way > 0.0 else 0.5)
        assert speed(stack) < 0.05
        assert stack.newest[t.ROBOT_STATE].hold.startswith("guard: ")
        closest = by_hand(stack, 2.0, 0.3 * way, 0.8, near=near)
        assert closest > 0.0, "its corners do not touch when it turns there either"


@pytest.mark.campaign
def test_beside_a_wall_it_is_driven_along_it_by_hand_both_ways(tmp_path: Path) -> None:
    """Its side is 2 cm off, less than the map tells: cells of the wall lie in its body, some of them ahead, some
    behind."""
    x, y = np.meshgrid(np.arange(401) * 0.02 - 4.0, np.arange(201) * 0.02 - 2.0)
    file = tmp_path / "wall.npz"
    ramp = np.where(y > 0.03, 0.18 * np.clip((x - 0.5) / 0.8, 0.0, 1.0), 0.0)
    height = np.where(y < -0.235, 0.9, ramp).astype(np.float32)
    np.savez(file, height=height, resolution=0.02, origin=np.array([-4.0, -2.0]))
    sim = {"lidar_step": 4}
    with Lockstep(load(None, [], scene=str(file), origin=(-0.5, 0.0, 0.0), sim=sim)) as stack:
        stack.wait_ready()
        by_hand(stack, 6.5, 0.3, -0.03)
        assert truth(stack)[0] > 0.6
        by_hand(stack, 1.2, 0.0, 0.4)
        by_hand(stack, 1.2, 0.0, -0.4)
        # A corner meets the wall at 0.057 rad (2 cm over 0.35 m). Of five draws of noise four stay below 0.02 rad, one
        # comes to 0.027.
        assert abs(truth(stack)[2]) < 0.04, "a corner would come into the wall"
        back = truth(stack)[0]
        by_hand(stack, 2.5, -0.3)
        assert truth(stack)[0] < back - 0.3
        assert truth(stack)[1] > -0.01, "no nearer to the wall"


def test_it_gets_over_a_kerb_of_its_envelope(tmp_path: Path) -> None:
    x, _ = np.meshgrid(*(2 * [np.arange(201) * 0.05 - 5.0]))
    file = tmp_path / "kerb.npz"
    height = np.where((x > 1.0) & (x < 2.0), 0.10, 0.0).astype(np.float32)
    np.savez(file, height=height, resolution=0.05, origin=np.array([-5.0, -5.0]))
    with Lockstep(load(None, [], scene=str(file), origin=(0.0, 0.0, 0.0), sim={"lidar_step": 4})) as stack:
        stack.wait_ready()
        held = 0
        while truth(stack)[0] <= 2.2:  # up and down again
            assert stack.seconds < 14.0
            by_hand(stack, 0.2, 0.4)
            held += stack.newest[t.ROBOT_STATE].hold != ""
        assert held == 0


@pytest.mark.parametrize(
    ("vx", "lean", "lidars"),
    [
        (0.5, 30.0, "xt16_l1"),
        pytest.param(-0.5, 0.0, "xt16_l1", marks=pytest.mark.campaign),
        pytest.param(0.5, 0.0, "xt16", marks=pytest.mark.campaign),
    ],
)
def test_nobody_drives_it_over_an_edge_by_hand(tmp_path: Path, vx: float, lean: float, lidars: str) -> None:
    """Whether the LiDARs see the ground below the edge or not; of a pit that nobody sees, test_lidars.py tells, too."""
    over, lowest = push_to_edge(vx, math.radians(lean), lidars, tmp_path)
    assert over < 0.04, "the wheels stand 0.1 m further back than the corners of the body"
    assert lowest > 0.3


def test_a_guard_that_hangs_means_zero() -> None:
    with stack_with() as stack:
        stack.wait_ready()
        by_hand(stack, 1.5, 0.5)
        assert speed(stack) > 0.4
        stack.host.kill("guard")  # its token stays: nobody tells the robot process
        by_hand(stack, 0.4, 0.5)
        assert stack.newest[t.ROBOT_STATE].vx == 0.0
        assert stack.newest[t.ROBOT_STATE].hold.startswith("guard is 0.")


@pytest.mark.parametrize("silent", ["odometry", "elevation"])
def test_a_guard_that_sees_nothing_new_allows_nothing(silent: str) -> None:
    with stack_with() as stack:
        stack.wait_ready()
        by_hand(stack, 1.5, 0.5)
        assert speed(stack) > 0.4
        stack.host.kill(silent)
        by_hand(stack, 0.7, 0.5)
        assert stack.newest[t.ROBOT_STATE].vx == 0.0
        assert stack.newest[t.ROBOT_STATE].hold != ""


@pytest.mark.campaign
def test_a_goal_waits_while_somebody_drives_and_goes_on_when_told_to() -> None:
    with stack_with() as stack:
        stack.wait_ready()
        stack.send_goal(2.0, 0.0)
        stack.run_until(lambda: speed(stack) > 0.3, 10.0, "motion")
        by_hand(stack, 2.0, -0.2, 0.3)
        assert stack.newest[t.GOAL_STATUS].state == "paused"
        stack.run(6.0)  # longer than what counts as stuck
        assert stack.newest[t.GOAL_STATUS].state == "paused"
        assert "resume" in stack.newest[t.GOAL_STATUS].detail
        assert speed(stack) < 0.05
        stack.command("resume")
        assert stack.finish_goal(40.0).state == "reached"
        assert math.dist(truth(stack)[:2], (2.0, 0.0)) < 0.25
