"""One drive along one route with the true pose, judged by the simulator."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable
from dataclasses import asdict
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hal.mujoco.contacts import PARTS
from hal.mujoco.driver import Driver
from hal.mujoco.sim import Simulation
from hal.robots import describe
from hal.robots.go2w import facts as go2w
from hal.robots.go2w.locomotion.controllers import controller_of
from planning.tracking import PathTracker, TrackerConfig, TrackPhase
from tools.bench.closed_loop import protocol as p
from tools.bench.closed_loop.routes import Route, scene_of

TRACK_EVERY = 4
"""Physics steps of 5 ms per step of the tracker."""
TRACE_EVERY = 10
"""Looks per line of the trace: 5 Hz."""
WHEEL = PARTS.index("wheel")
DROP_HEIGHT, DROP_TIME = 0.30, 0.5
"""The trunk lost so much height [m] in so little time [s]: more than falling over makes."""
STEEP_NORMAL = 0.5
"""Vertical part of a contact's normal below which it is on a face."""

Array = NDArray[np.float64]
See = Callable[[float, Simulation], None]


@lru_cache(maxsize=8)
def simulation(scene: str, colliders: str) -> Simulation:
    """The robot on a scene with its apron; compiled once, every trial resets all of it."""
    ground = scene_of(scene).with_apron(p.APRON_WIDTH)
    return Simulation(ground.height, ground.resolution, ground.origin, housings=colliders == "all")


def tracker_of(trial: p.Trial) -> PathTracker:
    """The frozen tracker; the planner as it drives keeps the controller's least speeds, as the stack does."""
    config: TrackerConfig = p.TRACKER
    if trial.method == "ours":
        robot = describe().capabilities(trial.controller)
        least = {
            "min_speed": max(config.min_speed, robot.min_vx),
            "min_yaw_rate": max(config.min_yaw_rate, robot.min_wz),
        }
        config = config.model_copy(update=least)
    return PathTracker(config)


def drive(trial: p.Trial, route: Route, policy: str = "", see: See | None = None) -> dict[str, Any]:
    """The record of a trial. Depends on its arguments alone. `see(t, simulation)` is called at 50 Hz, `t` [s] after
    driving off."""
    began = time.process_time()
    given = p.conditions(trial)
    record: dict[str, Any] = {"key": trial.key, **asdict(trial), **given, "wall": route.wall}
    if route.error:
        return record | {"routed": False, "eligible": False, "success": False, "end": "no route"}
    record["routed"] = True
    record["length"] = route.length
    sim = simulation(trial.scene, trial.colliders)
    sim.set_friction(given["friction"])
    driver = Driver(sim, controller_of(trial.controller, policy))
    record |= place(driver, route, trial.scene, given)
    if record["eligible"]:
        record |= follow(driver, tracker_of(trial), route, see)
    else:
        record |= {"success": False, "end": "not eligible"}
    return record | {"cpu": time.process_time() - began, "simulated": sim.time}


def heading(route: Route) -> float:
    """Of the body at the start of a line [rad]: along its tangent, unless the route says another."""
    if route.yaw:
        return route.yaw[0]
    ahead = np.subtract(route.line[min(5, len(route.line) - 1)], route.line[0])
    return math.atan2(ahead[1], ahead[0])


def place(driver: Driver, route: Route, scene: str, given: dict[str, float]) -> dict[str, Any]:
    """Stand at the start of the line, along its tangent, and settle; what speaks against driving off."""
    sim, line = driver.simulation, np.array(route.line)
    yaw = heading(route) + given["dyaw"]
    sim.reset(line[0, 0] + given["dx"], line[0, 1] + given["dy"], yaw, q=go2w.STAND, settle=0.0)
    lift = sim.lift_clear()
    driver.restart()
    driver.settle(p.SETTLE_TIME)
    roll, pitch, _ = attitude(sim)
    contacts = sim.contacts()
    wheels = len({body for body in contacts.bodies if body.endswith("wheel")})
    why = []
    if wheels < p.WHEELS_NEEDED:
        why.append("wheels")
    why += [f"touch {part}" for k, part in enumerate(PARTS) if k != WHEEL and (contacts.parts == k).any()]
    if abs(roll) > p.SETTLED_TILT[scene][0] or abs(pitch) > p.SETTLED_TILT[scene][1]:
        why.append("tilt")
    if sim.diverged:
        why.append("diverged")
    return {"eligible": not why, "why": why, "roll0": roll, "pitch0": pitch, "wheels0": wheels, "lift": lift}


