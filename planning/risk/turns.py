"""Turning in place beyond the paper's cost: where there is room for it, and what an edge under the wheels adds.

An edge that is driven over straight ahead can tip a robot that turns on it: of a simulated one with a bar of 4 cm under it
about 4 % fell per radian. A fall weighs as much as 100 m of driving: such turns cost 4 m per radian, so they are made
where there is no other way.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from planning.graph.describe import HEADINGS, turn_is_free

TURN_COST = 4.0
"""[m/rad]"""
FREE_TURN = np.radians(30.0)
"""Turns up to here [rad] are driven as a bend and cost nothing more."""
_STEP = np.pi / HEADINGS


@njit(cache=True)
def turn_cost(rate: float, turn: float, each: float) -> float:
    """What a turn in place by `turn` [rad] costs more [m]: `each` [m/rad] anywhere, and `rate` [m/rad] where it turns over an edge."""
    return (each + (rate if abs(turn) > FREE_TURN else 0.0)) * abs(turn)


@njit(cache=True)
def may_turn_to(room: int, yaw: float, turn: float) -> bool:
    """True if the robot may turn by `turn` [rad, signed] from the heading of an edge and stay there."""
    if turn == 0.0:
        return True
    return turn_is_free(room, yaw, turn + (_STEP if turn > 0.0 else -_STEP))
