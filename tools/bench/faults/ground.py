"""Ground and body that are not what they seem: holes a little wider than the robot crosses, parts nobody told of, goals
that
cannot be reached."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from hal.limbs import LEGS
from hal.rotation import rotation_rpy
from hal.safety.monitors import GOAL_SPENT, HOLE_WIDTH, OWN_PARTS
from hal.types import LidarScan, Sample
from rbtrg_robot import topics as t
from rbtrg_robot.config import load
from rbtrg_robot.hosts.lockstep import Lockstep
from rbtrg_robot.stages.navigation.goal import GoalState
from tools.bench.faults.fault import Fault, Outcome
from tools.bench.faults.watch import Watch, by_hand, tap

CELL_SIDE, GROUND_CORNER = 0.02, (-1.5, -1.5)
HOLE_DEPTH = 2.0
"""[m] of holes."""
SINK_DEPTH = 0.15
"""[m] that base_link sinks by where the robot is in a hole."""
RIM_AHEAD, RIM_LEFT = 1.6, 0.12
"""[m] ahead of the start and to its left, a place on the near rim of a hole: a hole along the way lies before the left
wheels."""
HOLE_ANGLES = (0.0, 25.0, 50.0, 70.0, 90.0)
"""[deg] between the way and the normal of a hole, by seed."""
FREE_AHEAD = 0.9
"""[m] ahead of the start that no hole begins before."""
LATE_RANGE = 1.0
"""[m] from base_link, the farthest ground that sends a ray back where holes are seen late: a third of a metre before
the
nose and the width of a hole."""
GIVEN_UP = 90.0
"""[s] for a goal 2.6 m away."""


@contextmanager
def stack_on(height: np.ndarray, seed: int, **settings: Any) -> Iterator[Lockstep]:
    """A ready stack on a terrain (rows, cols) [m] of CELL_SIDE and GROUND_CORNER, at the origin."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "ground.npz"
        np.savez(file, height=height.astype(np.float32), resolution=CELL_SIDE, origin=np.array(GROUND_CORNER))
        sets = ["record=false", f"seed={seed}"]
        with Lockstep(load(None, sets, scene=str(file), origin=(0.0, 0.0, 0.0), **settings)) as stack:
            stack.wait_ready()
            yield stack


