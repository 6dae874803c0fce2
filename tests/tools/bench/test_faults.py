"""The bench of faults judges by the truth: a stack that is told to drive on is not at rest, and one that dies is."""

from __future__ import annotations

import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from hal.safety.monitors import BY_NAME, TWO_ROBOTS
from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.config import load
from rbtrg_robot.hosts.lockstep import Lockstep
from rbtrg_robot.wire.messages import encode
from tools.bench.faults.bench import all_faults, run
from tools.bench.faults.fault import Fault, Outcome
from tools.bench.faults.watch import Watch, by_hand
from tools.bench.raised import Raised


def test_a_robot_that_drives_on_is_not_at_rest_and_one_whose_guard_died_is() -> None:
    stack = Lockstep(load(None, ["sim.lidar_step=8"], scene="flat"))
    with Watch(_ready(stack)) as watch:
        by_hand(stack, 0.4, 0.0, 1.5)
        driving = watch.outcome()
        assert math.isinf(driving.rest)
        assert 0.3 < driving.moved < 0.7
        assert driving.error < 0.05
        stopped = Watch(stack)
        stack.kill("guard")
        by_hand(stack, 0.4, 0.0, 1.2)
        outcome = stopped.outcome()
        assert 0.05 < outcome.rest < 0.4
        assert "waiting for guard" in outcome.words
        assert not outcome.fell


def _ready(stack: Lockstep) -> Lockstep:
    stack.wait_ready()
    return stack


def test_words_that_differ_by_a_figure_alone_are_kept_once() -> None:
    heard: list[Any] = []
    stack: Any = SimpleNamespace(host=SimpleNamespace(listen=lambda hear, _: heard.append(hear)))
    told = Raised(stack)
    for reason in ("a hole 0.38 m ahead", "a hole 0.36 m ahead", "a wall 0.36 m ahead"):
        heard[0](t.MOTION_LIMITS, encode(msg.MotionLimits(reason=reason)), 0)
    assert told.words == "a hole 0.38 m ahead\na wall 0.36 m ahead"


@pytest.mark.parametrize(
    ("outcome", "missed"),
    [
        (Outcome(rest=0.6), "at rest after 0.60 s"),
        (Outcome(rest=math.nan), "at rest after nan s"),
        (Outcome(error=0.3, words="imu"), "called good at 0.30 m"),
        (Outcome(words="the LiDAR"), "nobody said 'imu'"),
        (Outcome(words="imu", fell=True), "fell"),
        (Outcome(rest=0.5, error=0.2, words="the imu is late"), ""),
    ],
)
def test_limits_of_a_fault(outcome: Outcome, missed: str) -> None:
    fault = Fault("f", (), (0.0, 1.0), lambda _size, _seed: outcome, rest=0.5, error=0.25, says=("imu",))
    if missed:
        assert missed in fault.missed(outcome)
    else:
        assert not fault.missed(outcome)


def test_the_bench_runs_a_fault_and_misses_it_without_its_monitor(tmp_path: Path) -> None:
    asked = [
        "--only",
        "two_robots_at_start",
        "--sizes",
        "1",
        "--seeds",
        "0",
        "--out",
        str(tmp_path / "out.jsonl"),
    ]
    assert run(asked).ok
    without = run([*asked, "--without", TWO_ROBOTS.name])
    assert [row.key for row in without.rows if not row.ok] == [
        "two_robots_at_start.held",
        "two_robots_at_start.rest_s",
    ]


BY_THEIR_TESTS = {"tracker's inputs", "upright at the start", "moves untold", "place_unsure"}
"""Monitors without a fault: no simulator shows what they catch."""


def test_every_monitor_has_a_fault_that_it_catches() -> None:
    faults = all_faults().values()
    assert all(len(set(fault.sizes)) == len(fault.sizes) > 1 for fault in faults)
    assert {monitor.name for fault in faults for monitor in fault.monitors} | BY_THEIR_TESTS == set(BY_NAME)
