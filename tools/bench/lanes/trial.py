"""One drive of the whole stack in lockstep, judged by the truth: through a lane, or to a named goal of another
scene."""

from __future__ import annotations

import math
import tempfile
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hal.mujoco.sim import Simulation
from hal.robots import DEFAULT, describe
from hal.scenes import load_scene, places
from hal.scenes.lanes import Lane, named
from hal.scenes.shortest import shortest
from rbtrg_robot import topics as t
from rbtrg_robot.config import load
from rbtrg_robot.hosts.lockstep import Lockstep, LockstepTimeout
from rbtrg_robot.stages.navigation.goal import GoalState
from tools.bench.raised import Raised

GOAL_RADIUS = 0.30
"""Farthest true distance [m] from the goal that counts as reached."""
FALLEN_TILT = math.radians(60.0)
ENTERED_WITHIN = 0.15
"""The middle of the body this close [m] to an element means that the robot tries it."""
NEAR_WALL = 0.04
"""[m] of a contact from a wall's surface."""
WATCHED_AFTER = 1.5
"""Time [s] for which the robot is watched when its goal has ended."""
TOUCH_PAUSE = 0.3
"""Contacts farther apart in time [s] are two touches."""
LOOK_EVERY = 2
"""Steps of 5 ms between looks at contacts and tilt."""
REFUSALS = ("no_route", "goal_in_obstacle", "start_not_on_graph", "outside_area")
"""Reasons that say a lane cannot be driven."""


@dataclass(frozen=True, slots=True)
class Trial:
    """What is driven."""

    seed: int
    level: int
    controller: str
    """Of the default robot, or `ROBOT/CONTROLLER`."""
    map: str
    """`prior`: the terrain is the prior map; `seen`: the map is what the robot sees on its way."""
    policy: str = ""
    sets: tuple[str, ...] = ()
    log: str = ""
    """Folder for the MCAP log of the drive; empty: none."""
    goal: str = ""
    """`SCENE/GOAL` instead of the end of a lane; `seed` is that of the simulation then, and `level` says nothing."""
    made_of: str = ""
    """Elements of the lane, a name in `hal.scenes.elements.MAPS`; empty: the seed's own."""

    @property
    def key(self) -> str:
        """Name of the trial in records."""
        driver = self.controller.replace("/", "-").strip("-.")
        key = f"{driver}.{self.map}.{self.goal.replace('/', '.') or self.level}.{self.seed}"
        return f"{key}.{self.made_of}" if self.made_of else key

    @property
    def scene(self) -> str:
        """Name of the scene."""
        if self.goal:
            return self.goal.partition("/")[0]
        name = f"lanes:{self.seed},level={self.level},controller={self.controller}"
        return f"{name},map={self.made_of}" if self.made_of else name

    def lane(self) -> Lane:
        """The lane; of other scenes than `places` no walls are known. Raises SceneError."""
        if not self.goal:
            return named(self.scene)
        place = places.named(self.scene) if self.scene.startswith("places:") else None
        scene = place.scene if place else load_scene(self.scene)
        return Lane(
            scene=scene, level=0, controller="vmc", map="", layout="", width=math.inf, line=np.empty((0, 2)),
            walls=places.bounds(place) if place else np.empty((0, 5)), floor=scene.height, elements=(),
            beyond=place.beyond if place else None,
        )  # fmt: skip


def drive(trial: Trial) -> dict[str, Any]:
    """The record of a trial: what was driven, `outcome` and `reason`, times, lengths, contacts, states on the way, and
    the track."""
    lane = trial.lane()
    robot, _, controller = trial.controller.rpartition("/")
    facts = describe(robot or DEFAULT)
    goal = lane.scene.goals[trial.goal.partition("/")[2] or "end"]
    least = shortest(lane.walls, lane.scene.start[:2], goal[:2], facts.body.width / 2)
    with tempfile.TemporaryDirectory() as folder:
        prior = ""
        if trial.map == "prior":
            prior = str(Path(folder) / "prior.npz")
            np.savez(
                prior, height=lane.scene.height, resolution=lane.scene.resolution, origin=lane.scene.origin
            )
        config = load(
            None,
            ("recorder.profile=full", *trial.sets),  # for pictures
            scene=trial.scene,
            seed=trial.seed,
            robot_model=robot or DEFAULT,
            controller=controller,
            policy_dir=trial.policy or None,
            map_file=prior,
        )
        log = Lockstep.open_log(config, Path(trial.log) / f"{trial.key}.mcap") if trial.log else None
        began = time.process_time()
        with Lockstep(config, log) as stack:
            watch = Watch(lane, stack.robot.backend.simulation)  # type: ignore[attr-defined]
            heard = Raised(stack)
            result = _run(stack, watch, goal, timeout=40.0 + 15.0 * least)
            seconds = stack.seconds
    described = {"layout": lane.layout, "made_of": lane.map, "elements": lane.elements, "shortest": least}
    cost = {"cpu": time.process_time() - began, "simulated": seconds}
    return {
        "key": trial.key,
        **asdict(trial),
        **described,
        **result,
        **watch.record(),
        **cost,
        "raised": heard.monitors,
    }


