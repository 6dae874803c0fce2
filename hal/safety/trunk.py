"""The trunk's tilt behind the gate: a robot tilts while it stands, and is level before it drives.

Level is what happens by itself: when the commands end, at a stop, at every hold, and as soon as a velocity is
commanded."""

from __future__ import annotations

import math

from hal.safety.gate_types import GateConfig, GateInputs, Refusal, RefusalReason
from hal.types import NS, Capabilities, PostureCommand

TILT_RATE = 0.8
"""[rad/s] of the trunk in either direction: 12 deg take 0.26 s, and sweeps of 10 Hz still lie 5 deg apart."""
LEVEL_LAG = 0.5
"""[s] after which a trunk that is told to be level is: the simulated one follows 0.13 s late, and its last 3 deg take
0.4 s."""
STANDING_TIME = 0.3
"""[s] for which the velocity has been zero before the trunk tilts."""
AT_REST = 0.1
"""[m/s] measured, up to which a robot counts as standing; yaw rates half, in rad/s."""
TILT_SHARE = 0.5
"""Share of the gate's `max_tilt` from which a trunk tilts no further by command."""


class TrunkTilt:
    """Holds the newest tilt that was accepted, and slews to it or to level. Times in ns."""

    def __init__(self, capabilities: Capabilities, params: GateConfig) -> None:
        self._most = capabilities.max_trunk_tilt
        self._params = params
        self._accepted: PostureCommand | None = None
        self._fresh_from = 0
        self._obstacle = "the robot moves"
        """Why this robot does not tilt now; empty where it may."""
        self.output = PostureCommand(0)
        """What the trunk is told."""
        self._tilted: int | None = None
        """When it was told to tilt last [ns]."""
        self.level = True
        """The trunk has been told to be level for `LEVEL_LAG`."""

    def command(self, command: PostureCommand, now: int, latched: str) -> Refusal | None:
        """Take a tilt, or say why not; `latched`: why the gate is, empty where it is not."""
        angles = (command.roll, command.pitch)
        age = (now - command.stamp) / NS
        if not all(map(math.isfinite, angles)):
            return Refusal(RefusalReason.NOT_FINITE, f"roll, pitch = {angles}")
        if max(map(abs, angles)) > self._most + 1e-6:
            cannot = "this controller cannot tilt its trunk"
            limit = f"limit {self._most:.2f} rad" if self._most > 0.0 else cannot
            return Refusal(RefusalReason.OVER_LIMIT, f"roll, pitch {angles[0]:.2f}, {angles[1]:.2f}; {limit}")
        if age < -self._params.future:
            return Refusal(RefusalReason.FROM_FUTURE, f"stamp is {-age:.3f} s ahead of the clock")
        if age >= self._params.deadman:
            return Refusal(RefusalReason.TOO_OLD, f"{age:.3f} s old, limit {self._params.deadman} s")
        if latched:
            return Refusal(RefusalReason.LATCHED, latched)
        if self._obstacle:
            return Refusal(RefusalReason.NOT_STANDING, self._obstacle)
        self._accepted, self._fresh_from = command, min(command.stamp, now)
        return None

    def step(self, now: int, elapsed: float, inputs: GateInputs, zero_since: int | None) -> None:
        """`elapsed` [s] since the last call; `zero_since`: the commanded velocity has been zero since then, None if
        it is not."""
        self._obstacle = self._why_not(now, inputs, zero_since)
        if self._obstacle or not 0.0 <= (now - self._fresh_from) / NS < self._params.deadman:
            self._accepted = None
        told = self._accepted
        most = TILT_RATE * elapsed

        def slew(before: float, wanted: float) -> float:
            return before + max(-most, min(most, wanted - before))

        wanted = (0.0, 0.0) if told is None else (told.roll, told.pitch)
        self.output = PostureCommand(
            now, roll=slew(self.output.roll, wanted[0]), pitch=slew(self.output.pitch, wanted[1])
        )
        if (self.output.roll, self.output.pitch) != (0.0, 0.0):
            self._tilted = now
        self.level = self._tilted is None or not 0 <= now - self._tilted < LEVEL_LAG * NS

    def _why_not(self, now: int, inputs: GateInputs, zero_since: int | None) -> str:
        if zero_since is None or (now - zero_since) / NS < STANDING_TIME:
            return "the robot moves, or is held"
        if not self.level:
            return ""
        speed = inputs.velocity or (0.0, 0.0, 0.0)
        if not max(math.hypot(*speed[:2]), 0.5 * abs(speed[2])) <= AT_REST:
            return "the robot moves"
        limit = TILT_SHARE * self._params.max_tilt
        return (
            "" if inputs.tilt is not None and inputs.tilt <= limit else f"it leans more than {limit:.2f} rad"
        )
