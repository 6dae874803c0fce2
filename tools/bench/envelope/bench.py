"""Envelope of a locomotion controller: success counts per course, robustness, path tracking, hold, real-time factor.

    python -m tools.bench envelope --controller vmc [--only BEGINNING_OF_KEY] [--json]
    python -m tools.bench envelope --controller policy --policy DIR
    python -m tools.bench envelope --controller hybrid --write [--seconds BUDGET] [--only up]
    python -m tools.bench envelope --controller hybrid --model MJCF [--write]

    python -m tools.bench envelope --controller sport --write

With `--write` it counts failures of motions (docs/design/envelope.md) and adds the trials to the controller's file.
With `--model` it drives the courses in somebody else's MJCF of the same robot, beside ours (`hal.mujoco.mjcf`); with
`--write` its counts stand in the file beside ours, and the worse of both count.
Nobody measured the vendor's service (`sport`): its file is made from that of the measured controller that climbs
least, and says so.

A drive succeeds when the robot passes the obstacle without tipping over, stays within 0.6 m of the line and needs at
most three times the nominal time. Each course is driven three times: wheel friction 0.6, 0.8, 1.0, each with its own
start offset.
"""

from __future__ import annotations

import argparse
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hal.envelope import FAILURES, PARTS, SPORT, Counted, Envelope, limits, stored
from hal.lowlevel import Locomotion
from hal.mujoco.mjcf import Foreign
from hal.mujoco.robot import Simulated
from hal.robots import DEFAULT, describe
from tools.bench.envelope.asked import (
    BACKWARD_HEIGHTS,
    BAR_HEIGHTS,
    CHANGES,
    CURVED_BARS,
    LEAST,
    NO_FALL,
    OBLIQUE_HEIGHTS,
    POST_HEIGHTS,
    POSTS_SPEEDS,
    REFERENCE,
    REFERENCE_MESH,
    ROBUST_COURSES,
    SLOW_COURSES,
    SLOW_SPEEDS,
    STOP_LIMIT,
    STOPS,
    TUNED_ON,
    UNSEEN,
)
from tools.bench.envelope.backward import TRIALS, passes_backward
from tools.bench.envelope.campaign import assumed, measure
from tools.bench.envelope.cliff import WAYS, creep_to_edge
from tools.bench.envelope.driving import figure_eight, hold_on_slope, real_time_factor, stopping_time
from tools.bench.envelope.lane import LANE_SEEDS, through_lane
from tools.bench.envelope.lane import WEAVE_WAYS as LANE_WAYS
from tools.bench.envelope.picture import draw
from tools.bench.envelope.response import along, turning, turning_while_driving
from tools.bench.envelope.terrain import FACE_ANGLES
from tools.bench.envelope.trial import RUNS, TIME_STEP, Conditions, drive
from tools.bench.envelope.turning import CURVE_COMMANDS, CURVING_TIME, PLACES, turn_on_bar, turn_on_ramp
from tools.bench.report import Report


