"""An area explored by the whole stack in the closed loop, and the way home."""

from __future__ import annotations

import math

import pytest

from rbtrg_robot import topics as t
from rbtrg_robot.config import load
from rbtrg_robot.hosts.lockstep import Lockstep
from tools.bench.explore.driven import Explored


@pytest.mark.campaign
def test_an_area_is_seen_and_the_robot_is_home() -> None:
    with Lockstep(load(None, ["sim.lidar_step=4"], scene="flat")) as stack:
        stack.wait_ready()
        run = Explored(stack)
        stack.run(1.1)
        here = stack.newest[t.TRUTH].pose.pose.position
        x, y = here.x, here.y
        run.start({"area": [[x - 1, y - 2], [x + 12, y - 2], [x + 12, y + 2], [x - 1, y + 2]]})
        stack.run_until(lambda: run.over, 90.0, "the end of the exploration")
        assert run.state.phase == "finished"
        explored, home = run.state.result_description
        assert explored.startswith("no frontier left within the accepted risk")
        assert "100 %" in explored
        assert home == ""
        farthest = stack.newest[t.TRUTH].pose.pose.position
        assert math.hypot(farthest.x - x, farthest.y - y) < 0.3
        assert run.state.goals >= 2  # a place and home
