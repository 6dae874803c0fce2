"""Envelope of a locomotion controller: success counts per course, robustness, path tracking, hold, real-time factor.

    python -m tools.bench envelope --controller vmc [--only BEGINNING_OF_KEY] [--json]
    python -m tools.bench envelope --controller policy --policy DIR

A drive succeeds when the robot passes the obstacle without tipping over, stays within 0.6 m of the line and needs at most three
times the nominal time. Each course is driven three times: wheel friction 0.6, 0.8, 1.0, each with its own start offset.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass

import numpy as np

from hal.locomotion.controllers import controller_of
from hal.lowlevel import CONTROLLERS, Controller, Locomotion
from hal.mujoco.config import CAPABILITIES
from tools.bench.envelope.backward import TRIALS, passes_backward
from tools.bench.envelope.cliff import WAYS, creep_to_edge
from tools.bench.envelope.driving import figure_eight, hold_on_slope, real_time_factor, stopping_time
from tools.bench.envelope.lane import LANES, through_lane
from tools.bench.envelope.lane import WAYS as LANE_WAYS
from tools.bench.envelope.response import along, turning, turning_while_driving
from tools.bench.envelope.terrain import ANGLES
from tools.bench.envelope.trial import RUNS, Conditions, drive
from tools.bench.envelope.turning import CURVES, CURVING, PLACES, turn_on_bar, turn_on_ramp
from tools.bench.report import Report

SLOPES = ("ramp_up", "ramp_down", "cross_slope")
LEAST: dict[str, int] = {
    **{f"{kind}_{v}": 3 for kind in SLOPES for v in (10, 15, 20, 25)},
    "step_up_5": 3,
    "step_up_10": 3,
    "step_up_15": 2,
    **{f"step_down_{v}": 3 for v in (5, 10, 15, 20, 25)},
    "stairs_up_10": 3,
    "stairs_down_10": 3,
    "stairs_down_15": 3,
    "gap_10": 3,
    "crossing_10": 3,
    "crossing_15": 3,
    "pitch_roll_10": 3,
    "pitch_roll_15": 3,
    "krail_3": 3,
    "krail_5": 3,
    "krail_7": 2,
    "rough_2": 3,
    "rough_4": 3,
    "rough_6": 3,
}
"""Least successes of three of the model-based controller."""

REFERENCE: dict[str, tuple[tuple[int, int], ...]] = {
    "ramp_up": ((10, 3), (15, 3), (20, 3), (25, 3), (30, 2), (35, 2), (40, 0)),
    "ramp_down": ((10, 3), (15, 3), (20, 3), (25, 3), (30, 3), (35, 3)),
    "cross_slope": ((10, 3), (15, 3), (20, 3), (25, 3), (30, 2), (35, 1)),
    "step_up": ((5, 3), (10, 3), (15, 3), (20, 3), (25, 3), (30, 3), (35, 3), (40, 3), (50, 0)),
    "step_down": ((5, 3), (10, 3), (15, 3), (20, 3), (25, 3), (40, 3)),
    "stairs_up": ((10, 3), (15, 3), (20, 3)),
    "stairs_down": ((10, 3), (15, 3), (20, 3)),
    "gap": ((10, 3), (12, 3), (15, 3), (20, 2), (25, 1), (30, 0), (40, 0)),
    "crossing": ((10, 3), (15, 3), (20, 3)),
    "pitch_roll": ((10, 3), (15, 3)),
    "krail": ((3, 3), (5, 3), (7, 3), (10, 1)),
    "rough": ((2, 3), (4, 3), (6, 3), (8, 3), (12, 3)),
}
"""Size and successes of three of the learnt policy in rl_sar's layout, measured with another model of the same robot. Both controllers
drive all of them; the policy must stay within one success of each, the model-based one has limits where `LEAST` names them."""

REFERENCE_MESH = {"ramp_up_30": 3, "gap_15": 1, "krail_10": 3}
"""Where that measurement differed with meshes for colliders: either will do."""

TUNED_ON = frozenset(
    (
        *("ramp_up_10", "ramp_up_25", "ramp_down_10", "cross_slope_20", "rough_2", "rough_6", "crossing_15"),
        *("step_up_10", "step_up_15", "step_down_15", "step_down_25", "stairs_up_10", "stairs_down_15"),
        *("krail_5", "krail_7"),
    )
)
"""Courses that gains were chosen on. The others of `LEAST` were driven after each change to see whether it holds: not tuned, but not blind."""

UNSEEN = (
    *(
        "ramp_up_12",
        "ramp_up_22",
        "ramp_down_17",
        "cross_slope_22",
        "step_up_8",
        "step_down_12",
        "step_down_22",
    ),
    *(
        "stairs_up_8",
        "stairs_down_12",
        "gap_8",
        "crossing_12",
        "pitch_roll_12",
        "krail_4",
        "krail_6",
        "rough_3",
        "rough_5",
    ),
)
"""Sizes and grounds between those of the table, never driven while gains were chosen: driven to report, and only that."""

ROBUST_COURSES = (
    "ramp_up_20",
    "ramp_down_20",
    "cross_slope_20",
    "step_up_10",
    "step_down_15",
    "crossing_10",
    "rough_6",
)
CHANGES = {
    "delay_10": Conditions(delay=0.010),
    "delay_20": Conditions(delay=0.020),
    "noise": Conditions(noise=True),
    "payload_3": Conditions(payload=3.0),
    "friction_0.4": Conditions(friction=0.4),
    "speed_0.8": Conditions(speed=0.8),
}
STOPS = {
    "flat_0.3": (0.3,),
    "flat_0.5": (0.5,),
    "flat_0.8": (0.8,),
    "curve_0.5": (0.5, 0.8),
    "slippery_0.5": (0.5, 0.0, 0.0, 0.4),
    "down_15_0.5": (0.5, 0.0, 15.0),
    "up_15_0.5": (0.5, 0.0, -15.0),
}
"""Speed [m/s], yaw rate [rad/s], slope down [deg], friction of each stop."""
STOP_LIMIT = 0.26
"""[s] from zero command to rest."""
BARS = (2, 4, 6, 8, 10)
"""Heights [cm] of the bar under the turning robot; of the 18 trials each no more than one may end in a fall."""
CURVED_BARS = (3, 5, 10)
"""The same for turning there and driving off in a curve."""
SLOW = (0.12, 0.15, 0.22, 0.3)
"""Speeds [m/s] at which paths over difficult ground are followed..."""
SLOW_COURSES = ("step_up_5", "step_up_10", "step_up_15", "stairs_up_10", "krail_5", "rough_4", "rough_6")
"""... and the courses that must be passed at them as well."""
OBLIQUE = (5, 10, 15, 20, 25)
"""Heights [cm] of faces and bars, as far as the controller's capabilities go, met at `ANGLES`."""
BACK = (5, 10, 12, 15, 20)
"""Heights of bars and steps that are driven over backward [cm]."""
POSTS = (4, 5, 7, 10, 12, 15, 20)
"""Heights [cm] of the highest posts of a stepfield, from half of the controller's capabilities to twice of them..."""
POSTS_SPEEDS = (0.2, 0.3, 0.4, 0.5)
"""... and speeds [m/s] at which it is driven through."""
NO_FALL = (
    *(f"{kind}_{v}" for kind in SLOPES for v in (10, 15, 20, 25)),
    *("crossing_10", "crossing_15", "pitch_roll_10", "pitch_roll_15"),
    *("rough_2", "rough_4", "rough_6"),
)
"""Courses on which 20 ms of command delay must not make the robot fall."""