def run(args: list[str]) -> Report:
    """Run this bench; returns its rows. `--only` drives what its keys need; exit 2 when no key begins so."""
    parser = argparse.ArgumentParser(prog="envelope", description=__doc__)
    parser.add_argument(
        "--robot-model", default=DEFAULT, help="name or folder; another than the default: --write alone"
    )
    parser.add_argument("--controller", default="vmc", help="of those in its description")
    parser.add_argument(
        "--policy",
        default="",
        help="of the controllers that learnt: folder, file or name; else ours for hybrid, the fetched one for policy",
    )
    parser.add_argument(
        "--only", default="", help="beginning of the keys wanted: envelope.vmc.ramp, hold_m, ..."
    )
    parser.add_argument("--write", action="store_true", help="measure the envelope and add to its file")
    parser.add_argument(
        "--seconds", type=float, default=600.0, help="of wall time that `--write` measures for"
    )
    parser.add_argument("--drives", type=int, default=None, help="end `--write` after so many drives")
    parser.add_argument("--seed", type=int, default=0, help="of what `--write` draws")
    parser.add_argument(
        "--picture", type=Path, default=None, help="PNG of trials and fit that `--write` makes"
    )
    parser.add_argument(
        "--file", type=Path, default=None, help="that `--write` adds to; else the controller's own"
    )
    parser.add_argument(
        "--model", type=Path, default=None, help="another MJCF of the robot, or the folder of one"
    )
    options = parser.parse_args(args)
    robot = describe(options.robot_model)
    if options.controller not in robot.controllers:
        parser.error(f"--controller: {robot.title} has {', '.join(robot.controllers)}")
    if options.controller == SPORT:
        measured = min(robot.own, key=lambda name: robot.capabilities(name).max_step)
        if not options.write:
            parser.error(
                f"{SPORT} runs on the real robot alone; with --write its envelope is assumed from {measured}'s"
            )
        envelope = assumed(stored(f"{robot.name}/{measured}"))
        envelope.write(options.file or robot.envelope_file(SPORT))
        return counted(envelope)
    controller: Locomotion = robot.model().controller(options.controller, options.policy, TIME_STEP)
    foreign = Foreign(options.model, robot.model()) if options.model else None
    if robot.name != DEFAULT and not options.write:
        parser.error(f"courses are those of {DEFAULT}: with {robot.name} use --write")
    if options.write:
        envelope = measure(
            controller,
            options.controller,
            options.file or robot.envelope_file(options.controller),
            robot,
            seconds=options.seconds,
            drives=options.drives,
            seed=options.seed,
            only=options.only,
            foreign=foreign,
        )
        if options.picture:
            draw(envelope, options.picture)
        return counted(envelope)
    bench = _Bench(Report("envelope"), controller, options.controller, options.only)
    if foreign:
        bench.both(foreign)
    else:
        bench.courses()
        bench.conditions()
        bench.faces()
        bench.lanes()
        bench.edges_and_turns()
        bench.responses()
        bench.driving()
    if not bench.report.rows:
        parser.error(f"no row begins with {options.only!r}")
    return bench.report


def counted(envelope: Envelope) -> Report:
    """What stands in an envelope: drives, trials, failures of each kind, how well the fit predicts, in each model; and
    the limits read off it."""
    report = Report("envelope")
    models: dict[str, Counted] = {
        "": envelope,
        **{f"@{name}": counted for name, counted in envelope.elsewhere.items()},
    }
    for where, name, table in (
        (where, name, table)
        for where, counted in models.items()
        for name, table in counted.manoeuvres.items()
    ):
        key = f"{{}}.{envelope.controller}{where}.{name}"
        report.add(key.format("drives"), table.drives, "drives")
        report.add(key.format("trials"), int(table.trials.sum()), f"of one {table.per}")
        for k, kind in enumerate(FAILURES):
            column = len(table.axes) + 1 + k
            report.add(key.format(kind), sum(row[column] for row in table.cells), "trials")
        if table.log_loss is not None and table.log_loss_of_rate is not None:
            report.add(
                key.format("log_loss"), table.log_loss, "nats, left out", baseline=table.log_loss_of_rate
            )
    if set(envelope.manoeuvres) == set(PARTS):
        for name, value in limits(envelope).items():
            angle = name == "max_slope"
            unit = "deg" if angle else "m/s" if name == "step_vx" else "m"
            report.add(f"{name}.{envelope.controller}", math.degrees(value) if angle else value, unit)
    return report


