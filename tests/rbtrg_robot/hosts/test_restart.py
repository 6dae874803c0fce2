"""Odometry and elevation die while the robot drives, and come back: the goal goes on, pose and map do not jump."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from rbtrg_robot import topics as t
from rbtrg_robot.config import StackConfig, load
from rbtrg_robot.hosts.lockstep import Lockstep, build_stages
from rbtrg_robot.wire.convert import MAP, ODOM, transform_msg, yaw_of
from rbtrg_robot.wire.messages import decode, encode, stamp_of


def config(**flags: Any) -> StackConfig:
    return load(None, [], **({"scene": "yard"} | flags))


def truth(stack: Lockstep) -> np.ndarray:
    """True x, y, z [m] and yaw [rad] in the scene."""
    pose = stack.newest[t.TRUTH].pose.pose
    return np.array([pose.position.x, pose.position.y, pose.position.z, yaw_of(pose.orientation)])


def speed(stack: Lockstep) -> float:
    twist = stack.newest[t.TRUTH].twist.twist.linear
    return math.hypot(twist.x, twist.y)


def error(stack: Lockstep) -> float:
    """Error of the newest pose in `map`, planar [m]; the robot stands, so stamps do not matter."""
    frame = stack.host.stage("navigator")._frame
    pose = stack.newest[t.ODOM].pose.pose
    x, y, _ = frame.pose2(pose.position.x, pose.position.y, 0.0)
    return math.dist((x, y), truth(stack)[:2])


def driving(stack: Lockstep) -> None:
    """On the way to a goal 3.5 m ahead."""
    stack.wait_ready()
    x, y, _, yaw = truth(stack)
    stack.send_goal(x + 3.5 * math.cos(yaw), y + 3.5 * math.sin(yaw))
    stack.run_until(lambda: math.dist(truth(stack)[:2], (x, y)) > 1.0 and speed(stack) > 0.3, 20.0, "motion")


@pytest.mark.campaign
@pytest.mark.parametrize("process", ["odometry", "elevation"])
def test_the_goal_goes_on_after_a_restart(process: str) -> None:
    with Lockstep(config()) as stack:
        driving(stack)
        before = stack.newest[t.MAP_STATUS]
        stack.kill(process)
        stack.run(2.0)
        assert speed(stack) < 0.05
        assert stack.newest[t.GOAL_STATUS].state == "moving"
        stack.restart(process)
        again = stack.now
        stack.run_until(
            lambda: (
                stamp_of(stack.newest[t.MAP_STATUS]) > again
                and stamp_of(stack.newest[t.ODOM_HEALTH]) > again
                and stack.newest[t.ODOM_HEALTH].health == "good"
                and not stack.newest[t.MAP_STATUS].restoring
                and stack.newest[t.MAP_STATUS].trusted_cells > 0
            ),
            5.0,
            "readiness again",
        )
        assert error(stack) < 0.03  # the robot coasted 0.1 m while nobody watched
        after = stack.newest[t.MAP_STATUS]
        assert after.trusted_cells > 0.9 * before.trusted_cells
        assert after.known_cells > 0.7 * before.known_cells  # stray cells never reached the planner
        if process == "elevation":
            assert "came back from the planner" in after.detail
        status = stack.finish_goal(40.0)
        assert (status.state, status.reason) == ("reached", "")
        stack.run(1.0)
        assert error(stack) < 0.03
        status = stack.newest[t.MAP_STATUS]
        assert abs(status.height_correction) < 0.03


def test_odometry_comes_back_on_open_ground_where_one_scan_makes_hardly_any_plane() -> None:
    with Lockstep(load(None, ["sim.lidar_step=8"], scene="flat", seed=3)) as stack:
        stack.wait_ready()
        stack.kill("odometry")
        stack.run(0.5)
        stack.restart("odometry")
        again = stack.now
        stack.run_until(
            lambda: stamp_of(health := stack.newest[t.ODOM_HEALTH]) > again and health.health == "good",
            3.0,
            "odometry again",
        )
        assert error(stack) < 0.03


def test_without_the_planner_a_restarted_map_begins_anew_and_says_so() -> None:
    stage = build_stages(config(), ["elevation"])["elevation"][0]
    stage.on(t.MAP_STATUS, t.MAP_STATUS.kind(known_cells=500, epoch=2, height_correction=0.01))
    statuses = [m for k in range(50) for topic, m in stage.tick(10**9 + k * 10**8) if topic is t.MAP_STATUS]
    assert statuses[0].restoring
    assert not statuses[-1].restoring
    assert "planner did not answer" in statuses[-1].detail
    assert statuses[-1].epoch == 2


def test_a_broken_status_of_before_leaves_a_map_that_can_begin_anew() -> None:
    stage = build_stages(config(), ["elevation"])["elevation"][0]
    assert stage.on(t.MAP_STATUS, t.MAP_STATUS.kind(epoch=2**32 - 1)) == []
    for x in (0.0, 1.0):
        place = transform_msg(0, MAP, ODOM, np.array([x, 0.0, 0.0]), (0.0, 0.0, 0.0, 1.0))
        found = stage.on(t.TF_STATIC, t.TF_STATIC.kind(transforms=[place]))
    told = [decode(encode(m), topic.kind) for topic, m in found if topic is t.MAP_STATUS]
    assert [(status.epoch, status.refused) for status in told] == [(1, 1)]


def test_a_fresh_start_waits_for_nobody() -> None:
    stage = build_stages(config(), ["elevation"])["elevation"][0]
    (topic, status), *_ = stage.tick(10**9)
    assert topic is t.MAP_STATUS
    assert not status.restoring
