"""Queries on which two methods fared differently."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tools.bench.closed_loop import protocol
from tools.bench.closed_loop.routes import Route
from tools.bench.closed_loop.trial import distance

Record = dict[str, Any]
STAY_RADIUS = 0.3
"""A robot ended where it came this close [m] to its last place for good."""


@dataclass(frozen=True, slots=True)
class End:
    """Where and when a drive ended."""

    time: float
    """[s] after driving off."""
    place: tuple[float, float]
    """x, y [m]."""
    transition: int
    """Of the route, nearest to the place."""


@dataclass(frozen=True, slots=True)
class Case:
    """A query on which two methods fared differently."""

    scene: str
    query: int
    routes: tuple[Route, Route]
    draws: list[tuple[Record, Record]]
    """All draws of both."""

    @property
    def parted(self) -> list[tuple[Record, Record]]:
        """Draws in which one arrived."""
        return [pair for pair in self.draws if pair[0]["success"] != pair[1]["success"]]

    @property
    def shared(self) -> int:
        """Nodes that the routes share from the start on."""
        pairs = zip(*(r.vertices for r in self.routes), strict=False)
        return next(
            (k for k, (a, b) in enumerate(pairs) if a != b), min(len(r.vertices) for r in self.routes)
        )


def cases(
    records: Sequence[Record], routes: Sequence[Route], methods: tuple[str, str], setting: tuple[str, str]
) -> list[Case]:
    """Of two methods that share a graph, with a controller and a collider set: queries whose routes part and whose
    outcomes differ."""
    lines = {(r.scene, r.query, r.method): r for r in routes}
    mine = {
        (r["scene"], r["query"], r["draw"], r["method"]): r
        for r in records
        if (r["controller"], r["colliders"]) == setting
    }
    out = []
    for scene in protocol.SCENES:
        for query in sorted({q for s, q, _, _ in mine if s == scene}):
            draws = sorted({d for s, q, d, _ in mine if (s, q) == (scene, query)})
            pairs = [tuple(mine.get((scene, query, d, m)) for m in methods) for d in draws]
            both = [(a, b) for a, b in pairs if a is not None and b is not None]
            if not both:
                continue
            case = Case(
                scene, query, (lines[scene, query, methods[0]], lines[scene, query, methods[1]]), both
            )
            if case.parted and case.routes[0].vertices != case.routes[1].vertices:
                out.append(case)
    return out


def end_of(record: Record, route: Route) -> End | None:
    """Where a drive ended; None where it never began."""
    if not record.get("trace"):
        return None
    trace = np.array(record["trace"])
    last = trace[-1, 1:3]
    away = np.flatnonzero(np.hypot(*(trace[:, 1:3] - last).T) > STAY_RADIUS)
    k = int(away[-1]) + 1 if len(away) else 0
    vertices = np.array(route.vertices)
    nearest = [float(distance(last[None], vertices[i : i + 2])[0]) for i in range(len(vertices) - 1)]
    return End(float(trace[k, 0]), (float(last[0]), float(last[1])), int(np.argmin(nearest)))
