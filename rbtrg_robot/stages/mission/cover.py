"""The step `cover`: lanes over an area, as far apart as the sensor sees, driven to and fro by ordinary goals.

A place that cannot be come to is left out, and tried once more at the end. What is done is remembered over an
interruption.
"""

from __future__ import annotations

import json
import math

import numpy as np
from numpy.typing import NDArray

from hal.types import NS
from rbtrg_robot import msg
from rbtrg_robot.stages.mission.attempt import DONE, RUNNING, GoalStep, Outcome, Verdict
from rbtrg_robot.stages.mission.explore import LISTED_PLACES
from rbtrg_robot.stages.mission.order import GOAL_SPACING
from rbtrg_robot.stages.mission.way_home import Place
from rbtrg_robot.stages.navigation.progress import Pose2


def lanes(corners: NDArray[np.float64], swath: float, start: Place) -> list[Place]:
    """Places along lanes over a polygon (n, 2) [m], in the order in which they are driven.

    The lanes lie `swath` [m] apart and half of that from the edge, along the side of the area that makes the fewest.
    They begin at the end that is nearest to `start`.
    """
    sides = np.roll(corners, -1, axis=0) - corners
    turns = np.arctan2(sides[:, 1], sides[:, 0])
    turn = min(turns.tolist(), key=lambda a: (round(float(np.ptp(_turned(corners, -a)[:, 1])), 6), a))
    area = _turned(corners, -turn)
    low, high = float(area[:, 1].min()), float(area[:, 1].max())
    count = max(1, math.ceil((high - low) / swath - 1e-6))
    apart = (high - low) / count
    rows = [_row(area, low + (k + 0.5) * apart, swath) for k in range(count)]
    ways = []
    for upward in (False, True):
        for back in (False, True):
            way: list[Place] = []
            for k, row in enumerate(reversed(rows) if upward else rows):
                way += row[::-1] if back == (k % 2 == 0) else row
            ways.append([(float(x), float(y)) for x, y in _turned(np.array(way).reshape(-1, 2), turn)])
    return min(ways, key=lambda way: math.dist(way[0], start) if way else 0.0)


def _turned(points: NDArray[np.float64], angle: float) -> NDArray[np.float64]:
    c, s = math.cos(angle), math.sin(angle)
    return points @ np.array([[c, s], [-s, c]])


def _row(area: NDArray[np.float64], y: float, swath: float) -> list[Place]:
    """Places on the line at `y` that lie in the polygon, along x; each stretch ends half a swath before the edge."""
    (x0, y0), (x1, y1) = area.T, np.roll(area, -1, axis=0).T
    cuts = (y0 <= y) != (y1 <= y)
    at = np.sort(x0[cuts] + (y - y0[cuts]) / (y1[cuts] - y0[cuts]) * (x1[cuts] - x0[cuts]))
    row: list[Place] = []
    for begin, end in at.reshape(-1, 2):
        inset = min(0.5 * swath, 0.5 * (end - begin))
        first, last = begin + inset, end - inset
        steps = math.ceil((last - first) / GOAL_SPACING - 1e-9)
        row += [(first + (last - first) * k / max(steps, 1), y) for k in range(steps + 1)]
    return row


class Coverage(GoalStep):
    """One try of the step, as `Exploration` is; begins when it is made."""

    def __init__(
        self, step: msg.MissionStep, now: int, pose: Pose2 | None, home: bool, memory: str = ""
    ) -> None:
        """`now` [ns]; `pose` of the robot; `home`: the robot comes home in the time of the step; `memory` of a try that
        was interrupted."""
        kept = json.loads(memory) if memory else {}
        corners = step.area.reshape(-1, 2)
        self._start = tuple(kept.get("start", pose[:2] if pose else corners[0].tolist()))
        self._places = lanes(corners, step.swath, (self._start[0], self._start[1]))
        self._todo: list[int] = kept.get("todo", list(range(len(self._places))))
        self._left: dict[int, str] = {int(k): why for k, why in kept.get("left", {}).items()}
        self._retried: bool = kept.get("retried", False)
        self._began = now - round(kept.get("spent", 0.0) * NS)
        self._limit, self._home = step.duration, home

    def memory(self, now: int) -> str:
        """What another try goes on with."""
        kept = {
            "start": self._start,
            "todo": self._todo,
            "left": self._left,
            "retried": self._retried,
            "spent": round((now - self._began) / NS, 1),
        }
        return json.dumps(kept)

    @property
    def target(self) -> Place | None:
        """x, y [m] of the place to drive to now."""
        return self._places[self._todo[0]] if self._todo else None

    @property
    def wants_goal(self) -> bool:
        """There is no goal to the target yet."""
        return self._drive is None and bool(self._todo)

    def verdict(
        self,
        now: int,
        goal: msg.GoalStatus | None,
        robot: msg.RobotState | None,
        back: float = math.nan,
        low: str = "",
    ) -> Verdict:
        """From the newest words of navigator and robot; `back`: how long the way home takes [s], NaN where none is
        known; `low`: why the battery needs it to begin."""
        if self._drive is not None:
            drive = self._drive.verdict(now, goal, robot)
            if drive.outcome is Outcome.NEEDS_OPERATOR:
                return drive
            if drive.outcome is not Outcome.RUNNING:
                self._ended(drive)
        needed = back if self._home and math.isfinite(back) else 0.0
        if 0.0 < self._limit < (now - self._began) / NS + needed:
            return self._end(f"the {self._limit / 60:g} minutes are over")
        if low:
            return self._end(low)
        if not self._todo and self._left and not self._retried:
            self._todo, self._left, self._retried = sorted(self._left), {}, True
        return (
            RUNNING
            if self._todo
            else self._end("all lanes are driven" if not self._left else "the lanes are over")
        )

    def _ended(self, drive: Verdict) -> None:
        self._drive = None
        done = self._todo.pop(0)
        if drive.outcome is Outcome.FAILED:
            self._left[done] = drive.detail

    @property
    def progress(self) -> str:
        """How far it is, in words."""
        count = len(self._places)
        return f"{count - len(self._todo) - len(self._left)} of {count} places on the lanes"

    def _end(self, why: str) -> Verdict:
        named = [f"{_place(self._places[k])} ({reason})" for k, reason in sorted(self._left.items())]
        named += [f"{_place(self._places[k])} (not driven to yet)" for k in self._todo]
        listed = "".join(f"; left {place}" for place in named[:LISTED_PLACES])
        more = f"; and {len(named) - LISTED_PLACES} more" if len(named) > LISTED_PLACES else ""
        none = len(named) == len(self._places)
        return Verdict(Outcome.FAILED if none else DONE.outcome, f"{why}: {self.progress}{listed}{more}")


def _place(place: Place) -> str:
    return f"{place[0]:.1f} {place[1]:.1f}"
