"""The planner's speed for each place of the path is what the tracker drives, through the messages of the stack."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from hal.types import NS
from mapping.elevation.exchange import PATCH_LAYERS, MapPatch
from rbtrg_robot import topics as t
from rbtrg_robot.config import load
from rbtrg_robot.stages import planner, tracker
from rbtrg_robot.stages.navigation import navigator
from rbtrg_robot.wire.convert import odometry_msg, patch_msg, rpy_quaternion
from rbtrg_robot.wire.messages import decode, encode, header
from tests.rbtrg_robot.hearsay import map_offset

RES = 0.04


def ramp() -> Any:
    """Map message: level ground 9 x 3 m with a ramp of 15 deg up and down again from x = 3 to x = 5."""
    x = np.tile(np.arange(225) * RES, (75, 1))
    height = np.tan(np.radians(15.0)) * np.clip(1.0 - np.abs(x - 4.0), 0.0, None)
    layers = {name: np.zeros(height.shape, np.float32) for name in PATCH_LAYERS}
    layers["elevation"] = height.astype(np.float32)
    layers["trusted"][:] = 1.0
    layers["upper_bound"][:] = np.nan
    return patch_msg(MapPatch((0.0, 0.0), RES, NS, 0, layers))


def drive(seconds: float) -> tuple[list[tuple[float, float]], Any]:
    """x [m] and commanded speed [m/s] of a robot that does at once what the tracker says, and the plan."""
    config = load(
        None,
        ["tracker.max_speed=0.8", "sim.lidar_step=8"],
        scene="flat",
        area=[(0, 0), (9, 0), (9, 3), (0, 3)],
    )
    stages = [m.build(config) for m in (planner, navigator, tracker)]
    x, y, yaw, v, w = 1.0, 1.5, 0.0, 0.0, 0.0
    log, plans, now = [], [], 0

    def send(topic: Any, message: Any) -> None:
        nonlocal v, w
        if topic is t.CMD_VEL:
            v, w = message.twist.linear.x, message.twist.angular.z
        if topic is t.PLAN:
            plans.append(message)
        message = decode(encode(message), topic.kind)
        for stage in stages:
            if topic in stage.inputs:
                for out in stage.on(topic, message):
                    send(*out)

    send(t.TF_STATIC, map_offset())
    send(t.MAP_UPDATE, ramp())
    for step in range(round(seconds * 50)):
        now += NS // 50
        q = rpy_quaternion((0.0, 0.0, yaw))  # level: the tracker's own care on slopes has nothing to go by
        pose = odometry_msg(now, (x, y, 0.0), q, np.array([v, 0.0, 0.0]), np.array([0.0, 0.0, w]))
        send(t.POSE, pose)
        if step % 5 == 0:
            send(t.ODOM, pose)
            send(t.ODOM_HEALTH, t.ODOM_HEALTH.kind(header=header(now, "odom"), health="good"))
            send(t.MAP_STATUS, t.MAP_STATUS.kind(header=header(now, "map")))
        if step == 10:
            send(t.GOAL_REQUEST, t.GOAL_REQUEST.kind(header=header(now, "map"), id="g", x=8.0, y=1.5))
        for stage, every in zip(stages, (5, 5, 1), strict=True):
            if step % every == 0:
                for out in stage.tick(now):
                    send(*out)
        x, y = x + 0.02 * v * math.cos(yaw), y + 0.02 * v * math.sin(yaw)
        yaw += 0.02 * w
        log.append((x, v))
    return log, plans[-1]


def test_the_tracker_drives_no_faster_than_the_planner_allows_for_slope_and_risk() -> None:
    log, plan = drive(35.0)
    assert plan.ok
    assert plan.reaches_goal
    x, v = np.array(log).T
    assert x[-1] > 7.8, "it arrived"
    allowed = np.interp(x, plan.x, plan.speed)
    moving = (v > 0.12) & (x < 7.5)
    # the command is slewed, and acts at once in this world: a little late it may be, not fast
    assert (v[moving] <= allowed[moving] + 0.02).all()
    level, sloped = (np.median(v[(x > a) & (x < b)]) for a, b in ((1.8, 2.4), (3.4, 3.8)))
    assert level > 0.7
    assert 0.4 < sloped < 0.8 * level
