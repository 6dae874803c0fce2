"""A cover in the closed loop: the robot drives its lanes, and goes on with them after the mission process died."""

from __future__ import annotations

import math
from itertools import pairwise

import pytest

from rbtrg_robot import topics as t
from rbtrg_robot.config import load
from rbtrg_robot.hosts.lockstep import Lockstep
from rbtrg_robot.missions.file import outing
from rbtrg_robot.stages.mission.cover import lanes
from tests.rbtrg_robot.hosts.test_mission import Run

SWATH = 0.6


@pytest.mark.campaign
def test_lanes_are_driven_once_although_the_mission_process_dies_on_the_way() -> None:
    with Lockstep(load(None, ["sim.lidar_step=8"], scene="flat")) as stack:
        stack.wait_ready()
        run = Run(stack)
        stack.run(1.1)
        x, y, _ = run.truth
        corners = [[x + 0.4, y - 0.6], [x + 2.0, y - 0.6], [x + 2.0, y + 0.6], [x + 0.4, y + 0.6]]
        mission = outing("cover", {"area": corners, "swath": SWATH}, back=False, accept=False)
        order = mission.order("lanes")
        track: list[tuple[float, float]] = []
        run.ask("run", order=order)

        def seen(count: int) -> bool:
            track.append(run.truth[:2])
            return f"{count} of 4 places" in run.state.result_description[0]

        stack.run_until(lambda: seen(2), 40.0, "the first lane")
        stack.kill("mission")
        stack.run(0.5)
        stack.restart("mission")
        stack.run_until(lambda: seen(4), 60.0, "the other lane")
        run.until("finished", 5.0)
        assert run.state.result_description[0].startswith("all lanes are driven: 4 of 4")
        way = lanes(order.steps[0].area.reshape(-1, 2), SWATH, (x, y))
        assert len(way) == 4
        for place in way:
            assert min(math.dist(place, at) for at in track) < 0.3
        driven = sum(math.dist(a, b) for a, b in pairwise(track))
        assert driven < 2.0 * sum(math.dist(a, b) for a, b in pairwise(way)), "no lane twice"
        assert not stack.newest[t.ROBOT_STATE].estop
