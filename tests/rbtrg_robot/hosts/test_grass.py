"""The whole stack before a belt of grass: it drives through, slowly, and keeps off the box that is as high as the
grass."""

from __future__ import annotations

import importlib
import math

import numpy as np
import pytest

from hal.robots.go2w.facts import BODY_LENGTH, BODY_WIDTH
from mapping.elevation.tiles import PLANTS
from rbtrg_robot import topics as t
from rbtrg_robot.config import load
from rbtrg_robot.hosts.lockstep import Lockstep
from rbtrg_robot.stages.navigation.goal import GoalState
from rbtrg_robot.wire.convert import yaw_of


def inside(x: np.ndarray, y: np.ndarray, box: tuple[float, ...]) -> np.ndarray:
    return (abs(x - box[0]) < box[2] / 2) & (abs(y - box[1]) < box[3] / 2)


@pytest.mark.campaign
def test_a_goal_behind_a_belt_of_grass_is_driven_to_through_it(monkeypatch: pytest.MonkeyPatch) -> None:
    belt, box = (-0.5, 0.0, 0.5, 5.8, 0.30), (-0.5, 1.0, 0.4, 0.4, 0.30)
    meadow = importlib.import_module("hal.scenes.meadow")  # its package has a function of that name
    monkeypatch.setattr(meadow, "CLUMPS", ((-0.5, -1.05, 0.5, 3.7, 0.30), (-0.5, 2.05, 0.5, 1.7, 0.30)))
    monkeypatch.setattr(meadow, "BOXES", (box,))
    u, v = np.meshgrid(np.linspace(-0.5, 0.5, 15) * BODY_LENGTH, np.linspace(-0.5, 0.5, 9) * BODY_WIDTH)
    fastest, deepest = 0.0, 0.0
    with Lockstep(load(None, [], scene="meadow")) as stack:
        stack.wait_ready()
        stack.send_goal(0.7, 0.3)  # on the straight way to it the box would be touched
        stack.run(0.2)
        while not GoalState(stack.newest[t.GOAL_STATUS].state).terminal and stack.seconds < 40.0:
            stack.run(0.2)
            truth = stack.newest[t.TRUTH]
            place, yaw = truth.pose.pose.position, yaw_of(truth.pose.pose.orientation)
            x = place.x + math.cos(yaw) * u - math.sin(yaw) * v
            y = place.y + math.sin(yaw) * u + math.cos(yaw) * v
            share = inside(x, y, belt).mean()
            deepest = max(deepest, share)
            if share > 0.2:
                fastest = max(fastest, math.hypot(truth.twist.twist.linear.x, truth.twist.twist.linear.y))
            assert not inside(x, y, box).any()
        assert GoalState(stack.newest[t.GOAL_STATUS].state) is GoalState.REACHED
        window = stack.host.stage("elevation").map.window(-0.5, 0.0, 2.0)
    assert deepest > 0.5
    assert fastest < 0.3, "0.2 m/s, with what the controller overshoots"
    rows, cols = window.shape
    x, y = np.meshgrid(window.origin[0] + 0.04 * np.arange(cols), window.origin[1] + 0.04 * np.arange(rows))
    plants = window.layers["source"] == PLANTS
    near = inside(x, y, belt) & (np.abs(y) < 0.7)
    assert plants[near].mean() > 0.8
    assert not plants[inside(x, y, (*box[:2], 0.3, 0.3))].any()
