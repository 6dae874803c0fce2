"""Battery and link faults on the way to a goal, the whole stack in lockstep: is the robot home, or does it do what was
chosen?

One line per trial goes to `--out` (JSON); trials that stand in it are not driven again.
"""

from __future__ import annotations

import argparse
import math
from dataclasses import asdict, dataclass
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

from hal.mujoco.backend import MujocoBackend
from hal.types import NS
from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.config import load
from rbtrg_robot.hosts.lockstep import Lockstep, LockstepTimeout
from rbtrg_robot.missions.file import parse
from rbtrg_robot.stages.mission.reserve import CHARGE_STEP
from rbtrg_robot.topics import Topic
from rbtrg_robot.wire.messages import decode
from tools.bench.records import Records
from tools.bench.report import Report

GOALS = ("flat/b", "flat/far", "yard/a", "yard/b", "maze/exit")
FAULTS = (
    *("battery/goal", "battery/mission", "battery/stands", "battery/stays"),
    *("link/continue", "link/hold", "link/return", "link/contact"),
)
"""battery: it runs low on the way of a goal, of a mission, at the goal, with --no-return. link: nobody is in contact,
with the choice; `contact`: somebody is again on the way home."""
COMMS_TIMEOUT = 3.0
"""[s] `comms.timeout`."""
FAULT_SHARE = 0.5
"""Of the way to the goal after which the fault comes."""
DETOUR_RATIO, MAZE_RATIO, WAY_SPEED = 1.6, 5.0, 0.4
"""The longest way to a goal against straight on, and in the maze; [m/s] on it. The shortest one in the maze is 3.9."""
TIME_LIMIT = 240.0
"""[s] of a trial."""
PLACE_RADIUS = 0.6
"""[m] A robot so near to a place is there."""
STILL_SPEED = 0.05
"""[m/s]"""


@dataclass(frozen=True, slots=True)
class Trial:
    """One drive."""

    fault: str
    goal: str
    seed: int

    @property
    def key(self) -> str:
        """Its name."""
        return f"{self.fault}/{self.goal}/{self.seed}"


@dataclass(frozen=True, slots=True)
class Record:
    """How it ended."""

    key: str
    ok: bool
    words: str
    seconds: float
    battery: float
    """Charge at the end [0..1]."""
    told: float
    """[s] from the warning to the way home; NaN: none."""


