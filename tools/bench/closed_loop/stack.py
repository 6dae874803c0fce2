"""One query driven by the whole stack in lockstep: it knows its start, its goal and what its sensors and its map say,
not the truth."""

from __future__ import annotations

import math
import tempfile
import time
from dataclasses import asdict, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from hal.mujoco.sim import Simulation
from hal.rotation import wrap
from hal.scenes import Pose
from hal.scenes.files import save_scene
from rbtrg_robot import topics as t
from rbtrg_robot.config import StackConfig, load
from rbtrg_robot.hosts.lockstep import Lockstep, LockstepTimeout
from rbtrg_robot.processes import PROCESSES
from rbtrg_robot.stages.navigation.goal import GoalState
from rbtrg_robot.wire.convert import yaw_of
from tools.bench.closed_loop import protocol as p
from tools.bench.closed_loop.routes import Route, scene_of
from tools.bench.closed_loop.trial import TRACK_EVERY, Watch, attitude, heading

WITHOUT = tuple(p.name for p in PROCESSES if p.hosted and p.name != "odometry")
"""Processes that are not needed to see where odometry begins."""
SETTLING_TIME = 15.0
"""So long the robot may take to stand [s]."""
WATCHED_AFTER = 1.5
"""The stack ends a goal at the first sign of a fall: how long the robot is watched then [s]."""


@lru_cache(maxsize=1)
def _folder() -> tempfile.TemporaryDirectory[str]:
    return tempfile.TemporaryDirectory(prefix="closed_loop-")


def files(scene: str) -> tuple[str, str]:
    """A scene with its apron and its survey as a prior map, as files written once per process."""
    ground, survey = (Path(_folder().name) / f"{scene}{ending}.npz" for ending in ("", "_survey"))
    if not survey.exists():
        truth = scene_of(scene).with_apron(p.APRON_WIDTH)
        assert truth.survey is not None
        save_scene(replace(truth, survey=None), ground)
        np.savez(survey, height=truth.survey, resolution=truth.resolution, origin=truth.origin)
    return str(ground), str(survey)


def drive(trial: p.Trial, route: Route, policy: str = "") -> dict[str, Any]:
    """The record of a trial. `route` is the line of `ours`: the robot begins along it, and looks at the goal where
    there is none.

    Depends on its arguments alone.
    """
    began = time.process_time()
    given = p.conditions(trial)
    start, goal = scene_of(trial.scene).pairs[trial.query]
    yaw = heading(route if route.line else replace(route, line=[list(start), list(goal)])) + given["dyaw"]
    ground, survey = files(trial.scene)
    placed = (start[0] + given["dx"], start[1] + given["dy"], yaw)
    config = load(
        None,
        [f"sim.friction={given['friction']}"],
        scene=ground,
        seed=trial.query,
        controller=trial.controller,
        policy_dir=policy or None,
        map_file=survey if trial.method == "ours-mapped" else "",
        origin=placed,
    )
    config = config.model_copy(update={"origin": stands(config, placed)})
    record: dict[str, Any] = {"key": trial.key, **asdict(trial), **given, "wall": route.wall}
    with Lockstep(config, placed=placed) as stack:
        record |= _follow(stack, goal)
        return record | {"cpu": time.process_time() - began, "simulated": stack.seconds}


def stands(config: StackConfig, placed: Pose) -> Pose:
    """x, y [m], yaw [rad] at which odometry begins when the robot is put at `placed`: on rubble it moves while it takes
    its stance."""
    with Lockstep(config.model_copy(update={"without": WITHOUT})) as stack:
        try:
            stack.run_until(lambda: t.ODOM in stack.newest, SETTLING_TIME, "odometry")
        except LockstepTimeout:
            return placed
        truth, odom = stack.newest[t.TRUTH].pose.pose, stack.newest[t.ODOM].pose.pose
        yaw = wrap(yaw_of(truth.orientation) - yaw_of(odom.orientation))
        x, y = odom.position.x, odom.position.y
        c, s = math.cos(yaw), math.sin(yaw)
        return truth.position.x - c * x + s * y, truth.position.y - s * x - c * y, yaw


def _follow(stack: Lockstep, goal: tuple[float, float]) -> dict[str, Any]:
    """Send the goal and look at the truth; how it ended."""
    sim: Simulation = stack.robot.backend.simulation  # type: ignore[attr-defined]
    try:
        stack.wait_ready()
    except LockstepTimeout as error:
        return {"routed": True, "eligible": False, "success": False, "end": "not ready", "why": [str(error)]}
    x, y, _ = sim.position.tolist()
    watch = Watch(sim, np.array([[x, y], goal]))
    begin = stack.seconds
    stack.send_goal(*goal, timeout=p.TIME_BUDGET)
    arrived = strict = slow_since = ended = None
    routed, length = False, 0.0
    while True:
        now = stack.seconds - begin
        last, (x, y, _) = (x, y), sim.position.tolist()
        length += math.dist(last, (x, y))
        tilt = attitude(sim)[2]
        away = math.dist((x, y), goal)
        status = stack.newest.get(t.GOAL_STATUS)
        command = stack.newest.get(t.CMD_VEL)
        if arrived is None:
            watch.look(now, command.twist.linear.x if command is not None else 0.0)
        if status is not None:
            routed |= status.state == GoalState.MOVING
            if GoalState(status.state).terminal and ended is None:
                ended = now
        if arrived is None and away < p.GOAL_RADIUS and tilt < p.FALLEN_TILT and now <= p.TIME_BUDGET:
            arrived = now
        slow = away < p.GOAL_RADIUS and math.hypot(*sim.linear_velocity[:2]) <= p.STRICT_SPEED
        slow_since = (slow_since if slow_since is not None else now) if slow else None
        if arrived is not None:
            if slow_since is not None and now - slow_since >= p.STRICT_TIME:
                strict = now
            if strict is not None or now - arrived >= p.STRICT_WAIT:
                end = "arrived"
                break
        elif sim.diverged or now >= p.TIME_BUDGET:
            end = "diverged" if sim.diverged else "timeout"
            break
        elif status is not None and ended is not None and now - ended >= WATCHED_AFTER:
            end = f"{status.state} {status.reason}".strip()
            break
        for _ in range(TRACK_EVERY):
            stack.step()
    told = {k: getattr(status, k) for k in ("state", "reason", "detail", "replans", "recoveries")}
    return {
        "routed": routed,
        "eligible": routed,
        "success": arrived is not None,
        "strict": strict is not None,
        "end": end if routed else "no route",
        "cause": "" if arrived is not None or not routed else watch.cause(end, tilt),
        "time": arrived if arrived is not None else now,
        "goal_distance": away,
        "length": length,
        "told": told,
        **watch.record(),
        "rmse": None,
        "worst": None,
    }
