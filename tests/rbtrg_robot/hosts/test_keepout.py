"""Areas that the robot keeps out of: drawn while it drives, in lockstep, judged by the truth."""

from __future__ import annotations

import math

import pytest

from hal.safety.geofence import Fence
from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.areas import fence_of, ground_area
from rbtrg_robot.hosts.lockstep import Lockstep
from rbtrg_robot.wire.messages import header
from tests.hal.safety.test_geofence import deepest, rim
from tests.rbtrg_robot.hosts.test_guard import by_hand
from tests.rbtrg_robot.hosts.test_lockstep import SPARSE, ahead, config, speed, truth


def box(stack: Lockstep, near: float, far: float, half: float) -> list[tuple[float, float]]:
    """Corners of a rectangle that lies across the way."""
    return [ahead(stack, *place) for place in ((near, -half), (far, -half), (far, half), (near, half))]


def draw(stack: Lockstep, *areas: msg.GroundArea) -> None:
    """An operator draws."""
    wanted = msg.Areas(header=header(stack.now, "map"), id="drawn", areas=list(areas))
    stack.host.inject(t.AREAS_REQUEST, wanted)


def deepest_until(stack: Lockstep, fence: Fence, seconds: float) -> float:
    """How deep a side came under the true body [m], until the goal ends."""
    places, deep = rim(fence), -math.inf
    for _ in range(round(10 * seconds)):
        stack.run(0.1)
        deep = max(deep, deepest(places, *truth(stack)))
        if stack.newest[t.GOAL_STATUS].state in ("reached", "aborted", "rejected"):
            break
    return deep


@pytest.mark.campaign
def test_the_robot_drives_around_what_is_drawn_into_its_way() -> None:
    with Lockstep(config(sim=SPARSE)) as stack:
        stack.wait_ready()
        pond = ground_area("pond", box(stack, 1.6, 2.2, 0.6), keep_out=True)
        inside, goal = ahead(stack, 1.9), ahead(stack, 3.4)
        stack.send_goal(*goal)
        stack.run_until(lambda: speed(stack) > 0.3, 10.0, "motion")
        draw(stack, pond)
        stack.run(0.3)
        assert stack.newest[t.GOAL_STATUS].state != "reached"
        deep = deepest_until(stack, fence_of([pond]), 40.0)
        assert stack.newest[t.GOAL_STATUS].state == "reached"
        assert math.dist(goal, truth(stack)[:2]) < 0.25
        assert deep < 0.0
        stack.send_goal(*inside)
        stack.run(0.3)
        status = stack.newest[t.GOAL_STATUS]
        assert (status.state, status.reason) == ("rejected", "keep_out_area")


def test_hands_cannot_drive_into_it_and_it_outlives_the_process_that_tells_of_it() -> None:
    with Lockstep(config(sim=SPARSE)) as stack:
        stack.wait_ready()
        pond = ground_area("pond", box(stack, 1.2, 2.2, 1.0), keep_out=True)
        draw(stack, pond)
        stack.run(0.3)
        stack.kill("elevation")
        stack.restart("elevation")
        stack.run(2.0)
        places, deep = rim(fence_of([pond])), -math.inf
        for _ in range(60):
            by_hand(stack, 0.1, 0.4)
            deep = max(deep, deepest(places, *truth(stack)))
            if "keep-out" in stack.newest[t.ROBOT_STATE].hold and speed(stack) < 0.01:
                break
        assert stack.newest[t.ROBOT_STATE].hold == "geofence: the keep-out area pond"
        assert -0.2 < deep < 0.0
