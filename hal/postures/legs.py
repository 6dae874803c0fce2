"""What the postures need to know of a robot that stands on legs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from hal.limbs import Limbs, stand_height
from hal.lowlevel import LowCommand, LowState
from hal.types import Array

UPRIGHT_COSINE = 0.85
"""Cosine of the tilt from which a robot may get up."""


class Righting(Protocol):
    """Turns a fallen robot onto its belly. `step` is called once per control tick until `upright` or `failed`."""

    upright: bool
    failed: bool

    def step(self, state: LowState) -> LowCommand:
        """One control tick."""


@dataclass(frozen=True, slots=True, eq=False)
class Legs:
    """The legs of one robot."""

    limbs: Limbs
    stand: Array
    """(16,) [rad] default stand."""
    seat: Array
    """(16,) [rad] lying on its folded legs."""
    tall: float
    """Height [m] of base_link above the wheels' lowest points that counts as standing: between seat and stance."""
    angles: Callable[[Array], Array]
    """Inverse of `hal.limbs.wheel_centres`: (4, 3) [m] -> (16,) [rad], the nearest inside the joints' limits."""
    righting: Callable[[LowState, float], Righting] | None = None
    """Begins to turn it over; no new try after the time [s] given. None: it cannot."""

    def stretched(self, q: Array) -> bool:
        """Whether joints (16,) [rad] are those of a robot that stands."""
        return stand_height(self.limbs, q) > self.tall
