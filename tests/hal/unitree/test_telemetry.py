"""Samples from LowState whatever its ticks do."""

from __future__ import annotations

import numpy as np
import pytest

from hal.types import NS, ImuSample, JointSample
from hal.unitree.config import UnitreeConfig
from hal.unitree.layout import CDR_HEADER, LOW_STATE_CDR
from hal.unitree.link import LOW_STATE
from hal.unitree.telemetry import Telemetry


class Wire:
    """A link that delivers LowStates with these ticks, at their times."""

    def __init__(self) -> None:
        self.messages: list[bytes] = []

    def put(self, tick: int) -> None:
        low = np.zeros(1, LOW_STATE_CDR)
        low[0]["tick"] = tick % 2**32
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
