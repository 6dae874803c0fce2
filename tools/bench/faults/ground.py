"""Ground and body that are not what they seem: holes a little wider than the robot crosses, parts nobody told of, goals that
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

from hal.safety.monitors import GOAL_SPENT, HOLE_WIDTH, OWN_PARTS
from rbtrg_robot import topics as t
from rbtrg_robot.config import load
from rbtrg_robot.hosts.lockstep import Lockstep
from rbtrg_robot.stages.navigation.goal import GoalState
from tools.bench.faults.fault import Fault, Outcome
from tools.bench.faults.watch import Watch, by_hand

CELL, CORNER = 0.02, (-1.5, -1.5)
DEPTH = 2.0
"""[m] of holes."""
SINKS = 0.15
"""[m] that base_link sinks by where the robot is in a hole."""
EDGE = 1.6
"""[m] from the start to the near rim of a hole on the way."""
ANGLES = (0.0, 25.0, 50.0)
"""[deg] between the way and the normal of a hole, by seed."""
DIPS = 0.05
"""[m] that base_link sinks by, at least, when a wheel goes into a hole: more than over a crack that is crossed."""
GIVEN_UP = 90.0
"""[s] for a goal 2.6 m away."""


@contextmanager
def stack_on(height: np.ndarray, seed: int, **settings: Any) -> Iterator[Lockstep]:
    """A ready stack on a terrain (rows, cols) [m] of CELL and CORNER, at the origin."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "ground.npz"
        np.savez(file, height=height.astype(np.float32), resolution=CELL, origin=np.array(CORNER))
        sets = ["record=false", f"seed={seed}"]
        with Lockstep(load(None, sets, scene=str(file), origin=(0.0, 0.0, 0.0), **settings)) as stack:
            stack.wait_ready()
            yield stack


def walled(length: float = 6.0, width: float = 3.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Level ground at DEPTH inside walls, with the x and y [m] of its cells."""
    x = np.arange(CORNER[0], CORNER[0] + length, CELL)
    y = np.arange(CORNER[1], CORNER[1] + width, CELL)
    height = np.full((len(y), len(x)), DEPTH)
    height[:3] = height[-3:] = height[:, :3] = height[:, -3:] = DEPTH + 1.0
    return height, *np.meshgrid(x, y)


def _to_hole(width: float, seed: int, *, hands: bool) -> Outcome:
    """Driven by hand into a hole of `width` [m] from wall to wall, or sent to a goal beyond it."""
    angle = math.radians(ANGLES[seed % len(ANGLES)])
    height, x, y = walled()
    across = (x - EDGE) * math.cos(angle) + y * math.sin(angle)
    height[(across > 0.0) & (across < width) & (height == DEPTH)] = 0.0
    with stack_on(height, seed) as stack:
        watch = Watch(stack)
        lowest = level = _height(stack)
        if not hands:
            stack.send_goal(EDGE + width + 1.2, 0.0)
        for _ in range(40):
            if hands:
                by_hand(stack, 0.45, 0.0, 0.2)
            else:
                stack.run(0.4)
            lowest = min(lowest, _height(stack))
        outcome = watch.outcome()
        return replace(outcome, rest=0.0, fell=outcome.fell or lowest < level - DIPS)


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
    height[(away > 0.6) & (away < 0.6 + width) & (height == DEPTH)] = 0.0
    with stack_on(height, seed) as stack:
        watch = Watch(stack)
        level, began = _height(stack), stack.seconds
        stack.send_goal(2.6, 0.0)
        stack.run(0.2)
        while not _over(stack) and stack.seconds - began < GIVEN_UP:
            stack.run(0.5)
        took = stack.seconds - began if _over(stack) else math.inf
        outcome = watch.outcome()
        return replace(outcome, rest=took, fell=outcome.fell or _height(stack) < level - SINKS)


def _over(stack: Lockstep) -> bool:
    return GoalState(stack.newest[t.GOAL_STATUS].state).terminal


def _height(stack: Lockstep) -> float:
    return float(stack.newest[t.TRUTH].pose.pose.position.z)


FAULTS = (
    Fault(
        "hole by hand", (HOLE_WIDTH,), (0.16, 0.2), partial(_to_hole, hands=True), says=(HOLE_WIDTH.words,)
    ),
    Fault("hole before a goal", (HOLE_WIDTH,), (0.16, 0.2), partial(_to_hole, hands=False)),
    Fault("own antenna", (OWN_PARTS,), (0.03, 0.06), _antenna, says=("own_parts",)),
    Fault("goal behind a moat", (GOAL_SPENT,), (0.3, 0.5), _moat, rest=40.0, error=0.25),
)
