"""A site explored by the whole stack in lockstep: the mission step `explore`, then `home`, judged by the truth."""

from __future__ import annotations

import math
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hal.mujoco.sim import Simulation
from hal.scenes.files import save_scene
from hal.scenes.scene import Scene
from mapping.grid import ElevationGrid
from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.config import load
from rbtrg_robot.hosts.lockstep import Lockstep
from rbtrg_robot.missions.file import outing
from rbtrg_robot.topics import Topic
from rbtrg_robot.wire.messages import decode
from tools.bench.closed_loop.trial import attitude
from tools.bench.explore.drawn import SEEN_SHARES, truth_reachable

TIME_BUDGET = 30.0
"""[s] of simulated time for each square metre of the site."""
FALLEN_TILT = 60.0
"""[deg] of tilt."""
HOME_RADIUS = 0.5
"""[m] Farthest true distance from the start that counts as home."""
LOOK_EVERY = 200
"""Steps of 5 ms between looks."""


class Explored:
    """A stack with an exploration, and what its mission says."""

    def __init__(self, stack: Lockstep) -> None:
        self.stack = stack
        self.state = msg.MissionState()
        stack.host.listen(self._note)

    def _note(self, topic: Topic, payload: bytes, _now: int) -> None:
        if topic is t.MISSION_STATE:
            self.state = decode(payload, msg.MissionState)

    def start(self, ground: dict[str, Any]) -> None:
        """What `rbtrg-robot explore` does unless it is told otherwise."""
        order = outing("explore", ground, back=True, accept=False).order("explore")
        self.stack.host.inject(t.MISSION_REQUEST, msg.MissionRequest(id="1", action="run", order=order))

    @property
    def over(self) -> bool:
        """The mission has ended."""
        return self.state.phase in ("finished", "failed", "stopped", "paused")


def drive(scene: Scene, budget: float = 0.0, logs: Path | None = None) -> dict[str, Any]:
    """The record: metres at each of `SEEN_SHARES`, share at the end, whether it came home by the truth, fell, and the
    stack's own words. `logs`: a folder for site and log of the drive, of which `rbtrg-robot log film` makes a film."""
    began = time.process_time()
    aim = truth_reachable(scene)
    budget = budget or TIME_BUDGET * aim.sum() * scene.resolution**2
    with ExitStack() as kept:
        folder = logs or Path(kept.enter_context(tempfile.TemporaryDirectory()))
        file = folder / f"{scene.name}.npz"
        save_scene(scene, file)
        config = load(None, [], scene=str(file), origin=scene.start)
        log = None
        if logs is not None:
            log = kept.enter_context(Lockstep.open_log(config, logs / f"{scene.name}.mcap"))
        with Lockstep(config, log) as stack:
            stack.wait_ready()
            run = Explored(stack)
            stack.run(1.5)
            run.start({})
            sim: Simulation = stack.robot.backend.simulation  # type: ignore[attr-defined]
            begin, way, fell = stack.seconds, 0.0, False
            record: dict[str, Any] = {f"at_{share}": math.nan for share in SEEN_SHARES}
            last = sim.position[:2].copy()
            share = 0.0
            for look in range(round(budget * 200 / LOOK_EVERY)):
                for _ in range(LOOK_EVERY):
                    stack.step()
                place = sim.position[:2].copy()
                way += float(np.hypot(*(place - last)))
                last = place
                fell |= bool(sim.diverged) or attitude(sim)[2] > FALLEN_TILT
                if look % 5 == 0 or run.over:
                    share = _share(stack, scene, aim)
                    for asked in SEEN_SHARES:
                        if math.isnan(record[f"at_{asked}"]) and share >= asked:
                            record[f"at_{asked}"] = way
                if run.over or fell:
                    break
            told = list(run.state.result_description)
            home = run.state.phase == "finished" and math.dist(last, scene.start[:2]) < HOME_RADIUS
            return record | {
                "share": share,
                "way": way,
                "home": home,
                "fell": fell,
                "phase": run.state.phase,
                "words": [run.state.reason, *told],
                "time": stack.seconds - begin,
                "cpu": time.process_time() - began,
            }


def _share(stack: Lockstep, scene: Scene, aim: NDArray[np.bool_]) -> float:
    """Of the ground that can be reached, what the planner's copy of the map has."""
    grid: ElevationGrid | None = stack.host.stage("planner")._map.grid
    if grid is None:
        return 0.0
    r, c = np.nonzero(aim)
    x, y = scene.origin[0] + c * scene.resolution, scene.origin[1] + r * scene.resolution
    col, row = (
        np.floor((v - o) / grid.resolution + 0.5).astype(int)
        for v, o in zip((x, y), grid.origin, strict=True)
    )
    on = (row >= 0) & (col >= 0) & (row < grid.shape[0]) & (col < grid.shape[1])
    return float(grid.trusted[row[on], col[on]].sum() / len(r))
