"""The trunk behind the gate: it tilts while the robot stands, and is level by itself."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from hal.safety.gate import RefusalReason, SafetyGate
from hal.safety.gate_types import GateInputs
from hal.safety.trunk import LEVEL_LAG, STANDING_TIME, TILT_RATE
from hal.types import NS, PostureCommand, VelocityCommand
from tests.hal.safety.test_gate import CAPS, MS, TICK, well

TILTING = replace(CAPS, max_trunk_tilt=0.25)
DOWN = 0.2


class Rig:
    """A gate at 50 Hz; `vx` and `pitch` are commanded where they are not None."""

    def __init__(self) -> None:
        self.gate = SafetyGate(TILTING)
        self.now = 0
        self.vx: float | None = 0.0
        self.pitch: float | None = None
        self.inputs: dict[str, object] = {}
        self.out = VelocityCommand(0)

    def run(self, seconds: float) -> list[float]:
        """Pitch [rad] that the robot is told, every 20 ms."""
        pitches = []
        for _ in range(round(seconds * NS / TICK)):
            self.now += TICK
            if self.vx is not None:
                self.gate.command(VelocityCommand(self.now, vx=self.vx), self.now)
            if self.pitch is not None:
                self.gate.posture(PostureCommand(self.now, pitch=self.pitch), self.now)
            self.out = self.gate.output(self.now, self.given())
            pitches.append(self.gate.trunk.pitch)
        return pitches

    def given(self) -> GateInputs:
        return well(self.now, **self.inputs)


@pytest.fixture
def tilted() -> Rig:
    rig = Rig()
    rig.run(0.5)
    rig.pitch = DOWN
    pitches = rig.run(0.5)
    assert np.diff(pitches).max() == pytest.approx(TILT_RATE * TICK / NS)
    assert pitches[-1] == pytest.approx(DOWN)
    return rig


def test_it_tilts_while_repeated_and_levels_at_the_deadline(tilted: Rig) -> None:
    assert min(tilted.run(1.0)) == pytest.approx(DOWN)
    tilted.pitch = None
    pitches = tilted.run(0.6)
    assert pitches[8] == pytest.approx(DOWN), "the last command still holds"
    assert pitches[23] == 0.0, "0.2 s of silence, 0.2 rad at 0.8 rad/s"
    assert tilted.gate.status().refused == {}


@pytest.mark.parametrize(
    "trouble",
    ["stop", "no velocity command", "hand took over", "stale sensor", "guard silent", "no more state"],
)
def test_it_is_level_again_whatever_goes_wrong_and_stays(tilted: Rig, trouble: str) -> None:
    if trouble == "stop":
        tilted.gate.stop()
    elif trouble == "no velocity command":
        tilted.vx = None
    elif trouble == "hand took over":
        tilted.gate.forget()
        tilted.vx = None
    elif trouble == "stale sensor":
        tilted.inputs["stamps"] = {"imu": 0, "joints": 0, "lidar": 0}
    elif trouble == "guard silent":
        tilted.inputs["limits"] = None
    else:
        tilted.inputs["state"] = None
    tilted.run(0.7)
    assert set(tilted.run(0.5)) == {0.0}, "commands go on and do not count"


def test_a_velocity_levels_it_first(tilted: Rig) -> None:
    tilted.vx = 0.5
    speeds, pitches = [], []
    for _ in range(40):
        pitches += tilted.run(0.02)
        speeds.append(tilted.out.vx)
    driving = np.array(speeds) > 0.0
    level = np.array(pitches) == 0.0
    assert driving.any()
    assert not (driving & ~level).any()
    way = DOWN / TILT_RATE + LEVEL_LAG
    assert 0.02 * np.argmax(driving) == pytest.approx(way, abs=0.03)
    assert set(tilted.run(0.5)) == {0.0}, "the tilt that is still commanded is refused"
    assert tilted.gate.status().refused[RefusalReason.NOT_STANDING.value] > 0


def test_it_is_refused_until_the_robot_has_stood() -> None:
    rig = Rig()
    rig.vx = 0.5
    rig.run(1.0)
    rig.vx, rig.pitch = 0.0, DOWN
    pitches = rig.run(1.0)
    assert 0.02 * np.argmax(np.array(pitches) > 0.0) == pytest.approx(STANDING_TIME, abs=0.03)


@pytest.mark.parametrize(
    "inputs", [{"velocity": (0.2, 0.0, 0.0)}, {"velocity": (0.0, 0.0, -0.3)}, {"tilt": 0.4}, {"tilt": None}]
)
def test_it_is_refused_while_the_robot_rolls_or_leans(inputs: dict[str, object]) -> None:
    rig = Rig()
    rig.inputs = inputs
    rig.run(0.5)
    rig.pitch = DOWN
    assert set(rig.run(0.5)) == {0.0}
    if inputs.get("tilt", 0.0) is not None:
        assert rig.gate.status().refused == {RefusalReason.NOT_STANDING.value: 25}


@pytest.mark.parametrize(
    ("command", "reason"),
    [
        (PostureCommand(NS, pitch=math.nan), RefusalReason.NOT_FINITE),
        (PostureCommand(NS, roll=math.inf), RefusalReason.NOT_FINITE),
        (PostureCommand(NS, pitch=0.26), RefusalReason.OVER_LIMIT),
        (PostureCommand(NS, roll=-0.26), RefusalReason.OVER_LIMIT),
        (PostureCommand(NS + 100 * MS, pitch=0.1), RefusalReason.FROM_FUTURE),
        (PostureCommand(NS - 200 * MS, pitch=0.1), RefusalReason.TOO_OLD),
    ],
)
def test_bad_tilts_are_refused_and_counted(command: PostureCommand, reason: RefusalReason) -> None:
    rig = Rig()
    rig.run(1.0)
    refusal = rig.gate.posture(command, rig.now)
    assert refusal is not None
    assert (refusal.reason, rig.gate.status().refused) == (reason, {reason.value: 1})
    assert set(rig.run(0.2)) == {0.0}


def test_a_robot_that_cannot_tilt_says_so() -> None:
    gate = SafetyGate(CAPS)
    refusal = gate.posture(PostureCommand(NS, pitch=0.1), NS)
    assert refusal is not None
    assert "cannot tilt" in refusal.detail
