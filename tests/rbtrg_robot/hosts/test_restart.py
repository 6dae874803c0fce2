"""Odometry and elevation die while the robot drives, and come back: the goal goes on, pose and map do not jump."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hal.types import NS
from mapping.elevation.exchange import PATCH_LAYERS, MapPatch
from mapping.elevation.map import ElevationMap
from rbtrg_robot import topics as t
from rbtrg_robot.config import StackConfig, load
from rbtrg_robot.hosts.lockstep import Lockstep, build_stages
from rbtrg_robot.provenance import fingerprint
from rbtrg_robot.stages import elevation
from rbtrg_robot.wire.convert import MAP, ODOM, transform_msg, yaw_of
from rbtrg_robot.wire.messages import decode, encode, header, stamp_of
from tests.rbtrg_robot.stages.test_planner import patch


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


def restarted(seconds: float, planner: bool, stage: Any = None, **status: Any) -> list[Any]:
    """What a restarted elevation process tells in this time, which gets no part of its map back. `planner`: one without
    a map runs."""
    stage = stage or build_stages(config(), ["elevation"])["elevation"][0]
    stage.on(
        t.MAP_STATUS,
        t.MAP_STATUS.kind(**({"known_cells": 500, "epoch": 2, "height_correction": 0.01} | status)),
    )
    told = []
    for now in range(NS, NS + round(seconds * NS), NS // 10):
        told += stage.tick(now)
        if planner and now % (NS // 2) == 0:
            told += stage.on(t.ROUTE_STATUS, t.ROUTE_STATUS.kind(header=header(now, MAP)))
    return [message for topic, message in told if topic is t.MAP_STATUS]


@pytest.mark.parametrize(("planner", "seconds"), [(True, 5.0), (False, 40.0)])
def test_without_the_planner_a_restarted_map_begins_anew_and_says_so(planner: bool, seconds: float) -> None:
    statuses = restarted(seconds, planner)
    assert statuses[0].restoring
    assert not statuses[-1].restoring
    assert "planner did not answer" in statuses[-1].detail
    assert statuses[-1].epoch == 2


def test_a_planner_that_is_busy_for_half_a_minute_still_gives_the_map_back() -> None:
    """On a loaded computer an answer across 100 x 100 m took longer than 3 s: the map of before was given up."""
    stage = build_stages(config(), ["elevation"])["elevation"][0]
    assert restarted(30.0, False, stage)[-1].restoring
    ground = np.zeros((64, 64))
    giver = build_stages(config(), ["planner"])["planner"][0]
    giver.on(t.MAP_UPDATE, patch(ground))
    stage.on(t.ROUTE_STATUS, t.ROUTE_STATUS.kind(header=header(2 * NS, MAP)))  # from before it was asked
    for topic, part in giver.on(t.MAP_STATUS, t.MAP_STATUS.kind(restoring=True)):
        assert topic is t.MAP_MIRROR
        stage.on(topic, part)
    assert not stage._handover.under_way
    assert "came back from the planner" in stage._detail


@pytest.fixture(scope="module")
def prior(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A map with a cloud, in which the robot has to be found."""
    file = tmp_path_factory.mktemp("prior") / "map.npz"
    made = ElevationMap()
    one = np.ones((100, 100), np.float32)
    layers = dict.fromkeys(PATCH_LAYERS, one) | {
        "elevation": 0.0 * one,
        "source": 2.0 * one,
        "variance": 1e-4 * one,
    }
    made.restore(MapPatch((0.0, 0.0), 0.04, 7, 0, layers))
    made.cloud.enter(np.random.default_rng(0).uniform(0.0, 3.0, (50, 3)).astype(np.float32))
    made.save(file)
    return file


@pytest.mark.parametrize("known", [True, False], ids=["located", "searching"])
def test_a_robot_whose_map_is_lost_goes_on_with_the_prior_one(prior: Path, known: bool) -> None:
    """It had been found in it: nothing was left of the map, for good."""
    stack = config(map_file=str(prior))
    location = "located" if known else "searching"
    stage = elevation.build_again(stack)
    statuses = restarted(5.0, True, stage, prior=fingerprint(str(prior)), location=location)
    assert (statuses[0].known_cells, statuses[0].restoring) == (0, True)
    assert statuses[-1].known_cells == (100 * 100 if known else 0)
    assert statuses[-1].location == location
    assert statuses[-1].prior == fingerprint(str(prior))


def test_a_restarted_process_reads_no_prior_map_that_the_planner_gives_back(
    prior: Path, monkeypatch: Any
) -> None:
    read: list[str] = []
    load_prior = ElevationMap.load_prior
    monkeypatch.setattr(
        ElevationMap, "load_prior", lambda self, path: (read.append("read"), load_prior(self, path))[1]
    )
    stack = config(map_file=str(prior))
    told = {"prior": fingerprint(str(prior)), "location": "located", "known_cells": 9}
    stage = elevation.build_again(stack)
    stage.on(t.MAP_STATUS, t.MAP_STATUS.kind(**told))
    assert not read
    stage.on(t.MAP_STATUS, t.MAP_STATUS.kind(epoch=2**32 - 1, **told))
    assert read == ["read"], "a status that cannot be is none: it begins as a first one does"
    read.clear()
    again = elevation.build_again(stack)
    again.on(t.MAP_STATUS, t.MAP_STATUS.kind(location="searching", prior=told["prior"]))
    assert read == ["read"]
    assert again._location.state == "searching"


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
