"""The step `explore`: ordinary goals to places that show what nobody saw, one after the other, until an end that says
why.

The planner answers from where the most is to be seen and in which order (`planning.search.viewpoints`). Here is what
one step remembers: the place that is driven to, and the places that were given up, each with its reason. A place that
could not be come to is tried once more before the end: noise closes a passage for a while, and more of the ground is
known then.
"""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass

from hal.types import NS
from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.stages.mission.attempt import DONE, RUNNING, Attempt, Outcome, Verdict
from rbtrg_robot.stages.mission.order import Kind
from rbtrg_robot.stages.navigation.progress import Pose2
from rbtrg_robot.stages.stage import Outputs
from rbtrg_robot.wire.convert import MAP
from rbtrg_robot.wire.messages import array, header

STANDING_PERIOD, DRIVING_PERIOD = 0.7, 2.0
"""Seconds between two questions while the robot stands and while it drives. The map changes every 0.5 s."""
ASK_AGAIN, GIVE_UP = 6.0, 40.0
"""[s] without an answer, after which the question is sent again, and after which an operator is needed."""
SAME_VIEW = 0.75
"""[m] A place so near to one that was looked from is that place."""
PLACE_MOVED = 1.0
"""[m] by which the place driven to must have moved before the robot is told."""
OTHER_GRAPHS = 3
"""Other graphs that are searched before there is no place left."""
LISTED_PLACES = 8
"""Places left are told, at most."""
UNREACHABLE = "no way leads there within the accepted risk"
LOOKED = "the robot looked from there and saw no more"


@dataclass(slots=True)
class GivenUp:
    """A place that is not driven to."""

    x: float
    y: float
    why: str
    again: bool
    """It is tried once more before the end."""