def run(args: list[str]) -> Report:
    """Run this bench; returns its rows. `--only` drives what its keys need; exit 2 when no key begins so."""
    parser = argparse.ArgumentParser(prog="envelope", description=__doc__)
    parser.add_argument("--controller", choices=CONTROLLERS, default="vmc")
    parser.add_argument(
        "--policy",
        default="",
        help="of the controllers that learnt: folder, file or name; else ours for hybrid, the fetched one for policy",
    )
    parser.add_argument(
        "--only", default="", help="beginning of the keys wanted: envelope.vmc.ramp, hold_m, ..."
    )
    options = parser.parse_args(args)
    controller = controller_of(options.controller, options.policy)
    bench = _Bench(Report("envelope"), controller, options.controller, options.only)
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


@dataclass
class _Bench:
    """One run: each method adds the rows whose keys begin with `only`."""

    report: Report
    controller: Locomotion
    name: Controller
    only: str

    def _wanted(self, row: str) -> bool:
        return f"{row}.{self.name}".startswith(self.only) or self.only.startswith(f"{row}.{self.name}.")

    def _least(self, value: float) -> float | None:
        """A limit that binds our own controller only: the policy is measured, not ours to tune."""
        return value if self.name == "vmc" else None

    def _passed(self, course: str, conditions: Conditions | None = None) -> int:
        return sum(drive(self.controller, course, k, conditions).passed for k in range(len(RUNS)))

    def courses(self) -> None:
        """Every course of `REFERENCE`; when all are driven, also how those fare that gains were or were not chosen on."""
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
        for speed in SLOW:
            if f"slow.{name}.{speed}".startswith(self.only):
                successes = sum(self._passed(course, Conditions(speed=speed)) for course in SLOW_COURSES)
                of = f"of {len(RUNS) * len(SLOW_COURSES)}"
                add(f"slow.{name}.{speed}", successes, of, self._least(19.0), at_least=True)

    def faces(self) -> None:
        """Faces and bars at an angle, stepfields at several speeds, and bars and steps backward."""
        name, add = self.name, self.report.add
        for kind in ("face", "bar"):
            for height in OBLIQUE:
                if height <= 100.0 * CAPABILITIES[name].max_step and self._wanted(f"oblique_{kind}_{height}"):
                    passed = [self._passed(f"{kind}{angle}_{height}") == len(RUNS) for angle in ANGLES]
                    first = passed.index(False) if False in passed else len(ANGLES)
                    add(f"oblique_{kind}_{height}.{name}", ANGLES[first - 1] if first else -1, "deg")
        most = 100.0 * CAPABILITIES[name].max_posts
        for height in (h for h in POSTS if 0.5 * most <= h <= 2.0 * most):
            for speed in POSTS_SPEEDS:
                if self._wanted(f"posts_{height}_{speed}"):
                    successes = self._passed(f"posts_{height}", Conditions(speed=speed))
                    add(f"posts_{height}_{speed}.{name}", successes, f"of {len(RUNS)}")
        for kind in ("bar", "step"):
            for height in BACK:
                if height <= 100.0 * CAPABILITIES[name].max_step and self._wanted(f"back_{kind}_{height}"):
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
                    for seed in LANES
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
        for height in BARS:
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
                    turn_on_bar(controller, height / 100.0, *place, turning=CURVING, off=off)
                    for off in CURVES
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
        name, add, robot = self.name, self.report.add, CAPABILITIES[self.name]
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
