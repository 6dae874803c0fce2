"""The whole stack before an edge of half a metre: it sees the edge and stays away, because at its speed no reflex could
save it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from rbtrg_robot import topics as t
from rbtrg_robot.config import load
from rbtrg_robot.hosts.lockstep import Lockstep
from rbtrg_robot.stages.navigation.goal import GoalState

EDGE = 2.1
"""Distance from the start to the edge, straight ahead [m]."""


@pytest.mark.campaign
def test_a_goal_beyond_a_cliff_does_not_lead_over_it(tmp_path: Path) -> None:
    axis = np.arange(201) * 0.05 - 5.0
    x, y = np.meshgrid(axis, axis)
    across = np.radians(20.0)
    beyond = (x - EDGE) * np.cos(across) + y * np.sin(across)
    height = np.where(beyond > 0.0, 0.0, 0.5).astype(np.float32)
    file = tmp_path / "edge.npz"
    np.savez(file, height=height, resolution=0.05, origin=np.array([-5.0, -5.0]))
    closest = -np.inf
    with Lockstep(load(None, [], scene=str(file), origin=(0.0, 0.0, 0.0))) as stack:
        stack.wait_ready()
        stack.send_goal(3.2, 0.0)
        stack.run(0.2)
        while not GoalState(stack.newest[t.GOAL_STATUS].state).terminal and stack.seconds < 16.0:
            stack.run(0.4)
            place = stack.newest[t.TRUTH].pose.pose.position
            ahead = (place.x - EDGE) * np.cos(across) + place.y * np.sin(across)
            closest = max(closest, ahead)
            assert place.z > 0.5 + 0.3, "still on its wheels, on top"
    assert -1.2 < closest < -0.25, "it came to look, and stayed on top"