class Drive:
    """The stack of a trial, and what its mission process says."""

    def __init__(self, trial: Trial, stack: Lockstep) -> None:
        self._stack, self._trial = stack, trial
        scene, _, name = trial.goal.partition("/")
        self._detour = MAZE_RATIO if scene == "maze" else DETOUR_RATIO
        self.goal = stack.config.load_scene().goals[name][:2]
        self.mission = msg.MissionState()
        self._warned = self._returned = math.nan
        stack.host.listen(self._note, frozenset({t.MISSION_STATE}))
        stack.wait_ready(30.0)
        self._until(lambda: self.mission.has_home, "a home")
        self.start = self.place

    def _note(self, topic: Topic, payload: bytes, _now: int) -> None:
        if topic is t.MISSION_STATE:
            self.mission = decode(payload, msg.MissionState)
            seconds = self._stack.seconds
            if self.mission.warning and math.isnan(self._warned):
                self._warned = seconds
            if (self.mission.returning or self.mission.name.startswith("way home")) and math.isnan(
                self._returned
            ):
                self._returned = seconds

    @property
    def place(self) -> tuple[float, float]:
        """x, y [m] in truth."""
        pose = self._stack.newest[t.TRUTH].pose.pose.position
        return pose.x, pose.y

    def _until(self, true: object, what: str, present: bool = False) -> None:
        assert callable(true)
        due = 0.0
        end = self._stack.seconds + TIME_LIMIT
        while not true():
            if self._stack.seconds >= end:
                raise LockstepTimeout(
                    f"{what} did not come in {TIME_LIMIT:.0f} s: {self.mission.phase} {self.mission.reason}"
                )
            if present and self._stack.seconds >= due:
                due = self._stack.seconds + 1.0
                self._stack.host.inject(t.PRESENCE, msg.Presence(owner="bench"))
            self._stack.run(0.1)

    def _near(self, place: tuple[float, float]) -> bool:
        return math.dist(self.place, place) < PLACE_RADIUS

    def _still(self) -> bool:
        twist = self._stack.newest[t.TRUTH].twist.twist.linear
        return math.hypot(twist.x, twist.y) < STILL_SPEED

    def _ask(self, action: str, **fields: object) -> None:
        request = msg.MissionRequest(id=f"bench {self._stack.now}", action=action, owner="bench", **fields)  # type: ignore[arg-type]
        self._stack.host.inject(t.MISSION_REQUEST, request)

    def _send(self) -> None:
        kind, _, what = self._trial.fault.partition("/")
        x, y = self.goal
        if (kind, what) == ("battery", "mission"):
            order = parse({"steps": [{"goto": {"x": x, "y": y}}, {"wait": 1000}]}, "bench").order("bench")
            self._ask("run", order=order)
            return
        request = msg.GoalRequest(id="bench", owner="bench", x=x, y=y, no_return=what == "stays")
        request.header.frame_id = "map"
        self._stack.host.inject(t.GOAL_REQUEST, request)

    def _charge(self, now: float) -> None:
        """The battery holds so much [0..1] now, and drains as before."""
        backend = self._stack.robot.backend
        assert isinstance(backend, MujocoBackend)
        spent = 1.0 - self._stack.newest[t.ROBOT_STATE].battery
        backend.config = backend.config.model_copy(update={"battery": now + spent})

    def battery(self) -> None:
        """The trial of a battery fault. Raises LockstepTimeout, AssertionError."""
        what = self._trial.fault.partition("/")[2]
        away, life = math.dist(self.start, self.goal), self._stack.config.sim.battery_life
        way, stand = {"stands": (self._detour * away, 20.0), "stays": (DETOUR_RATIO * away, 10.0)}.get(
            what, (FAULT_SHARE * away, 0.0)
        )
        home = self._stack.config.home
        kept = home.reserve * home.per_metre * (0.5 * away if what == "stays" else way)
        seconds = way / WAY_SPEED + 3.0 + stand
        self._charge(self._stack.config.gate.min_battery + CHARGE_STEP + kept + seconds / life)
        self._stack.run(0.5)
        self._send()
        if what == "stays":
            self._until(lambda: self._near(self.goal), "the goal")
            self._stack.run(5.0)
            assert self._near(self.goal), "it left its goal"
            return
        if what == "stands":
            self._until(lambda: self._near(self.goal), "the goal")
        self._until(lambda: math.isfinite(self._returned), "the way home")
        self._until(
            lambda: self.mission.phase in ("failed", "finished") and self._still(), "the end of the way home"
        )
        assert self._near(self.start), f"it is {math.dist(self.place, self.start):.1f} m from home"
        assert not self._stack.newest[t.ROBOT_STATE].estop, self._stack.newest[t.ROBOT_STATE].estop_cause

    def link(self) -> None:
        """The trial of a lost link. Raises LockstepTimeout, AssertionError."""
        what = self._trial.fault.partition("/")[2]
        self._send()
        half = (1.0 - FAULT_SHARE) * math.dist(self.start, self.goal)
        self._until(lambda: math.dist(self.place, self.goal) < half, "half of the way", present=True)
        lost = self._stack.seconds
        if what == "continue":
            self._until(lambda: self._near(self.goal), "the goal")
            return
        self._until(lambda: self.mission.phase == "holding" or self.mission.returning, "the choice")
        assert self._stack.seconds - lost < COMMS_TIMEOUT + 2.0, "it took too long"
        if what == "hold":
            self._stack.run(2.0)
            assert self._still(), "it does not stand"
            self._until(lambda: self._near(self.goal), "the goal", present=True)  # it goes on by itself
            return
        if what == "return":
            self._until(lambda: self.mission.phase == "failed" and self._still(), "the end of the way home")
            assert self._near(self.start), f"it is {math.dist(self.place, self.start):.1f} m from home"
            return
        away = math.dist(self.place, self.start)
        self._until(lambda: math.dist(self.place, self.start) < away - 0.5, "the way home")
        self._until(lambda: self.mission.phase == "paused" and self._still(), "a stand", present=True)
        assert not self._near(self.start), "it went on home"
        self._ask("resume")
        self._until(lambda: self._near(self.goal), "the goal", present=True)

    def told(self) -> float:
        """[s] that the warning came ahead; NaN: none, or no way home."""
        return self._returned - self._warned


def drive(trial: Trial) -> Record:
    """One trial."""
    kind, _, what = trial.fault.partition("/")
    loss = {"hold": "hold", "return": "return", "contact": "return"}.get(what, "continue")
    sets = [
        "sim.lidar_step=8",
        f"seed={trial.seed}",
        f"comms.timeout={COMMS_TIMEOUT}",
        f"comms.on_loss={loss}",
    ]
    with Lockstep(load(None, sets, scene=trial.goal.partition("/")[0])) as stack:
        one = Drive(trial, stack)
        try:
            one.battery() if kind == "battery" else one.link()
        except AssertionError as error:
            wrong = str(error)
        else:
            wrong = ""
        battery = float(stack.newest[t.ROBOT_STATE].battery)
        return Record(trial.key, not wrong, wrong, stack.now / NS, battery, one.told())


def run(args: list[str]) -> Report:
    """Run this bench with the arguments of its command line; returns its rows."""
    parser = argparse.ArgumentParser(prog="python -m tools.bench home", description=__doc__)
    parser.add_argument("--faults", default=",".join(FAULTS))
    parser.add_argument("--goals", default=",".join(GOALS), help="SCENE/GOAL,...")
    parser.add_argument("--seed", type=int, default=0, help="of the simulation")
    parser.add_argument("--out", type=Path, help="FILE.jsonl")
    options = parser.parse_args(args)
    records = Records(options.out)
    for goal, fault in product(options.goals.split(","), options.faults.split(",")):
        trial = Trial(fault, goal, options.seed)
        records.get(trial.key, partial(_driven, trial))
    return table([Record(**record) for record in records.done.values()])


def _driven(trial: Trial) -> dict[str, Any]:
    return asdict(drive(trial))


def table(records: list[Record]) -> Report:
    """Rows of each fault, and of all: home, or what was chosen."""
    report = Report("home")
    for fault in FAULTS:
        here = [r for r in records if r.key.startswith(f"{fault}/")]
        if here:
            report.rate(f"home.{fault.replace('/', '.')}", sum(r.ok for r in here), len(here), 1.0)
    report.rate("home.all", sum(r.ok for r in records), len(records), 1.0)
    if told := [r.told for r in records if r.ok and math.isfinite(r.told)]:
        report.add("home.told_ahead", min(told), "s")
    return report
