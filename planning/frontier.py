"""Which frontier to drive to when the goal lies beyond known ground.

A frontier's worth is the cost to get there plus the planar distance from there to the goal: what is left can hardly
be cheaper. A frontier once chosen is kept until another is better by a clear margin, so that a robot between two equal
frontiers makes up its mind. The state of that memory is the caller's: it goes in with the request.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from planning.graph import TraversalGraph

SAME_FRONTIER = 1.0
"""Frontier nodes within this distance [m] of the one chosen before count as the same frontier."""
SWITCH_SHARE = 0.10
SWITCH_LEAST = 0.5
"""Another frontier must be better by this share of the kept one's worth and by at least this much [m]."""
LOOKED = 0.5
"""Frontier nodes within this distance [m] of the robot or of a place looked from already show nothing new."""


def open_frontiers(
    graph: TraversalGraph, start: int, seen: Sequence[tuple[float, float]]
) -> NDArray[np.bool_]:
    """(n,) frontier nodes that are worth driving to from node `start`."""
    out = graph.frontier.copy()
    for x, y in [(graph.nodes[start, 0], graph.nodes[start, 1]), *seen]:
        out &= np.hypot(graph.nodes[:, 0] - x, graph.nodes[:, 1] - y) > LOOKED
    return out


def worth_keeping(
    kept_cost: float,
    kept: NDArray[np.float64],
    best_cost: float,
    best: NDArray[np.float64],
    goal: tuple[float, float],
) -> bool:
    """Whether the frontier chosen before stays chosen although another one is better.

    kept, best: x, y[, z] of the two frontiers [m]; costs are those of the routes to them.
    """
    worth_kept = kept_cost + float(np.hypot(kept[0] - goal[0], kept[1] - goal[1]))
    worth_best = best_cost + float(np.hypot(best[0] - goal[0], best[1] - goal[1]))
    return worth_kept - worth_best < max(SWITCH_LEAST, SWITCH_SHARE * worth_kept)