class Exploration:
    """One try of the step, as `Attempt` is; begins when it is made."""

    def __init__(self, step: msg.MissionStep, now: int, home: Pose2 | None, memory: str = "") -> None:
        """`now` [ns]; `home`: where the way ends, None where the robot stays; `memory` of a try that was
        interrupted."""
        self._step, self._began, self._home = step, now, home
        self._heard = now
        """When the planner answered last, or the step began [ns]."""
        self._asked = -NS * 60
        self._sequence = 0
        self._open = False
        """A question was asked and not answered."""
        self._views: msg.Viewpoints | None = None
        self._target: tuple[float, float] | None = None
        self._drive: Attempt | None = None
        self._goal_id = ""
        self._looked: tuple[float, float] | None = None
        """Where the newest goal ended well; the map of there has not been judged yet."""
        self._given_up: list[GivenUp] = []
        self._anew = 0
        self._retried = False
        self._stood = now
        """When the newest goal ended [ns]."""
        self.places = 0
        """Goals that were reached."""
        self.answer = ""
        if memory:
            kept = json.loads(memory)
            self._began -= round(kept["spent"] * NS)
            self._given_up = [GivenUp(**place) for place in kept["given_up"]]
            self._retried, self.places = kept["retried"], kept["places"]

    def memory(self, now: int) -> str:
        """What another try goes on with."""
        kept = {
            "spent": round((now - self._began) / NS, 1),
            "given_up": [asdict(place) for place in self._given_up],
            "retried": self._retried,
            "places": self.places,
        }
        return json.dumps(kept)

    def way_home(self, driven: float) -> float:
        """[m]: what the planner found, or `driven`, along what was driven, where that is shorter or the planner found
        none."""
        found = math.inf if self._views is None else self._views.home
        return min((way for way in (found, driven) if math.isfinite(way)), default=math.nan)

    @property
    def target(self) -> tuple[float, float] | None:
        """x, y [m] of the place to drive to now; None while the robot stands."""
        return self._target

    def drives(self, goal_id: str, now: int) -> None:
        """The goal to `target` was sent as `goal_id`."""
        goto = msg.MissionStep(kind=Kind.GOTO.value)
        self._goal_id, self._drive = goal_id, Attempt(goto, now, goal_id)

    @property
    def wants_goal(self) -> bool:
        """There is a target and no goal to it yet."""
        return self._target is not None and self._drive is None

    def orders(self, now: int, pose: Pose2 | None = None) -> Outputs:
        """The next question, where it is due."""
        quiet = (now - self._asked) / NS
        due = (
            quiet >= ASK_AGAIN
            if self._open
            else quiet >= (DRIVING_PERIOD if self._target else STANDING_PERIOD)
        )
        if pose is None or not due or (now - self._stood) / NS < STANDING_PERIOD:
            return []
        self._asked, self._open = now, True
        self._sequence += 1
        question = msg.ExploreQuestion(
            header=header(now, MAP), sequence=self._sequence, start_x=pose[0], start_y=pose[1]
        )
        if self._home is not None:
            question.has_home, question.home_x, question.home_y = True, self._home[0], self._home[1]
        if self._target is not None:
            question.has_target, (question.target_x, question.target_y) = True, self._target
        question.area = self._step.area
        question.barred = array([v for place in self._given_up for v in (place.x, place.y)], "float64")
        question.anew = self._anew > 0 and self._target is None
        return [(t.EXPLORE_QUESTION, question)]

    def take(self, views: msg.Viewpoints, now: int) -> None:
        """An answer of the planner; one to an older question is none."""
        if not self._open or views.sequence != self._sequence:
            return
        self._open, self._heard = False, now
        if views.refused:
            return
        self._views = views
        if (here := self._looked) is not None:
            self._looked = None
            if any(math.dist(here, xy) < SAME_VIEW for xy in zip(views.x, views.y, strict=True)):
                self._give_up(here, LOOKED, again=False)
                return  # the next answer leaves it out
        if len(views.x):
            self._anew = 0
            first = float(views.x[0]), float(views.y[0])
            if self._target is None or math.dist(first, self._target) > PLACE_MOVED:
                self._go(first)
        elif self._target is not None:
            self._go(None)
        else:
            self._anew += 1

    def _go(self, place: tuple[float, float] | None) -> None:
        self._target, self._drive, self._goal_id = place, None, ""

    def _give_up(self, place: tuple[float, float], why: str, *, again: bool) -> None:
        self._given_up.append(GivenUp(*place, why, again and not self._retried))

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
        if self._drive is not None and self._target is not None:
            drive = self._drive.verdict(now, goal, robot)
            if drive.outcome is Outcome.NEEDS_OPERATOR:
                return drive
            if drive.outcome is not Outcome.RUNNING:
                self._ended(drive, now)
        if why := self._over(now, back) or (low if self._views else ""):
            return self._end(why)
        if self._open and (now - self._heard) / NS > GIVE_UP:
            refused = self._views.refused if self._views else ""
            return Verdict(Outcome.NEEDS_OPERATOR, refused or "the planner does not tell where to look from")
        if self._target is None and self._anew > OTHER_GRAPHS:
            if any(place.again for place in self._given_up):
                self._given_up = [place for place in self._given_up if not place.again]
                self._retried, self._anew = True, 0
                return RUNNING
            return self._end("no frontier left within the accepted risk")
        return RUNNING

    def _ended(self, drive: Verdict, now: int) -> None:
        assert self._target is not None
        if drive.outcome is Outcome.DONE:
            self.places += 1
            self._looked = self._target
        else:
            self._give_up(self._target, drive.detail, again=True)
        self._go(None)
        self._open = False  # it was asked from elsewhere
        self._stood = now

    def _over(self, now: int, back: float) -> str:
        """Why time or coverage end it; empty where they do not."""
        views, step = self._views, self._step
        if views is None:
            return ""
        if 0.0 < step.until <= self.coverage and len(step.area):
            return f"{100 * step.until:g} % of the area are seen"
        needed = back if self._home is not None and math.isfinite(back) else 0.0
        spent = (now - self._began) / NS
        return f"the {step.duration / 60:g} minutes are over" if 0.0 < step.duration < spent + needed else ""

    @property
    def coverage(self) -> float:
        """Share of what may be reached that was seen."""
        views = self._views
        return 0.0 if views is None else views.seen / max(views.seen + views.hidden, 1e-9)

    @property
    def progress(self) -> str:
        """How much is seen, in words."""
        views = self._views
        if views is None:
            return ""
        return f"{views.seen:.0f} m2 seen, {100 * self.coverage:.0f} %, {len(views.x)} places to look from"

    def left(self) -> list[str]:
        """Every place that was left, with its reason."""
        views = self._views
        named = [f"{p.x:.1f} {p.y:.1f} ({p.why})" for p in self._given_up]
        if views is not None:
            named += [f"{x:.1f} {y:.1f} (not looked from yet)" for x, y in zip(views.x, views.y, strict=True)]
            edges = zip(views.unreachable_x, views.unreachable_y, strict=True)
            named += [f"{x:.1f} {y:.1f} ({UNREACHABLE})" for x, y in edges]
        return named

    def _end(self, why: str) -> Verdict:
        if self._views is None:
            return Verdict(Outcome.FAILED, f"{why}; nothing was seen")
        self._go(None)
        left = self.left()
        more = f"; and {len(left) - LISTED_PLACES} more" if len(left) > LISTED_PLACES else ""
        listed = "".join(f"; left {place}" for place in left[:LISTED_PLACES]) + more
        return Verdict(DONE.outcome, f"{why}: {self.progress}{listed}")
