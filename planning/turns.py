"""Where the robot has room to turn in place: a limit of its own beside the cost of the turn."""

from __future__ import annotations

import numpy as np
from numba import njit

from planning.graph_describe import HEADINGS, turn_is_free

_STEP = np.pi / HEADINGS


@njit(cache=True)
def _blocked(room: int, yaw: float) -> bool:
    """True where the free heading nearest to `yaw` is missing."""
    k = int(np.floor(yaw / _STEP + 0.5)) % HEADINGS
    return not (room >> np.uint64(k)) & np.uint64(1)


@njit(cache=True)
def may_turn_off(room: int, yaw: float, turn: float) -> bool:
    """True if a robot that stands at `yaw` may turn by `turn` [rad, signed] into the heading of an edge.

    Where it stands may count as blocked (it is not exactly at the node, and maps are noisy): it may turn out of that,
    but not into anything else.
    """
    sign = 1.0 if turn >= 0.0 else -1.0
    while abs(turn) > _STEP and _blocked(room, yaw):
        yaw += sign * _STEP
        turn -= sign * _STEP
    return turn_is_free(room, yaw, turn)


@njit(cache=True)
def may_turn_to(room: int, yaw: float, turn: float) -> bool:
    """True if the robot may turn by `turn` [rad, signed] from the heading of an edge and stay there."""
    if turn == 0.0:
        return True
    return turn_is_free(room, yaw, turn + (_STEP if turn > 0.0 else -_STEP))
