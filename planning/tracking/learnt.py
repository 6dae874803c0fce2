"""What the drive does otherwise than commanded, learnt while it drives: it drifts sideways, and it is slower."""

from __future__ import annotations

_MAX_DRIFT = 0.35
"""Bound of the sideways drift [rad]."""
_SLIP_RATE = 1.0
"""How fast the slip is learnt [1/s]."""
_MAX_SLIP = 0.1
"""Bound of the slip: the share of the commanded speed that is missing, as far as it is made up for."""
_STEADY_SPEED = 0.02
"""Slip is learnt while the command is this close to what it goes to [m/s] ..."""
_ROLLING_SHARE = 0.7
"""... and the base has this share of its speed: one that the ground holds does not slip."""


class Learnt:
    """Drift and slip of a base that drives in one direction: a new one where it turns round."""

    def __init__(self) -> None:
        self.drift = 0.0
        """Angle [rad] by which the base goes aside."""
        self.slip = 0.0
        """Share of the commanded speed that is missing."""

    def learn_drift(self, change: float) -> None:
        """Add `change` [rad]."""
        self.drift = max(-_MAX_DRIFT, min(_MAX_DRIFT, self.drift + change))

    def command(self, speed: float) -> float:
        """The command [m/s] that makes the base drive at `speed` [m/s]."""
        return speed * (1.0 + self.slip)

    def learn_slip(self, speed: float, measured: float, commanded: float, dt: float) -> None:
        """From the measured speed of a base that is to drive at `speed`, and the command it was given; all [m/s], in
        the direction of travel."""
        if measured > _ROLLING_SHARE * speed and abs(self.command(speed) - commanded) < _STEADY_SPEED:
            slip = self.slip + _SLIP_RATE * (1.0 - measured / speed) * dt
            self.slip = max(-_MAX_SLIP, min(_MAX_SLIP, slip))
