"""A robot that starts elsewhere than its prior map was begun finds itself in it, in the closed loop."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.config import load
from rbtrg_robot.hosts.lockstep import Lockstep
from rbtrg_robot.orders.map import save
from rbtrg_robot.topics import Topic
from rbtrg_robot.wire.convert import cloud_points, map_patch
from rbtrg_robot.wire.messages import decode
from tests.rbtrg_robot.hosts.test_initial_pose import Placed

SPARSE = ["sim.lidar_step=8"]


def mapped(file: Path) -> tuple[float, float, float]:
    """A map of the yard's south-west corner whose origin is where the robot stands, turned; returns where in that map
    the robot stood."""
    got: dict[Topic, bytes] = {}
    with Lockstep(load(None, SPARSE, scene="yard")) as stack:
        stack.host.listen(
            lambda topic, payload, _now: got.__setitem__(topic, payload), {t.MAP_PARTS, t.MAP_CLOUD}
        )
        stack.wait_ready()
        placed = Placed(stack)
        stack.run(0.3)
        placed.say(0.0, 0.0, 1.0)
        stack.run(2.0)
        stack.host.inject(t.MAP_REQUEST, msg.MapRequest(action="parts"))
        patch = map_patch(decode(got[t.MAP_PARTS], msg.MapPart).map, 0)
        cloud = cloud_points(decode(got[t.MAP_CLOUD], msg.PointCloud2))
        assert len(cloud) > 500
        save([patch], cloud, file)
        return placed.here


def test_up_with_a_map_finds_the_robot_before_it_drives(tmp_path: Path) -> None:
    file = tmp_path / "corner.npz"
    expected = mapped(file)
    with Lockstep(load(None, SPARSE, scene="yard", map_file=str(file))) as stack:
        placed = Placed(stack)
        # The configuration says (-4.5, -4.5, 0): the scene's start. In the map that is the origin.
        stack.run(0.6)
        assert stack.newest[t.MAP_STATUS].location == "searching"
        stack.send_goal(0.6, 0.9)
        stack.run(0.1)
        goal = stack.newest[t.GOAL_STATUS]
        assert (goal.state, goal.reason) == ("rejected", "not_located")
        stack.wait_ready()
        status = stack.newest[t.MAP_STATUS]
        assert status.location == "located"
        assert status.location_detail.startswith("located in corner.npz at ")
        assert "certainty" in status.location_detail
        assert placed.here == pytest.approx(expected, abs=0.05)
        assert status.known_cells > 2000
        epoch = status.epoch
        # What was found outlives the process that found it.
        stack.kill("elevation")
        stack.run(0.3)
        stack.restart("elevation")
        stack.run(1.5)
        status = stack.newest[t.MAP_STATUS]
        assert (status.location, status.warning) == ("located", "")
        assert status.epoch >= epoch
        # An operator overrules it; what the scans show around there is taken.
        placed.say(expected[0] + 0.4, expected[1] - 0.3, expected[2] + 0.2)
        stack.run(0.2)
        assert stack.newest[t.MAP_STATUS].location in ("located", "searching")
        stack.send_goal(0.6, 0.9)
        here = placed.here
        assert math.dist(here[:2], expected[:2]) < 0.6
