"""Lower bound of the core maxima of any route on a graph, which the terrain between start and goal sets."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planning.risk.body import BodyModel, edge_poses
from planning.risk.footprint import poses_features
from planning.risk.table import RiskTable


def edge_peaks(table: RiskTable, body: BodyModel) -> NDArray[np.float64]:
    """(m, 3) largest d_fb [m], a_lr [deg], p_int [m] along every edge of `graph.edges`."""
    xy = table.graph.nodes[:, :2]
    sets = [edge_poses(xy[a], xy[b], body) for a, b in table.graph.edges]
    starts = np.cumsum([0, *(len(s) for s in sets[:-1])])
    features = poses_features(table.sampler, np.ascontiguousarray(np.concatenate(sets)))
    return np.maximum.reduceat(features[:, :3], starts, axis=0)


def least_maxima(
    edges: NDArray[np.int64], peaks: NDArray[np.float64], nodes: int, start: int, goal: int
) -> NDArray[np.float64]:
    """(3,) least possible maximum of each feature, for each by a route of its own; turns are not counted.

    Edges are added from the best to the worst until start and goal are joined: the last one decides.
    """
    out = np.zeros(3)
    for k in range(3):
        group = np.arange(nodes)

        def root(i: int, group: NDArray[np.int64] = group) -> int:
            while group[i] != i:
                group[i] = group[group[i]]
                i = int(group[i])
            return i

        for e in np.argsort(peaks[:, k], kind="stable"):
            group[root(int(edges[e, 0]))] = root(int(edges[e, 1]))
            if root(start) == root(goal):
                out[k] = peaks[e, k]
                break
    return out