@dataclass
class _Bench:
    """One run: each method adds the rows whose keys begin with `only`."""

    report: Report
    controller: Locomotion
    name: str
    only: str

    def _wanted(self, row: str) -> bool:
        return f"{row}.{self.name}".startswith(self.only) or self.only.startswith(f"{row}.{self.name}.")

    def _least(self, value: float) -> float | None:
        """A limit that binds our own controller only: the policy is measured, not ours to tune."""
        return value if self.name == "vmc" else None

    def _passed(
        self, course: str, conditions: Conditions | None = None, robot: Simulated | None = None
    ) -> int:
        return sum(drive(self.controller, course, k, conditions, robot).passed for k in range(len(RUNS)))

    def both(self, foreign: Foreign) -> None:
        """Every course of `REFERENCE` in another model, with our model for a baseline."""
        for kind, sizes in REFERENCE.items():
            for size, _ in sizes:
                course = f"{kind}_{size}"
                if f"envelope.{self.name}.{course}".startswith(self.only):
                    ours, there = self._passed(course), self._passed(course, robot=foreign)
                    key = f"envelope.{self.name}@{foreign.name}.{course}"
                    self.report.add(key, there, "of 3", baseline=ours)

    def courses(self) -> None:
        """Every course of `REFERENCE`; when all are driven, also how those fare that gains were or were not chosen
        on."""
        name, add = self.name, self.report.add
        passed = {True: 0, False: 0}
        driven = {True: 0, False: 0}
        for kind, sizes in REFERENCE.items():
            for size, reference in sizes:
                course = f"{kind}_{size}"
                if not f"envelope.{name}.{course}".startswith(self.only):
                    continue
                successes = self._passed(course)
                least = self._least(LEAST[course]) if course in LEAST else None
                add(f"envelope.{name}.{course}", successes, "of 3", least, at_least=True)
                if name == "policy":
                    off = min(abs(successes - r) for r in (reference, REFERENCE_MESH.get(course, reference)))
                    add(f"envelope_off.{name}.{course}", off, "from reference", 1.0)
                if course in LEAST:
                    passed[course in TUNED_ON] += successes
                    driven[course in TUNED_ON] += len(RUNS)
        if not self.only and name == "vmc":
            for tuned, label in ((True, "tuned_on"), (False, "not_tuned_on")):
                add(f"envelope_share.{name}.{label}", passed[tuned] / driven[tuned], "share of drives")
        if f"envelope_share.{name}.unseen".startswith(self.only):
            share = sum(self._passed(course) for course in UNSEEN) / (len(RUNS) * len(UNSEEN))
            add(f"envelope_share.{name}.unseen", share, "share of drives", self._least(0.9), at_least=True)

    def conditions(self) -> None:
        """Disturbed drives and slow ones."""
        name, add = self.name, self.report.add
        for label, change in CHANGES.items():
            if f"robust.{name}.{label}".startswith(self.only):
                outcomes = [drive(self.controller, course, 1, change) for course in ROBUST_COURSES]
                of = f"of {len(ROBUST_COURSES)}"
                add(
                    f"robust.{name}.{label}",
                    sum(o.passed for o in outcomes),
                    of,
                    self._least(5.0),
                    at_least=True,
                )
        if f"falls.{name}.delay_20".startswith(self.only):
            late = CHANGES["delay_20"]
            falls = sum(
                drive(self.controller, course, k, late).tipped for course in NO_FALL for k in range(3)
            )
            add(f"falls.{name}.delay_20", falls, f"of {3 * len(NO_FALL)}", self._least(0.0))
        for speed in SLOW_SPEEDS:
            if f"slow.{name}.{speed}".startswith(self.only):
                successes = sum(self._passed(course, Conditions(speed=speed)) for course in SLOW_COURSES)
                of = f"of {len(RUNS) * len(SLOW_COURSES)}"
                add(f"slow.{name}.{speed}", successes, of, self._least(19.0), at_least=True)

    def faces(self) -> None:
        """Faces and bars at an angle, stepfields at several speeds, and bars and steps backward."""
        name, add = self.name, self.report.add
        for kind in ("face", "bar"):
            for height in OBLIQUE_HEIGHTS:
                if height <= 100.0 * describe().capabilities(name).max_step and self._wanted(
                    f"oblique_{kind}_{height}"
                ):
                    passed = [self._passed(f"{kind}{angle}_{height}") == len(RUNS) for angle in FACE_ANGLES]
                    first = passed.index(False) if False in passed else len(FACE_ANGLES)
                    add(f"oblique_{kind}_{height}.{name}", FACE_ANGLES[first - 1] if first else -1, "deg")
        most = 100.0 * describe().capabilities(name).max_posts
        for height in (h for h in POST_HEIGHTS if 0.5 * most <= h <= 2.0 * most):
            for speed in POSTS_SPEEDS:
                if self._wanted(f"posts_{height}_{speed}"):
                    successes = self._passed(f"posts_{height}", Conditions(speed=speed))
                    add(f"posts_{height}_{speed}.{name}", successes, f"of {len(RUNS)}")
        for kind in ("bar", "step"):
            for height in BACKWARD_HEIGHTS:
                if height <= 100.0 * describe().capabilities(name).max_step and self._wanted(
                    f"back_{kind}_{height}"
                ):
                    ends = [
                        passes_backward(self.controller, kind, height / 100.0, *trial) for trial in TRIALS
                    ]
                    add(f"back_{kind}_{height}.{name}", sum(ends), f"of {len(ends)}")

    def lanes(self) -> None:
        """Rescue lanes of level 4 made of faces at an angle."""
        name = self.name
        for kind in ("kerbs", "bars", "rails"):
            if self._wanted(f"lane_{kind}"):
                ends = [
                    through_lane(self.controller, seed, kind, way, name)
                    for seed in LANE_SEEDS
                    for way in LANE_WAYS
                ]
                passed = sum(end.passed for end in ends)
                self.report.add(
                    f"lane_{kind}.{name}", passed, f"of {len(ends)}", self._least(10.0), at_least=True
                )
                falls = sum(end.tipped for end in ends)
                self.report.add(f"lane_{kind}_falls.{name}", falls, f"of {len(ends)}", self._least(0.0))

    def edges_and_turns(self) -> None:
        """Creeping to an edge, turning astride bars and on ramps."""
        name, controller, add = self.name, self.controller, self.report.add
        for way, trials in WAYS.items():
            if self._wanted(f"cliff_{way}"):
                held = sum(creep_to_edge(controller, *trial) for trial in trials)
                least = self._least(len(trials)) if way != "at_0.2" else None
                add(f"cliff_{way}.{name}", held, f"held of {len(trials)}", least, at_least=True)
        for height in BAR_HEIGHTS:
            if self._wanted(f"turn_bar_{height}"):
                ends = [turn_on_bar(controller, height / 100.0, *place) for place in PLACES]
                tipped = sum(when in ("arriving", "turning") for when, _ in ends)
                of = f"falls of {len(PLACES)}"
                add(f"turn_bar_{height}.{name}", tipped, of, self._least(1.0))
                add(f"turn_bar_{height}_leaving.{name}", sum(when == "leaving" for when, _ in ends), of)
                median = float(np.degrees(np.median([angle for _, angle in ends])))
                add(f"turn_bar_{height}_angle.{name}", median, "deg, median")
        for height in CURVED_BARS:
            if self._wanted(f"curve_bar_{height}"):
                ends = [
                    turn_on_bar(controller, height / 100.0, *place, turning=CURVING_TIME, off=off)
                    for off in CURVE_COMMANDS
                    for place in PLACES
                ]
                falls = sum(when != "" for when, _ in ends)
                add(f"curve_bar_{height}.{name}", falls, f"falls of {len(ends)}")
        for degrees in (0, 10, 20):
            if self._wanted(f"turn_ramp_{degrees}"):
                share = min(turn_on_ramp(controller, degrees, way) for way in (1, -1))
                add(f"turn_ramp_{degrees}.{name}", share, "share of the angle")

    def responses(self) -> None:
        """What slow commands do; the limits are the capabilities that the tracker goes by."""
        name, add, robot = self.name, self.report.add, describe().capabilities(self.name)
        for kind, least in (("vx", robot.min_vx), ("wz", robot.min_wz), ("wz_driving", None)):
            if self._wanted(f"deadband_{kind}") or self._wanted(f"gain_{kind}"):
                measure = {"vx": along, "wz": turning, "wz_driving": turning_while_driving}[kind]
                response = measure(self.controller)
                unit = "m/s" if kind == "vx" else "rad/s"
                add(f"deadband_{kind}.{name}", response.deadband, unit, least)
                add(f"gain_{kind}.{name}", response.gain, "share of the command")

    def driving(self) -> None:
        """Following a path, standing, stopping, cost."""
        name, controller, add = self.name, self.controller, self.report.add
        if any(self._wanted(row) for row in ("track_rmse_m", "track_max_m", "yaw_gain", "yaw_gain_low")):
            ride = figure_eight(controller)
            add(f"track_rmse_m.{name}", ride.rmse, "m", self._least(0.06))
            add(f"track_max_m.{name}", ride.worst, "m")
            add(f"yaw_gain.{name}", ride.yaw_gain, "-", self._least(1.05))
            add(f"yaw_gain_low.{name}", ride.yaw_gain, "-", self._least(0.95), at_least=True)
        if self._wanted("hold_m"):
            add(f"hold_m.{name}", hold_on_slope(controller), "m", 0.01)
        for label, stop in STOPS.items():
            if f"stop_s.{name}.{label}".startswith(self.only):
                seconds = stopping_time(controller, *stop)
                add(f"stop_s.{name}.{label}", seconds, "s", self._least(STOP_LIMIT))
        if self._wanted("rtf") or self._wanted("tick_ms"):
            both, alone, tick = real_time_factor(controller)
            add(f"rtf.{name}", both, "x", 10.0, baseline=alone, at_least=True)
            add(f"tick_ms.{name}", 1e3 * tick, "ms", self._least(0.1))
