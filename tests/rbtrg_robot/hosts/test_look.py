"""The whole stack looks at the ground ahead where no way begins, and the trunk is level again whatever happens."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import pytest

from hal.lidar.config import only
from hal.rotation import up_of
from rbtrg_robot import topics as t
from rbtrg_robot.config import load
from rbtrg_robot.hosts.lockstep import Lockstep

LEVEL = math.radians(3.0)
"""What the robot takes for level is off by the error of its IMU's attitude."""
LOW = math.radians(10.0)


def lean(stack: Lockstep) -> float:
    """True angle [rad] of the trunk to the vertical."""
    q = stack.newest[t.TRUTH].pose.pose.orientation
    return math.acos(min(1.0, float(up_of(np.array([q.w, q.x, q.y, q.z]))[2])))


@pytest.fixture
def looking() -> Iterator[Lockstep]:
    """Nose down: without the LiDAR in the head nothing but ground taken for granted lies before its feet."""
    config = load(
        None,
        ["sim.lidar_step=4"],
        scene="lanes:41,level=4,controller=vmc",
        controller="vmc",
        lidars=only("xt16"),
    )
    with Lockstep(config) as stack:
        stack.wait_ready()
        stack.send_goal(*config.load_scene().goals["end"][:2])
        stack.run_until(lambda: lean(stack) > LOW, 12.0, "a look")
        yield stack


def test_it_drives_when_the_trunk_is_level_again(looking: Lockstep) -> None:
    assert looking.newest[t.GOAL_STATUS].detail == "looking at the ground ahead"
    assert looking.newest[t.TRACKER_STATE].phase == "looking"
    place, leans = _place(looking), []
    while looking.newest[t.ROBOT_STATE].vx == 0.0 and looking.newest[t.ROBOT_STATE].wz == 0.0:
        looking.step()
        leans.append(lean(looking))
        assert len(leans) < 4000, "a second look, if the first showed no way"
    assert max(leans) < math.radians(17.0)
    assert leans[-1] < LEVEL
    assert math.dist(_place(looking), place) < 0.05


@pytest.mark.parametrize(
    "trouble",
    ["tracker", *(pytest.param(name, marks=pytest.mark.campaign) for name in ("stop", "navigator"))],
)
def test_the_trunk_is_level_after_a_stop_or_the_death_of_a_commander(looking: Lockstep, trouble: str) -> None:
    if trouble == "stop":
        looking.command("stop")
    else:
        looking.kill(trouble)
    looking.run(0.9)
    assert lean(looking) < LEVEL
    looking.run(1.0)
    assert lean(looking) < LEVEL
    assert looking.newest[t.ROBOT_STATE].trunk_pitch == 0.0


def _place(stack: Lockstep) -> tuple[float, float]:
    place = stack.newest[t.TRUTH].pose.pose.position
    return place.x, place.y