def _run(
    stack: Lockstep, watch: Watch, goal: tuple[float, float, float | None], timeout: float
) -> dict[str, Any]:
    """Drive to the goal; how it ended."""
    try:
        stack.wait_ready()
    except LockstepTimeout as error:
        return {"outcome": "not_ready", "reason": "", "detail": str(error), "time": 0.0, "replans": 0}
    start = stack.seconds
    stack.send_goal(*goal, timeout=timeout, accept_risk=True)  # what is likely to fail is to be seen failing
    status: Any = None
    while stack.seconds < start + timeout + 10.0:
        for _ in range(LOOK_EVERY):
            stack.step()
        status = stack.newest.get(t.GOAL_STATUS)
        watch.look(stack.seconds - start, status, stack.newest.get(t.ROBOT_STATE))
        watch.compare(stack.newest.get(t.ODOM))
        if status is not None and GoalState(status.state).terminal:
            break
    took = stack.seconds - start
    for _ in range(round(WATCHED_AFTER / 0.005)):  # a goal ends at the first sign of a fall
        stack.step()
        watch.look(stack.seconds - start, status, stack.newest.get(t.ROBOT_STATE))
    away = math.dist(watch.place, goal[:2])
    outcome = status.state if status is not None else "not_ready"
    if watch.fell:
        outcome = "fell"
    elif outcome == "reached" and away > GOAL_RADIUS:
        outcome = "wrong_place"
    elif outcome in ("rejected", "aborted") and status.reason in REFUSALS and not watch.tried:
        outcome = "refused"
    return {
        "outcome": outcome,
        "reason": status.reason if status is not None else "",
        "detail": status.detail if status is not None else "",
        "time": took,
        "error": away,
        "replans": status.replans if status is not None else 0,
        "recoveries": status.recoveries if status is not None else 0,
    }


class Watch:
    """What the truth says about a drive."""

    def __init__(self, lane: Lane, simulation: Simulation) -> None:
        self._lane, self._sim = lane, simulation
        self.place = tuple(simulation.position[:2])
        self.fell = self.tried = False
        self._tilt = 0.0
        self._driven = 0.0
        self._drift = 0.0
        self._touched = {"body": -math.inf, "wheels": -math.inf}
        self._touches = {"body": 0, "wheels": 0}
        self._track: list[tuple[float, ...]] = []
        self._states: list[dict[str, Any]] = []
        self._told: list[tuple[float, str]] = []
        """Chances that the plans of this drive told: probability to fail, and the worst place."""

    def look(self, now: float, status: Any, robot: Any) -> None:
        """At time `now` [s] after the goal was sent."""
        sim = self._sim
        x, y, z = sim.position
        tilt = math.acos(min(1.0, max(-1.0, float(sim.rotation[2, 2]))))
        self._tilt = max(self._tilt, tilt)
        self.fell |= tilt > FALLEN_TILT or (robot is not None and robot.phase == "fault")
        if self._lane.beyond is not None:
            x0, x1, y0, y1 = self._lane.beyond
            self.tried |= bool(x0 - ENTERED_WITHIN < x < x1 + ENTERED_WITHIN and y0 < y < y1)
        step = math.dist(self.place, (x, y))
        if step > 0.02:  # a robot that stands and sways does not drive
            self._driven += step
            self.place = (float(x), float(y))
        self._contacts(now)
        if not self._track or now - self._track[-1][0] >= 0.1 - 1e-6:
            seen = (now, x, y, z, sim.yaw, math.degrees(tilt))
            self._track.append(tuple(round(float(v), 3) for v in seen))
        if status is not None:
            if not math.isnan(status.p_fail) and (status.p_fail, status.worst) not in self._told[-1:]:
                self._told.append((status.p_fail, status.worst))
            told = {
                k: getattr(status, k)
                for k in ("state", "reason", "detail", "replans", "recoveries", "frontier")
            }
            last = self._states[-1] if self._states else {}
            if any(last.get(k) != v for k, v in told.items()):
                self._states.append(
                    {"t": round(now, 2), "x": round(float(x), 2), "y": round(float(y), 2), **told}
                )

    def compare(self, odom: Any) -> None:
        """Odometry with the truth; `odom` begins at the scene's start."""
        if odom is None:
            return
        place, (x, y, _) = odom.pose.pose.position, self._lane.scene.start
        self._drift = max(self._drift, math.dist((x + place.x, y + place.y), self._sim.position[:2]))

    def _contacts(self, now: float) -> None:
        """A wall is touched above the floor at its foot."""
        contacts = self._sim.contacts()
        places, normals = contacts.places, contacts.normals
        steep = np.abs(normals[:, 2]) < 0.7
        if not steep.any() or not len(self._lane.walls):
            return
        walls, scene = self._lane.walls, self._lane.scene
        a, d = walls[:, :2], walls[:, 2:4] - walls[:, :2]
        for k in np.flatnonzero(steep):
            share = np.clip(((places[k, :2] - a) * d).sum(1) / (d * d).sum(1), 0.0, 1.0)
            gap = np.hypot(*(places[k, :2] - a - share[:, None] * d).T) - 0.5 * walls[:, 4]
            column, row = (round((places[k, i] - scene.origin[i]) / scene.resolution) for i in (0, 1))
            around = self._lane.floor[max(row - 2, 0) : row + 3, max(column - 2, 0) : column + 3]
            if gap.min() < NEAR_WALL and places[k, 2] > around.max() + 0.01:
                part = "wheels" if contacts.bodies[k].endswith("wheel") else "body"
                self._touches[part] += now - self._touched[part] > TOUCH_PAUSE
                self._touched[part] = now

    def record(self) -> dict[str, Any]:
        """For the file."""
        return {
            "driven": self._driven,
            "tilt": math.degrees(self._tilt),
            "drift": self._drift,
            "tried": self.tried,
            "wall_body": self._touches["body"],
            "wall_wheels": self._touches["wheels"],
            "p_fail": self._told[0][0] if self._told else None,
            "told": self._told,
            "states": self._states,
            "track": self._track,
        }
