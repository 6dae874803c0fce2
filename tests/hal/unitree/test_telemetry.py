"""Samples from LowState whatever its ticks do."""

from __future__ import annotations

import numpy as np
import pytest

from hal.safety.monitors import ATTITUDE, BATTERY, LOW_RATE, Monitor, raised, taken_out
from hal.types import NS, ImuSample, JointSample
from hal.unitree.config import UnitreeConfig
from hal.unitree.layout import CDR_HEADER, LOW_STATE_CDR
from hal.unitree.link import LOW_STATE
from hal.unitree.telemetry import Telemetry


class Wire:
    """A link that delivers LowStates with these ticks, at their times."""

    def __init__(self) -> None:
        self.messages: list[bytes] = []

    def put(self, tick: int, charge: int = 80, attitude: float = 1.0) -> None:
        low = np.zeros(1, LOW_STATE_CDR)
        low[0]["tick"] = tick % 2**32
        low[0]["bms_state"]["soc"] = charge
        low[0]["imu_state"]["quaternion"] = (0.0, attitude, 0.0, 0.0)  # on its back
        low[0]["imu_state"]["accelerometer"] = (0.0, 0.0, 9.81)
        self.messages.append(CDR_HEADER + low.tobytes())

    def take(self, topic: str) -> list[bytes]:
        if topic != LOW_STATE:
            return []
        self.came, self.messages = self.messages, []
        return self.came

    def speakers(self, _topic: str) -> list[int]:
        return [0] * len(self.came)


def stamps(ticks: list[int], kind: type) -> np.ndarray:
    """Stamps [s] of the samples of one kind, each LowState read when it comes: one per its tick in ms."""
    wire = Wire()
    telemetry = Telemetry(wire, UnitreeConfig(lidars=()))  # type: ignore[arg-type]
    out = []
    for tick in ticks:
        wire.put(tick)
        out += [s.stamp for s in telemetry.read(10**18 + tick * 1_000_000) if isinstance(s, kind)]
    return (np.array(out) - out[0]) / NS


@pytest.mark.parametrize("step", [1, 2, 3, 4])
def test_the_imu_keeps_its_rate_whatever_the_rate_of_low_state(step: int) -> None:
    imu = stamps(list(range(0, 2000, step)), ImuSample)
    assert len(imu) == pytest.approx(500, abs=3)
    assert np.diff(imu).max() <= 0.001 * (4 + step) + 1e-9


def test_samples_go_on_when_the_tick_runs_over() -> None:
    start = 2**32 - 500
    assert len(stamps(list(range(start, start + 1000, 2)), ImuSample)) == 250
    assert len(stamps(list(range(start, start + 1000, 2)), JointSample)) == 50


def test_a_gap_is_not_made_up_for() -> None:
    ticks = [*range(0, 200, 2), *range(700, 900, 2)]
    imu = stamps(ticks, ImuSample)
    assert len(imu) == 100
    assert np.diff(imu).max() == pytest.approx(0.504, abs=0.003)


def told(step: int, row: Monitor, **state: float) -> tuple[Telemetry, str]:
    """What a telemetry says after 3 s of LowState each `step` [ms], the last second in this `state`."""
    wire = Wire()
    telemetry = Telemetry(wire, UnitreeConfig(lidars=()))  # type: ignore[arg-type]
    for tick in range(0, 3000, step):
        wire.put(tick, **(state if tick > 2000 else {}))  # type: ignore[arg-type]
        telemetry.read(10**18 + tick * 1_000_000)
    return telemetry, row.name if row in raised(telemetry.note(10**18 + 3 * NS)) else ""


@pytest.mark.parametrize(("step", "seldom"), [(2, False), (4, False), (20, True), (100, True)])
def test_a_low_state_that_comes_seldom_is_told(step: int, seldom: bool) -> None:
    assert bool(told(step, LOW_RATE)[1]) == seldom
    with taken_out(LOW_RATE.name):
        assert not told(step, LOW_RATE)[1]


@pytest.mark.parametrize(("charge", "possible"), [(0, True), (100, True), (101, False), (255, False)])
def test_a_battery_that_tells_what_cannot_be_is_told_and_counts_as_before(
    charge: int, possible: bool
) -> None:
    telemetry, words = told(4, BATTERY, charge=charge)
    assert bool(words) != possible
    assert telemetry.battery == (charge / 100.0 if possible else 0.8)
    with taken_out(BATTERY.name):
        assert told(4, BATTERY, charge=charge)[0].battery == charge / 100.0


@pytest.mark.parametrize("length", [0.0, np.nan, 5.0])
def test_an_attitude_that_is_none_is_told_and_rights_no_robot(length: float) -> None:
    telemetry, words = told(4, ATTITUDE, attitude=length)
    assert words
    assert not telemetry.upright, "as it was told before"
    if length == 0.0:
        with taken_out(ATTITUDE.name):
            assert told(4, ATTITUDE, attitude=length)[0].upright
