"""A robot that was pushed over gets up, knows where it is and goes on with its goal: the whole stack, judged by the
truth it never sees."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from hal.mujoco.config import Push
from hal.scenes import load_scene
from rbtrg_robot import topics as t
from rbtrg_robot.config import load
from rbtrg_robot.hosts.lockstep import Lockstep

GOAL = (2.0, 3.0)
"""x, y [m]."""


def place(stack: Lockstep) -> tuple[float, float]:
    """True x, y [m]."""
    position = stack.newest[t.TRUTH].pose.pose.position
    return position.x, position.y


@pytest.mark.parametrize("prior", [pytest.param(False, marks=pytest.mark.campaign), True])
def test_a_robot_that_fell_gets_up_knows_where_it_is_and_reaches_a_goal(tmp_path: Path, prior: bool) -> None:
    map_file = ""
    if prior:
        scene, map_file = load_scene("flat"), str(tmp_path / "map.npz")
        np.savez(map_file, height=scene.height, resolution=scene.resolution, origin=scene.origin)
    config = load(None, ["sim.lidar_step=8"], scene="flat", map_file=map_file)
    push = Push(
        time=3.5, force=(0.0, 600.0, 0.0), duration=0.3
    )  # it is thrown 6 m, onto ground it has not seen
    with Lockstep(
        config.model_copy(update={"sim": config.sim.model_copy(update={"pushes": (push,)})})
    ) as stack:
        stack.wait_ready()
        stack.send_goal(*GOAL)
        fallen = stack.finish_goal(10.0)
        assert (fallen.state, fallen.reason) == ("aborted", "emergency_stop")
        stack.run_until(lambda: stack.newest[t.ROBOT_STATE].phase == "fault", 3.0, "the fall")
        stack.command("resume")
        stack.run(0.2)
        stack.send_goal(fallen.x, fallen.y)
        stack.run(0.2)
        refused = stack.newest[t.GOAL_STATUS]
        assert refused.state == "rejected", "a robot that lies drives nowhere"
        assert "recover" in refused.detail or "resume" in refused.detail, "it says what to do"
        stack.command("recover")
        stack.run_until(lambda: stack.newest[t.ROBOT_STATE].phase in ("ready", "stopped"), 24.0, "standing")
        stack.command("resume")
        stack.run(0.2)
        x, y = place(stack)
        away = math.hypot(x, y)
        goal = x - 0.8 * x / away, y - 0.8 * y / away  # away from the edge of the area, wherever it fell
        stack.send_goal(*goal)
        done = stack.finish_goal(30.0)
        assert done.state == "reached", f"{done.reason} {done.detail}"
        stack.run(1.0)
        assert math.dist(place(stack), goal) < 0.25
