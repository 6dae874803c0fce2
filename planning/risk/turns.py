"""Turning in place beyond the paper's cost: where there is room for it, and what the ground under the wheels adds."""

from __future__ import annotations

import math

from numba import njit

from planning.graph.describe import HEADING_STEP, turn_is_free

BEND_ANGLE = math.radians(30.0)
"""Larger turns [rad] are made on the spot."""
STRAIGHT_ANGLE = 0.05
"""Straight moves were tried up to so much off their heading [rad] (`hal.envelope`): a bend counts beyond it."""


@njit(cache=True)
def turn_cost(bend: float, spin: float, turn: float, each: float) -> float:
    """What a turn in place by `turn` [rad] costs more [m]: `each` [m/rad] anywhere, and `bend` or `spin` [m/rad] for
    what is under the wheels (`TraversalGraph.turn_price`)."""
    size = abs(turn)
    if size <= BEND_ANGLE:
        return each * size + bend * max(size - STRAIGHT_ANGLE, 0.0)
    return (each + spin) * size


@njit(cache=True)
def may_turn_to(room: int, yaw: float, turn: float) -> bool:
    """True if the robot may turn by `turn` [rad, signed] from the heading of an edge and stay there."""
    if turn == 0.0:
        return True
    return turn_is_free(room, yaw, turn + (HEADING_STEP if turn > 0.0 else -HEADING_STEP))