def follow(driver: Driver, tracker: PathTracker, route: Route, see: See | None = None) -> dict[str, Any]:
    """Drive the line; how it ended and what the simulator saw."""
    sim, line = driver.simulation, np.array(route.line)
    tracker.set_path(line, route.yaw or None, route.speed or p.COMMANDED_SPEED, least=route.least or 0.0)
    watch = Watch(sim, line)
    begin = sim.time
    arrived = strict = slow_since = fallen_since = None
    progress, progress_at, nearest, nearest_at = 0.0, 0.0, math.inf, 0.0
    ground = (sim.origin, sim.height.shape, sim.resolution)
    while True:
        t = sim.time - begin
        x, y, _ = sim.position.tolist()
        rotation, v = sim.rotation, float(sim.linear_velocity[0])
        out = tracker.step(round(sim.time * 1e9), x, y, sim.yaw, v, float(rotation[2] @ sim.angular_velocity))
        away = math.hypot(x - line[-1, 0], y - line[-1, 1])
        tilt = math.degrees(math.acos(min(1.0, max(-1.0, float(rotation[2, 2])))))
        if arrived is None:
            watch.look(t, out.vx)
        if see is not None:
            see(t, sim)
        if sim.diverged:
            end = "diverged"
            break
        if out.progress > progress + 0.05:
            progress, progress_at = out.progress, t
        if away < nearest - 0.02:
            nearest, nearest_at = away, t
        upright = tilt < p.FALLEN_TILT
        if arrived is None and away < p.GOAL_RADIUS and upright:
            arrived = t
        slow = away < p.GOAL_RADIUS and math.hypot(*sim.linear_velocity[:2]) <= p.STRICT_SPEED
        slow_since = (slow_since if slow_since is not None else t) if slow else None
        if arrived is not None:
            if slow_since is not None and t - slow_since >= p.STRICT_TIME:
                strict = t
            if strict is not None or t - arrived >= p.STRICT_WAIT or t >= p.TIME_BUDGET or not upright:
                end = "arrived"
                break
        elif t >= p.TIME_BUDGET:
            end = "timeout"
            break
        elif not _inside(x, y, *ground):
            end = "left the terrain"
            break
        fallen_since = None if upright else (fallen_since if fallen_since is not None else t)
        if arrived is None and t >= p.DIAGNOSTIC_TIME:
            if fallen_since is not None and t - fallen_since >= p.FALLEN_TIME:
                end = "fall"
                break
            done = out.phase is TrackPhase.DONE
            if done or (t - progress_at > p.STALLED_TIME and t - nearest_at > p.STALLED_TIME):
                end = "stalled"
                break
        for _ in range(TRACK_EVERY):
            driver.step(out.vx, out.wz)
    return {
        "success": arrived is not None,
        "strict": strict is not None,
        "end": end,
        "cause": "" if arrived is not None else watch.cause(end, tilt),
        "time": arrived if arrived is not None else t,
        "goal_distance": away,
        **watch.record(),
    }


def _inside(
    x: float, y: float, origin: tuple[float, float], shape: tuple[int, ...], resolution: float
) -> bool:
    margin = 0.1
    return bool(
        margin < x - origin[0] < resolution * (shape[1] - 1) - margin
        and margin < y - origin[1] < resolution * (shape[0] - 1) - margin
    )


def attitude(sim: Simulation) -> tuple[float, float, float]:
    """Roll, pitch, tilt [deg]."""
    r = sim.rotation
    tilt = math.acos(min(1.0, max(-1.0, float(r[2, 2]))))
    pitch = -math.asin(min(1.0, max(-1.0, float(r[2, 0]))))
    return math.degrees(math.atan2(r[2, 1], r[2, 2])), math.degrees(pitch), math.degrees(tilt)


