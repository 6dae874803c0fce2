"""A pose graph of x, y, z and yaw: gravity tells roll and pitch everywhere, so nothing that the loops say may tilt the
map.

Gauss-Newton on the sparse normal equations (scipy, SuperLU). Loops count by Cauchy's weight, odometry in full: a loop
that contradicts all others loses its say, and `PoseGraph.solve` tells how much each kept. The same factors give the
covariance of any two nodes, which says where a loop may be.

Odometry errs twice: a little at every step (each edge's sigma), and the same way all along a run (`steady`: it bends,
it climbs). The second grows with the way, not with its root; loops tell how large it was.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csc_matrix
from scipy.sparse.linalg import SuperLU, splu

from hal.rotation import wrap
from hal.types import Array

HELD_SIGMA = (1e-4, 1e-4, 1e-4, 1e-5)
"""Standard deviations of the first node, which makes the frame [m], [rad],"""
FREE_SIGMA = (1e3, 1e3, 1e3, 10.0)
"""and of the first node of a run whose place among the others is not known."""
CAUCHY_WIDTH = 3.0
"""Standard deviations at which a loop has half of its weight."""
MOST_STEPS, SMALL_STEP = 50, 1e-5
"""Of the iteration at most, and the step [m, rad] that ends it."""


def between(a: Array, b: Array) -> Array:
    """(..., 4) poses b in the frames of a, both (..., 4): x, y, z [m], yaw [rad]."""
    d = b - a
    c, s = np.cos(a[..., 3]), np.sin(a[..., 3])
    x, y = c * d[..., 0] + s * d[..., 1], c * d[..., 1] - s * d[..., 0]
    return np.stack([x, y, d[..., 2], wrap(d[..., 3])], axis=-1)


def after(a: Array, relative: Array) -> Array:
    """(..., 4) poses that are `relative` (..., 4) in the frames of a (..., 4)."""
    c, s = np.cos(a[..., 3]), np.sin(a[..., 3])
    x, y = relative[..., 0], relative[..., 1]
    moved = c * x - s * y, s * x + c * y, relative[..., 2], relative[..., 3]
    out = a + np.stack(moved, axis=-1)
    out[..., 3] = wrap(out[..., 3])
    return out


def back(relative: Array) -> Array:
    """(..., 4) the inverse of relative poses (..., 4)."""
    return between(relative, np.zeros_like(relative))


def jacobians(a: Array, b: Array) -> tuple[Array, Array]:
    """(m, 4, 4) each: of `between(a, b)` by a and by b (m, 4)."""
    n = len(a)
    c, s = np.cos(a[:, 3]), np.sin(a[:, 3])
    by_b = np.zeros((n, 4, 4))
    by_b[:, 0, 0], by_b[:, 0, 1], by_b[:, 1, 0], by_b[:, 1, 1] = c, s, -s, c
    by_b[:, 2, 2] = by_b[:, 3, 3] = 1.0
    by_a = -by_b
    here = between(a, b)
    by_a[:, 0, 3], by_a[:, 1, 3] = here[:, 1], -here[:, 0]
    return by_a, by_b


@dataclass(frozen=True, slots=True, eq=False)
class Edges:
    """Relative poses that were measured."""

    first: NDArray[np.int64]
    second: NDArray[np.int64]
    relative: Array
    """(m, 4) second in the frame of first: x, y, z [m], yaw [rad]."""
    sigma: Array
    """(m, 4) standard deviations."""

    def errors(self, nodes: Array) -> Array:
        """(m, 4) what the nodes (n, 4) say less what was measured, in standard deviations."""
        off = between(nodes[self.first], nodes[self.second]) - self.relative
        off[:, 3] = wrap(off[:, 3])
        return np.asarray(off / self.sigma)


class PoseGraph:
    """Nodes and edges in, the most likely nodes out. Same calls, same bytes."""

    def __init__(self) -> None:
        self.nodes = np.empty((0, 4))
        """(n, 4) x, y, z [m], yaw [rad]: as added, then as solved."""
        self._priors: list[tuple[int, Array, Array]] = []
        self._odometry: list[tuple[int, int, Array, Array]] = []
        self._ways: list[tuple[int, float]] = []
        """Of each edge of odometry: its run, and how long it is [m]."""
        self._loops: list[tuple[int, int, Array, Array]] = []
        self._factors: SuperLU | None = None

    def copy(self) -> PoseGraph:
        """Another one that begins as this one is."""
        other = PoseGraph()
        other.nodes = self.nodes.copy()
        other._priors, other._odometry = list(self._priors), list(self._odometry)
        other._ways, other._loops = list(self._ways), list(self._loops)
        return other

    def begin(self, pose: ArrayLike) -> int:
        """The first node of a run, at `pose` (4,); the very first one is held there. Returns its number."""
        sigma = HELD_SIGMA if len(self.nodes) == 0 else FREE_SIGMA
        self._priors.append((len(self.nodes), np.asarray(pose, np.float64), np.array(sigma)))
        return self._append(np.asarray(pose, np.float64))

    def drive(self, relative: ArrayLike, sigma: ArrayLike, way: float = 0.0) -> int:
        """The next node of the run: `relative` (4,) to the newest by odometry, standard deviations (4,), `way` [m] on.
        Returns its number."""
        last = len(self.nodes) - 1
        measured = np.asarray(relative, np.float64)
        self._odometry.append((last, last + 1, measured, np.asarray(sigma, np.float64)))
        self._ways.append((len(self._priors) - 1, way))
        return self._append(after(self.nodes[last], measured))

    def _append(self, pose: Array) -> int:
        self.nodes = np.vstack([self.nodes, pose])
        self._factors = None
        return len(self.nodes) - 1

    def close(self, first: int, second: int, relative: ArrayLike, sigma: ArrayLike) -> int:
        """A loop: node `second` is at `relative` (4,) of `first`, standard deviations (4,). Returns its number."""
        self._loops.append((first, second, np.asarray(relative, np.float64), np.asarray(sigma, np.float64)))
        self._factors = None
        return len(self._loops) - 1

    def measure(self, edge: int, relative: ArrayLike, sigma: ArrayLike, *, loop: bool) -> None:
        """An edge of odometry, or a loop, by its number, was measured anew: `relative` (4,), standard deviations
        (4,)."""
        edges = self._loops if loop else self._odometry
        edges[edge] = (*edges[edge][:2], np.asarray(relative, np.float64), np.asarray(sigma, np.float64))
        self._factors = None

    def drop(self, loops: set[int]) -> None:
        """Take loops out; those that stay keep their order."""
        self._loops = [loop for n, loop in enumerate(self._loops) if n not in loops]
        self._factors = None

    @property
    def loops(self) -> Edges:
        """In the order in which they were closed."""
        return _edges(self._loops)

    @property
    def odometry(self) -> Edges:
        """Of all runs."""
        return _edges(self._odometry)

    def solve(self, steady: ArrayLike | None = None) -> Array:
        """Move the nodes to where odometry and loops put them; returns the weight of each loop (m,), 1 for one that
        fits, 0 for one that does not. steady (4,): standard deviations of what odometry is wrong by all along a run, by
        the metre: ahead, to the left, up, heading [rad]; None: by nothing."""
        measured, loops, n = self.odometry, self.loops, len(self.nodes)
        run, way = np.array(self._ways).reshape(-1, 2).T
        wrong = np.zeros((len(self._priors), 4))
        for _ in range(MOST_STEPS):
            weight = _weights(loops.errors(self.nodes))
            odometry = replace(measured, relative=measured.relative + wrong[run.astype(int)] * way[:, None])
            told = None if steady is None else (wrong, np.asarray(steady, np.float64))
            factors, gradient = self._normal(odometry, loops, weight, told)
            step = factors.solve(-gradient).reshape(-1, 4)
            self.nodes = self.nodes + step[:n]
            self.nodes[:, 3] = wrap(self.nodes[:, 3])
            wrong = wrong if steady is None else wrong + step[n:]
            if np.abs(step[:n]).max(initial=0.0) < SMALL_STEP:
                break
        self._factors = factors if steady is None else None
        return _weights(loops.errors(self.nodes))

    def _normal(
        self,
        odometry: Edges,
        loops: Edges,
        weight: Array,
        steady: tuple[Array, Array] | None = None,
    ) -> tuple[SuperLU, Array]:
        """Factors of the normal equations, and the gradient (4n,). `steady`: what each run is thought to be wrong by
        all along (r, 4), and its standard deviations; then both are of n nodes and r runs."""
        nodes = len(self.nodes)
        n = nodes + (0 if steady is None else len(self._priors))
        gradient = np.zeros((n, 4))
        rows, cols, values = [], [], []

        def enter(i: NDArray[np.int64], j: NDArray[np.int64], blocks: Array) -> None:
            a = np.arange(4)
            rows.append(np.broadcast_to(4 * i[:, None, None] + a[:, None], blocks.shape).ravel())
            cols.append(np.broadcast_to(4 * j[:, None, None] + a, blocks.shape).ravel())
            values.append(blocks.ravel())

        for edges, share in ((odometry, np.ones(len(odometry.first))), (loops, weight)):
            i, j = edges.first, edges.second
            by_i, by_j = (
                jacobian / edges.sigma[:, :, None] for jacobian in jacobians(self.nodes[i], self.nodes[j])
            )
            error = edges.errors(self.nodes) * share[:, None]
            parts = [(i, by_i), (j, by_j)]
            if edges is odometry and steady is not None:
                run, way = np.array(self._ways).reshape(-1, 2).T
                parts.append((nodes + run.astype(int), -np.eye(4) * (way[:, None] / edges.sigma)[:, :, None]))
            for p, one in parts:
                np.add.at(gradient, p, np.einsum("mab,ma->mb", one, error))
                for q, other in parts:
                    enter(p, q, np.einsum("mab,mac,m->mbc", one, other, share))
        if steady is not None:
            wrong, sigma = steady
            gradient[nodes:] += wrong / sigma**2
            own = nodes + np.arange(len(wrong))
            enter(own, own, np.broadcast_to(np.diag(sigma**-2.0), (len(wrong), 4, 4)))
        for node, pose, sigma in self._priors:
            off = self.nodes[node] - pose
            off[3] = wrap(off[3])
            gradient[node] += off / sigma**2
            enter(np.array([node]), np.array([node]), np.diag(sigma**-2.0)[None])
        value, row, col = (np.concatenate(x) for x in (values, rows, cols))
        return splu(csc_matrix((value, (row, col)), shape=(4 * n, 4 * n))), gradient.reshape(-1)

    def apart(self, first: int, second: int) -> tuple[Array, Array]:
        """Pose (4,) of a node in the frame of another as the graph has it, and its covariance (4, 4)."""
        if self._factors is None:
            self._factors, _ = self._normal(
                self.odometry, self.loops, _weights(self.loops.errors(self.nodes))
            )
        a, b = self.nodes[[first]], self.nodes[[second]]
        by_a, by_b = jacobians(a, b)
        side = np.zeros((4 * len(self.nodes), 4))
        side[4 * first : 4 * first + 4] += by_a[0].T
        side[4 * second : 4 * second + 4] += by_b[0].T
        return between(a, b)[0], np.asarray(side.T @ self._factors.solve(side))


def _edges(of: list[tuple[int, int, Array, Array]]) -> Edges:
    return Edges(
        np.array([edge[0] for edge in of], np.int64),
        np.array([edge[1] for edge in of], np.int64),
        np.array([edge[2] for edge in of]).reshape(-1, 4),
        np.array([edge[3] for edge in of]).reshape(-1, 4),
    )


def _weights(errors: Array) -> Array:
    """(m,) Cauchy's weight of loops whose errors are (m, 4) [standard deviations]."""
    return np.asarray(1.0 / (1.0 + (errors**2).sum(axis=1) / CAUCHY_WIDTH**2))


def levelled(pose: Array, below: float = 0.0) -> Array:
    """(4,) x, y, z [m], yaw [rad] of a pose (4, 4), `below` [m] under it: what is left of it when gravity is known."""
    x, y, z = pose[:3, 3].tolist()
    return np.array([x, y, z - below, math.atan2(pose[1, 0], pose[0, 0])])
