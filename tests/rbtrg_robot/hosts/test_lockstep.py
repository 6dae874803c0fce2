"""Closed loops in lockstep: the whole stack on the simulated robot, judged by the truth it never sees."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hal.rotation import wrap
from rbtrg_robot import topics as t
from rbtrg_robot.config import StackConfig, load
from rbtrg_robot.hosts.lockstep import Lockstep
from rbtrg_robot.hosts.offline import rerun
from rbtrg_robot.log.read import read_run
from rbtrg_robot.topics import Topic
from rbtrg_robot.wire.convert import yaw_of
from rbtrg_robot.wire.frames import MapFrame
from rbtrg_robot.wire.messages import decode, header, stamp_of

SPARSE = {"lidar_step": 8}
"""Every eighth firing: for what does not hang on how much the robot sees."""


def config(**flags: Any) -> StackConfig:
    """The flat scene unless told otherwise."""
    return load(None, [], **({"scene": "flat"} | flags))


def put_box(stack: Lockstep, *centre: float) -> None:
    """The one obstacle of the simulator stands there from now on; x, y, z [m]."""
    backend = stack.robot.backend
    box = replace(backend.config.obstacles[0], centre=centre, appear=0.0)
    backend.config = backend.config.model_copy(update={"obstacles": (box,)})


def truth(stack: Lockstep) -> tuple[float, float, float]:
    """True x, y [m], yaw [rad] in the scene."""
    pose = stack.newest[t.TRUTH].pose.pose
    return pose.position.x, pose.position.y, yaw_of(pose.orientation)


def speed(stack: Lockstep) -> float:
    """True speed [m/s]."""
    twist = stack.newest[t.TRUTH].twist.twist.linear
    return math.hypot(twist.x, twist.y)


@pytest.fixture
def stack() -> Iterator[Lockstep]:
    """A ready stack on flat ground."""
    with Lockstep(config(sim=SPARSE)) as made:
        made.wait_ready()
        yield made


@pytest.fixture(scope="module")
def standing() -> Iterator[Lockstep]:
    """One for the tests after which it stands as before, wherever."""
    with Lockstep(config(sim=SPARSE)) as made:
        made.wait_ready()
        yield made


def ahead(stack: Lockstep, distance: float, side: float = 0.0) -> tuple[float, float]:
    """A place in front of the robot, in `map`."""
    x, y, yaw = truth(stack)
    c, s = math.cos(yaw), math.sin(yaw)
    return x + c * distance - s * side, y + s * distance + c * side


def test_a_goal_is_reached_in_truth(stack: Lockstep) -> None:
    x, y = ahead(stack, 1.2, 0.5)
    yaw = truth(stack)[2] + math.pi / 2
    stack.send_goal(x, y, yaw)
    status = stack.finish_goal(40.0)
    assert (status.state, status.reason) == ("reached", "")
    stack.run(1.0)
    tx, ty, tyaw = truth(stack)
    assert math.hypot(tx - x, ty - y) < 0.25
    assert abs(wrap(tyaw - yaw)) < math.radians(10.0)
    assert speed(stack) < 0.05
    states = [s.state for s in stack.statuses]
    for state in ("accepted", "planning", "moving", "reached"):
        assert state in states


def test_the_emergency_stop_stops_now_and_stays(stack: Lockstep) -> None:
    stack.send_goal(*ahead(stack, 4.0))
    stack.run_until(lambda: speed(stack) > 0.3, 10.0, "motion")
    stack.command("stop", "test")
    stack.run(0.2)
    state = stack.newest[t.ROBOT_STATE]
    assert (state.estop, state.vx, state.wz) == (True, 0.0, 0.0)
    assert "test" in state.estop_cause
    stack.run(1.5)
    assert speed(stack) < 0.05
    assert (stack.newest[t.GOAL_STATUS].state, stack.newest[t.GOAL_STATUS].reason) == (
        "aborted",
        "emergency_stop",
    )
    place = truth(stack)
    stack.send_goal(*ahead(stack, 2.0))
    stack.run(1.0)
    assert stack.newest[t.GOAL_STATUS].state == "rejected"
    assert math.dist(place[:2], truth(stack)[:2]) < 0.02
    stack.command("resume")
    stack.run(0.2)
    stack.send_goal(*ahead(stack, 1.0))
    stack.run_until(lambda: speed(stack) > 0.2, 10.0, "motion once released")


def test_without_a_process_that_matters_the_robot_stands(stack: Lockstep) -> None:
    stack.send_goal(*ahead(stack, 6.0))
    for process in ("odometry", "elevation", "navigator", "tracker", "guard"):
        stack.run_until(lambda: speed(stack) > 0.3, 10.0, f"motion before {process} is lost")
        stack.robot.alive(process, False)
        stack.run(0.1)
        assert stack.newest[t.ROBOT_STATE].vx == 0.0, process
        assert process in stack.newest[t.ROBOT_STATE].hold
        stack.run(0.4)
        assert speed(stack) < 0.08, process
        stack.robot.alive(process, True)
    stack.run_until(lambda: speed(stack) > 0.3, 10.0, "motion again")


def test_cancel_stops_the_robot(standing: Lockstep) -> None:
    standing.send_goal(*ahead(standing, 4.0))
    standing.run_until(lambda: speed(standing) > 0.3, 10.0, "motion")
    standing.host.inject(t.GOAL_REQUEST, t.GOAL_REQUEST.kind(header=header(standing.now, "map"), action=1))
    standing.run(1.5)
    assert standing.newest[t.GOAL_STATUS].state == "cancelled"
    assert speed(standing) < 0.05


def test_commands_that_make_no_sense_are_refused_and_counted(standing: Lockstep) -> None:
    place = truth(standing)
    for vx, frame in ((math.nan, "base_link"), (50.0, "base_link"), (0.3, "map")):
        message = t.CMD_VEL.kind(header=header(standing.now, frame))
        message.twist.linear.x = vx
        standing.host.inject(t.CMD_VEL, message)
    standing.run(0.3)
    state = standing.newest[t.ROBOT_STATE]
    refused = dict(zip(state.refused_reason, state.refused_count, strict=True))
    assert refused == {"not finite": 1, "wrong frame": 1, "over limit": 1}
    assert math.dist(place[:2], truth(standing)[:2]) < 0.02


def test_the_fence_holds_while_the_start_in_the_map_is_unknown() -> None:
    fence = [(-2, -2), (3, -2), (3, 2), (-2, 2)]
    with Lockstep(config(origin=(0.0, 0.0, 0.0), area=fence, sim=SPARSE)) as stack:
        stack.wait_ready()
        stack.robot._frame = MapFrame()
        place = truth(stack)
        stack.send_goal(*ahead(stack, 2.0))
        stack.run(2.0)
        assert stack.newest[t.ROBOT_STATE].hold == "no pose for the geofence"
        assert math.dist(place[:2], truth(stack)[:2]) < 0.02


@pytest.mark.campaign
def test_the_nearest_goal_to_the_fence_that_is_accepted_is_reached() -> None:
    room = 0.47
    side = 1.2
    area = [(-side, -side), (side, -side), (side, side), (-side, side)]
    with Lockstep(config(origin=(0.0, 0.0, 0.0), area=area)) as stack:
        stack.wait_ready()
        stack.send_goal(side - room + 0.02, 0.0)
        stack.run(0.2)
        assert stack.newest[t.GOAL_STATUS].state == "rejected"
        for goal in ((side - room, 0.0), (side - room, side - room)):
            stack.send_goal(*goal)
            assert stack.finish_goal(40.0).state == "reached"
            assert math.dist(goal, truth(stack)[:2]) < 0.25


def test_a_goal_outside_the_area_is_rejected(standing: Lockstep) -> None:
    x0, _, _, _ = config().load_scene().extent
    standing.send_goal(x0 - 1.0, truth(standing)[1])
    status = standing.finish_goal(20.0)
    assert (status.state, status.reason) == ("rejected", "outside_area")


def test_the_same_seed_gives_the_same_log_and_a_rerun_gives_the_recorded_map(tmp_path: Path) -> None:
    files = []
    for name in ("a", "b"):
        conf = config(seed=5, sim=SPARSE, recorder={"profile": "full"})
        path = tmp_path / f"{name}.mcap"
        with Lockstep(conf, Lockstep.open_log(conf, path)) as stack:
            stack.wait_ready()
            stack.send_goal(*ahead(stack, 1.0))
            stack.run(1.0)
        files.append(path)
    assert files[0].read_bytes() == files[1].read_bytes()

    again = tmp_path / "again.mcap"
    names = ["odometry", "elevation", "planner"]
    rerun(files[0], names, again)
    twice = tmp_path / "twice.mcap"
    rerun(files[0], names, twice)
    assert again.read_bytes() == twice.read_bytes()
    before, after = payloads(files[0]), payloads(again)
    for topic in (t.ODOM, t.CLOUD, t.POSE, t.MAP_UPDATE, t.MAP_WINDOW, t.PLAN):
        assert before[topic]
        assert before[topic] == after[topic], topic.name


def payloads(path: Path) -> dict[Topic, list[bytes]]:
    """Wire bytes by topic."""
    found: dict[Topic, list[bytes]] = {}
    for entry in read_run(path):
        found.setdefault(t.BY_NAME[entry.topic], []).append(entry.data)
    return found


def test_no_message_lacks_frame_or_stamp(tmp_path: Path) -> None:
    conf = config(sim=SPARSE, recorder={"profile": "full"})
    path = tmp_path / "log.mcap"
    with Lockstep(conf, Lockstep.open_log(conf, path)) as stack:
        stack.wait_ready()
        stack.send_goal(*ahead(stack, 1.0))
        stack.run(1.0)
    frames: dict[str, set[str]] = {}
    for entry in read_run(path):
        message = decode(entry.data, entry.type)
        if hasattr(message, "header"):
            frames.setdefault(entry.topic, set()).add(message.header.frame_id)
            if entry.topic not in ("/goal/request", "/heartbeat"):
                assert 0 <= stamp_of(message) <= entry.log_time, entry.topic
    assert all(len(names) == 1 and "" not in names for names in frames.values()), frames
    assert frames["/lidar/main/points"] == {"lidar_main"}
    assert frames["/lidar/head/points"] == {"lidar_head"}
    assert frames["/odom"] == {"odom"}
    assert frames["/elevation_map/update"] == frames["/elevation_map/window"] == {"map"}
    steady = {x.name for x in t.TOPICS if x.rate and x.owner and "header" in x.kind.__slots__}
    steady.remove("/heartbeat")  # of processes, and here is one
    assert frames.keys() >= steady, steady - frames.keys()


@pytest.mark.campaign
def test_the_robot_brakes_for_what_suddenly_stands_before_it_and_drives_around() -> None:
    # It stands 0.25 m above what the model-based controller climbs, 0.1 m above what the default climbs: that one sees
    # it a sweep later
    # and need not stop.
    half = 0.2
    box = {"centre": (5.0, 5.0, 0.2), "size": (2 * half, 2 * half, 0.4), "appear": 1000.0}
    with Lockstep(config(origin=(0.0, 0.0, 0.0), controller="vmc", sim={"obstacles": [box]})) as stack:
        stack.wait_ready()
        stack.send_goal(4.6, 0.0)
        stack.run_until(lambda: truth(stack)[0] > 1.5 and speed(stack) > 0.45, 20.0, "cruising")
        appear = stack.seconds
        cx, cy = ahead(stack, 0.35 + 0.6 + half)
        put_box(stack, cx, cy, 0.2)
        slowest = np.inf
        closest = np.inf
        while stack.statuses[-1].state not in ("reached", "aborted") and stack.seconds < 40.0:
            stack.run(0.05)
            if stack.seconds - appear < 0.8:
                slowest = min(slowest, speed(stack))
            closest = min(closest, _distance(truth(stack), (cx - half, cx + half), (cy - half, cy + half)))
        assert stack.statuses[-1].state == "reached"
    assert slowest < 0.15, "seen in the window after the next scan, not with the next change of the map"
    assert closest > 0.0


def _distance(pose: tuple[float, float, float], xs: tuple[float, float], ys: tuple[float, float]) -> float:
    """From the rim of the body to a box along the axes [m]; 0 where they overlap."""
    u = np.linspace(-1.0, 1.0, 31)
    one = np.ones_like(u)
    rim = np.vstack([np.column_stack(side) for side in ((u, one), (u, -one), (one, u), (-one, u))])
    along, side = 0.35 * rim[:, 0], 0.218 * rim[:, 1]
    x = pose[0] + along * math.cos(pose[2]) - side * math.sin(pose[2])
    y = pose[1] + along * math.sin(pose[2]) + side * math.cos(pose[2])
    dx = np.maximum(0.0, np.maximum(xs[0] - x, x - xs[1]))
    dy = np.maximum(0.0, np.maximum(ys[0] - y, y - ys[1]))
    return float(np.hypot(dx, dy).min())