class Watch:
    """Diagnostics of a drive, at 50 Hz."""

    def __init__(self, sim: Simulation, line: Array) -> None:
        self._sim, self._line = sim, line
        self._rows: list[tuple[float, ...]] = []
        self._trace: list[list[float]] = []
        self._heights: deque[float] = deque(maxlen=round(DROP_TIME / 0.02))
        self._dropped = False
        self._worst = 0.0
        self._faces: deque[tuple[bool, bool]] = deque(maxlen=100)
        """Of the last 2 s: something touches a wall; something but wheels touches."""

    def look(self, t: float, vx: float) -> None:
        """At time `t` [s] of the drive, `vx` [m/s] commanded."""
        sim = self._sim
        x, y, z = sim.position.tolist()
        roll, pitch, tilt = attitude(sim)
        force = sim.part_forces()
        self._worst = max(self._worst, tilt)
        self._heights.append(z)
        self._dropped |= max(self._heights) - z > DROP_HEIGHT
        self._faces.append((self._at_wall(), bool((force[:WHEEL] > 0.0).any())))
        if t <= p.DIAGNOSTIC_TIME:
            self._rows.append((x, y, abs(roll), abs(pitch), *(force > 0.0), self._slip()))
        if len(self._trace) * TRACE_EVERY * 0.02 <= t + 1e-9:
            self._trace.append([round(v, 2) for v in (t, x, y, z, sim.yaw, roll, pitch, vx)])

    def _slip(self) -> float:
        """Mean over the wheels of |rolling speed - forward speed| over the larger of the two, at least 0.1 m/s."""
        state = self._sim.low_state()
        rolling = np.abs(
            state.dq[go2w.WHEEL_JOINTS] * go2w.WHEEL_RADIUS - (v := float(self._sim.linear_velocity[0]))
        )
        larger = np.maximum(np.maximum(np.abs(state.dq[go2w.WHEEL_JOINTS]) * go2w.WHEEL_RADIUS, abs(v)), 0.1)
        return float(np.mean(rolling / larger))

    def _at_wall(self) -> bool:
        """A part touches a steep place where the ground rises by more than a wall's height within 6 cm."""
        sim = self._sim
        contacts = sim.contacts()
        steep = (np.abs(contacts.normals[:, 2]) < STEEP_NORMAL) & (contacts.forces > 0.0)
        for x, y, _ in contacts.places[steep].tolist():
            c, r = (
                round((x - sim.origin[0]) / sim.resolution),
                round((y - sim.origin[1]) / sim.resolution),
            )
            around = sim.height[max(r - 3, 0) : r + 4, max(c - 3, 0) : c + 4]
            if around.size and float(around.max() - around.min()) > p.FACE_RISE:
                return True
        return False

    def cause(self, end: str, tilt: float) -> str:
        """Why the robot did not arrive: off an edge, fall, against a wall, wedged, stuck, timeout, or `end` itself."""
        if self._dropped and self._worst > p.FALLEN_TILT:
            return "off an edge"
        if end == "fall" or tilt > p.FALLEN_TILT:
            return "fall"
        if end not in ("stalled", "timeout"):
            return end
        walls, others = np.mean(self._faces, axis=0)
        if walls > 0.5:
            return "against a wall"
        if others > 0.5:
            return "wedged"
        return "stuck" if end == "stalled" else end

    def record(self) -> dict[str, Any]:
        """Over the window, but for the largest tilt and the trace."""
        rows = np.array(self._rows)
        error = distance(rows[:, :2], self._line)
        touched = rows[:, 4 : 4 + len(PARTS)].astype(bool)
        return {
            "rmse": float(np.sqrt(np.mean(error**2))),
            "worst": float(error.max()),
            "roll95": float(np.percentile(rows[:, 2], 95)),
            "pitch95": float(np.percentile(rows[:, 3], 95)),
            "contact": float(touched[:, :WHEEL].any(axis=1).mean()),
            **{f"contact_{part}": float(touched[:, k].mean()) for k, part in enumerate(PARTS) if k != WHEEL},
            "slip": float(rows[:, -1].mean()),
            "tilt": self._worst,
            "trace": self._trace,
        }


def distance(points: Array, line: Array) -> Array:
    """(n,) distance [m] of points (n, 2) from a polyline (m, 2)."""
    a, d = line[:-1], np.diff(line, axis=0)
    squared = np.maximum((d**2).sum(axis=1), 1e-18)
    out = np.empty(len(points))
    for k in range(0, len(points), 200):
        to = points[k : k + 200, None, :] - a
        share = np.clip((to * d).sum(axis=2) / squared, 0.0, 1.0)
        out[k : k + 200] = np.sqrt(((to - share[..., None] * d) ** 2).sum(axis=2).min(axis=1))
    return out
