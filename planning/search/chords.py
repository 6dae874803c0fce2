"""What came of straightening stretches of a route, kept for the next query.

On a large map the route is the same but for its begin, and most chords that are tried are refused. A stretch is found by all that the outcome depends
on beside the ground, to the bit, and holds until ground around it changes (`Cells.node_revision`).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mapping.grid import ElevationGrid
from planning.graph.cells import Cells
from planning.graph.graph import TraversalGraph
from planning.risk.table import RiskTable
from planning.search.explain import Route
from planning.search.guarded import REACH
from planning.search.request import DriveRules

NEAR = 1.2
"""[m] A stretch so near to where the robot stands depends on that as well: the ground under it counts as free."""
MOST = 1000
"""Stretches that are kept, 5 MB. A route of 144 m has 220 in both passes."""
Key = tuple[DriveRules, bytes]


class Stretch(NamedTuple):
    """What came of one."""

    version: int
    """Of the graph that it holds for."""
    around: NDArray[np.float64]
    """Box x0, y0, x1, y1 [m] of its points."""
    span: int
    """Edges that a chord replaced; less than two: no chord was taken."""
    peaks: NDArray[np.float64]
    """(k, 3) largest core features of the chords that cost less. The last one was taken, if any was: the others went beyond what the route has elsewhere."""
    parts: tuple[NDArray[np.generic], ...]
    """What a chord changed, see `_parts`."""


@dataclass(slots=True)
class Chords:
    """Stretches of routes over one graph, the one that was used last at the end."""

    graph: TraversalGraph
    grid: ElevationGrid
    version: int
    """Of the graph on that grid."""
    known: dict[Key, Stretch] = field(default_factory=dict)

    @classmethod
    def of(cls, table: RiskTable, graph: TraversalGraph) -> Chords:
        """Those that `table` keeps for `graph`, which has no nodes of a query. None is left where the map is another and the graph has not followed it."""
        kept = table.chords
        if not isinstance(kept, cls) or kept.graph is not graph:
            kept = table.chords = cls(graph, table.grid, graph.version)
        if kept.grid is not table.grid and kept.version == graph.version:
            kept.known.clear()
        kept.grid, kept.version = table.grid, graph.version
        return kept

    def take(
        self, key: Key, route: Route, cost: NDArray[np.float64], most: NDArray[np.float64], i: int
    ) -> int | None:
        """Bring `route` and `cost` to what came of the stretch from point i before: how many edges were replaced; None where that is not known. No chord may go beyond `most` (3,)."""
        cells, old = self.graph.cells, self.known.pop(key, None)
        if (
            old is None
            or cells is None
            or (old.version < self.version and _newest(cells, old.around) > old.version)
        ):
            return None
        fits = [bool((peaks <= most).all()) for peaks in old.peaks]
        if sum(fits) != (old.span >= 2) or (old.span >= 2 and not fits[-1]):
            return None
        self.known[key] = old._replace(version=self.version)
        if old.span >= 2:
            for part, kept in zip(_parts(route, cost, i, old.span), old.parts, strict=True):
                part[:] = kept
        return old.span

    def add(
        self,
        key: Key,
        route: Route,
        cost: NDArray[np.float64],
        i: int,
        span: int,
        peaks: list[NDArray[np.float64]],
        around: NDArray[np.float64],
    ) -> None:
        """Keep what came of the stretch from point i whose points lay `around`."""
        parts = tuple(part.copy() for part in _parts(route, cost, i, span)) if span >= 2 else ()
        self.known[key] = Stretch(self.version, around, span, np.array(peaks).reshape(-1, 3), parts)
        if len(self.known) > MOST:
            del self.known[next(iter(self.known))]


def key_of(route: Route, cost: NDArray[np.float64], i: int, longest: int) -> tuple[Key, NDArray[np.float64]]:
    """All that making straight a stretch of up to `longest` edges from point i > 0 depends on beside the ground, and the box of its points (see `Stretch`)."""
    last = len(route.risk)
    a, b = max(i - 1, 0), min(i + longest + 1, last)
    xy = route.xy[a : b + 1]
    ends = [b == last, route.goal_yaw]
    parts = (
        xy,
        cost[i:b],
        route.risk[i:b],
        route.turn_rate[i : b + 1],
        route.forward_only[i : b + 1],
        route.back[a:b],
        route.flip[i:b],
    )
    return (
        route.rules,
        b"".join([np.array(ends).tobytes(), *(part.tobytes() for part in parts)]),
    ), np.concatenate([xy.min(axis=0), xy.max(axis=0)])


def _parts(route: Route, cost: NDArray[np.float64], i: int, span: int) -> tuple[NDArray[np.generic], ...]:
    """What a chord from point i over so many edges changes, as views."""
    inner, after = slice(i + 1, i + span), slice(i, min(i + span + 1, len(route.risk)))
    return (
        route.xy[inner],
        route.turn_rate[inner],
        route.forward_only[inner],
        route.risk[i : i + span],
        route.moments[after],
        cost[after],
    )


def _newest(cells: Cells, around: NDArray[np.float64]) -> int:
    """The version at which ground last changed that a move between places in a box, or a turn there, depends on."""
    return int(cells.node_revision[cells.within(around, REACH)].max(initial=0))
