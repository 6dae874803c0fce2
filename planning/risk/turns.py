"""Turning in place beyond the paper's cost: where there is room for it, and what an edge under the wheels adds.

An edge that is driven over straight ahead can tip a robot that turns on it: of a simulated one with a bar of 4 cm under it
about 4 % fell per radian. A fall weighs as much as 100 m of driving: such turns cost 4 m per radian, so they are made
where there is no other way. Beside a higher edge a wheel drops off it: of 80 such turns by 45 deg, 0.18 m from the edge, none of 16
fell at 8 cm, 5 of 48 at 10 to 15 cm and 6 of 16 at 19 cm (hybrid controller, physics alone). On steep ground the robot slides 0.1 m down for each radian (`tools.bench envelope`, rows `turn_ramp_*`), in a bend as well, and
one that turned beside the edge of a ramp of 27 deg slid over it.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from planning.graph.describe import HEADINGS, turn_is_free
from planning.graph.faces import FACE_NOISE
from planning.graph.params import GraphParams

TURN_COST, STEEP_COST = 4.0, 8.0
"""[m/rad] over an edge, and on ground too steep for turns."""
HIGH_EDGES = ((0.09, 13.0), (0.16, 50.0))
"""[m] above which an edge costs so much [m/rad] instead of TURN_COST."""
LOW_BEND = HIGH_EDGES[0][1]
"""[m/rad] of a bend up to BEND over any of these."""
FREE_TURN, BEND = np.radians(30.0), np.radians(15.0)
"""[rad] Turns over an edge up to FREE_TURN are driven as a bend and cost nothing more. Over a high one every bend has its price, up to BEND the lower of HIGH_EDGES: while
the robot drove down a kerb of 19 cm none of 100 fell that drove straight, 1 of 40 in bends of 20 and 30 deg, and 7 of 40 in those of 35 and 45 deg,
and a bend of 50 deg is as well five of 10 deg, one after the other (lane 774 fell in one)."""
FORWARD_ONLY = 10.0
"""What a metre driven backward costs more often over a face that is climbed forward only: 15 of 18 drives of the hybrid controller backward over bars of 15 and 20 cm were stuck."""
_STEP = np.pi / HEADINGS


@njit(cache=True)
def turn_cost(rate: float, turn: float, each: float) -> float:
    """What a turn in place by `turn` [rad] costs more [m]: `each` [m/rad] anywhere, and what `rate` [m/rad] says where it turns over an edge or on steep ground."""
    size, more = abs(turn), abs(rate)
    if rate == TURN_COST and size <= FREE_TURN:
        more = 0.0
    elif rate > STEEP_COST and size <= BEND:
        more = min(more, LOW_BEND)
    return (each + more) * size


def turn_rates(turn_edge: NDArray[np.floating] | float, params: GraphParams) -> NDArray[np.float64]:
    """`rate` [m/rad] at places with the highest edge `turn_edge` [m] under the wheels, in its shape. What is higher than the robot climbs stands beside it.
    Negative, as the edge is, where the robot stands astride it: the whole rate counts at any angle there."""
    edge, sign = np.abs(np.asarray(turn_edge, np.float64)), np.sign(turn_edge)
    rate = np.where(edge > params.max_turn_step, TURN_COST, 0.0)
    if params.max_turn_step < np.inf:
        for height, cost in HIGH_EDGES:
            rate = np.where((edge > height) & (edge <= params.climbed), cost, rate)
        rate = np.where(np.isinf(edge), STEEP_COST, rate)
    return np.where(sign < 0.0, -rate, rate)


def forward_only(turn_edge: NDArray[np.floating] | float, params: GraphParams) -> NDArray[np.bool_]:
    """Whether a face under the wheels, `turn_edge` [m], is too high to be climbed backward, in its shape. What is higher than the robot climbs stands beside it."""
    least = params.max_step if params.max_step_back is None else params.max_step_back
    edge = np.abs(np.asarray(turn_edge))
    return np.asarray((edge > least + FACE_NOISE) & (edge <= params.climbed))


@njit(cache=True)
def back_factor(backward: float, here: bool, there: bool) -> float:
    """What a metre of an edge driven backward costs; `here`, `there`: `forward_only` at its ends."""
    return backward * FORWARD_ONLY if here or there else backward


@njit(cache=True)
def may_turn_to(room: int, yaw: float, turn: float) -> bool:
    """True if the robot may turn by `turn` [rad, signed] from the heading of an edge and stay there."""
    if turn == 0.0:
        return True
    return turn_is_free(room, yaw, turn + (_STEP if turn > 0.0 else -_STEP))