def walled(length: float = 6.0, width: float = 3.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Level ground at HOLE_DEPTH inside walls, with the x and y [m] of its cells."""
    x = np.arange(GROUND_CORNER[0], GROUND_CORNER[0] + length, CELL_SIDE)
    y = np.arange(GROUND_CORNER[1], GROUND_CORNER[1] + width, CELL_SIDE)
    height = np.full((len(y), len(x)), HOLE_DEPTH)
    height[:3] = height[-3:] = height[:, :3] = height[:, -3:] = HOLE_DEPTH + 1.0
    return height, *np.meshgrid(x, y)


def _to_hole(width: float, seed: int, *, hands: bool, late: bool = False) -> Outcome:
    """Driven by hand towards a hole of `width` [m] from wall to wall, or sent to a goal beyond it. `fell`: the middle
    of a
    wheel came over it.
    """
    angle = math.radians(HOLE_ANGLES[seed % len(HOLE_ANGLES)])

    def inside(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        across = (x - RIM_AHEAD) * math.cos(angle) + (y - RIM_LEFT) * math.sin(angle)
        return (across > 0.0) & (across < width) & (x > FREE_AHEAD)

    height, x, y = walled()
    height[inside(x, y) & (height == HOLE_DEPTH)] = 0.0
    with stack_on(height, seed) as stack:
        if late:
            tap(stack, partial(_near_ground, _mounts(stack)))
        watch, entered = Watch(stack), False
        if not hands:
            stack.send_goal(RIM_AHEAD + width + 1.2, 0.0)
        for _ in range(160):
            if hands:
                by_hand(stack, 0.45, 0.0, 0.04)
            else:
                stack.run(0.1)
                if _over(stack):
                    break
            wheels = _wheels(stack)
            entered |= bool(inside(wheels[:, 0], wheels[:, 1]).any())
        outcome = watch.outcome()
        return replace(outcome, rest=0.0, fell=outcome.fell or entered)


def _wheels(stack: Lockstep) -> np.ndarray:
    """(4, 3) [m] middles of the wheels, by the truth."""
    simulation = stack.robot.backend.simulation  # type: ignore[attr-defined]
    return np.array([simulation.data.geom(f"{leg}_wheel").xpos for leg in LEGS])


Mounts = dict[str, tuple[np.ndarray, np.ndarray]]


def _mounts(stack: Lockstep) -> Mounts:
    """Rotation (3, 3) and translation (3,) [m] of each LiDAR, base_link <- LiDAR."""
    mounts = {lidar.name: lidar.mount for lidar in stack.robot.backend.capabilities.lidars}
    return {name: (rotation_rpy(*m.rpy), np.array(m.translation)) for name, m in mounts.items()}


def _near_ground(mounts: Mounts, samples: list[Sample]) -> list[Sample]:
    """Wet ground: rays that meet it, or what lies below it, farther than LATE_RANGE do not come back."""
    out: list[Sample] = []
    for sample in samples:
        if isinstance(sample, LidarScan):
            turned, moved = mounts[sample.name]
            xyz = np.column_stack([sample.points[axis] for axis in "xyz"]) @ turned.T + moved
            seen = (xyz[:, 2] > -0.2) | (np.hypot(xyz[:, 0], xyz[:, 1]) < LATE_RANGE)
            sample = replace(sample, points=sample.points[seen])
        out.append(sample)
    return out


def _antenna(size: float, seed: int) -> Outcome:
    """Drive with an antenna beside the body that nobody told of, `size` [m] thick."""
    height, _, _ = walled()
    part = {"centre": (-0.25, 0.27 + 0.5 * size, 0.05), "size": (size, size, 0.3)}
    with stack_on(height, seed, sim={"lidar_step": 2, "parts": [part]}) as stack:
        watch = Watch(stack)
        turn = 1.0 if seed % 2 else -1.0
        by_hand(stack, 0.4, 0.0, 7.0)
        by_hand(stack, 0.0, turn, 2.0)
        return watch.outcome()


def _moat(width: float, seed: int) -> Outcome:
    """A goal on a plateau that a trench of `width` [m] surrounds: how long until it ends, as `rest`."""
    height, x, y = walled()
    away = np.maximum(np.abs(x - 2.6), np.abs(y))
    height[(away > 0.6) & (away < 0.6 + width) & (height == HOLE_DEPTH)] = 0.0
    with stack_on(height, seed) as stack:
        watch = Watch(stack)
        level, began = _height(stack), stack.seconds
        stack.send_goal(2.6, 0.0)
        stack.run(0.2)
        while not _over(stack) and stack.seconds - began < GIVEN_UP:
            stack.run(0.5)
        took = stack.seconds - began if _over(stack) else math.inf
        outcome = watch.outcome()
        return replace(outcome, rest=took, fell=outcome.fell or _height(stack) < level - SINK_DEPTH)


def _before_a_wall(left: float, seed: int) -> Outcome:
    """A goal `left` [m] before a wall, where the body stands with its nose at it: how long until it ends, as `rest`."""
    height, x, _ = walled()
    wall = float(x[0, -3])
    with stack_on(height, seed) as stack:
        watch, began = Watch(stack), stack.seconds
        stack.send_goal(wall - left, 0.1 * (seed % 3 - 1))
        stack.run(0.2)
        while not _over(stack) and stack.seconds - began < GIVEN_UP:
            stack.run(0.5)
        took = stack.seconds - began if _over(stack) else math.inf
        outcome = watch.outcome()
        return replace(outcome, rest=took, words=f"{outcome.words}\n{stack.newest[t.GOAL_STATUS].state}")


def _over(stack: Lockstep) -> bool:
    return GoalState(stack.newest[t.GOAL_STATUS].state).terminal


def _height(stack: Lockstep) -> float:
    return float(stack.newest[t.TRUTH].pose.pose.position.z)


TRIED_WIDTHS = (0.16, 0.2, 0.13, 0.25, 0.35, 0.6)
"""Of holes [m]."""
FAULTS = (
    Fault("hole by hand", (HOLE_WIDTH,), TRIED_WIDTHS, partial(_to_hole, hands=True)),
    Fault("hole before a goal", (HOLE_WIDTH,), TRIED_WIDTHS, partial(_to_hole, hands=False)),
    Fault("hole seen late", (HOLE_WIDTH,), TRIED_WIDTHS, partial(_to_hole, hands=True, late=True)),
    Fault("own antenna", (OWN_PARTS,), (0.03, 0.06), _antenna, says=("own_parts",)),
    Fault("goal before a wall", (), (0.38, 0.5), _before_a_wall, rest=30.0, error=0.25, says=("reached",)),
    Fault("goal behind a moat", (GOAL_SPENT,), (0.3, 0.5), _moat, rest=40.0, error=0.25),
)
