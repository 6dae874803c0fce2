"""Stairs are a way as steep as the controller was measured to climb them, and no slope."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

from hal.envelope import MAX_RISK, stored
from mapping.grid import ElevationGrid
from planning import NoRoute
from planning.graph.faces import update_faces
from planning.graph.graph import GraphParams, TraversalGraph
from planning.graph.prices import FLIGHT_RISERS, ending
from planning.risk.body import BodyModel
from planning.search import PlanRequest, plan

RES = 0.04
CLIMBER = {"max_step": 0.20, "max_slope": np.radians(30), "controller": "hybrid", "blind_radius": 0.0}
BELOW, ABOVE = (0.9, 1.5), (5.8, 1.5)


def flight(riser: float, tread: float, degrees: float = 0.0) -> ElevationGrid:
    """Six steps up from (2.2, 1.5), whose normal is so many degrees off the x axis; walls along y 0.8 and 2.2 m."""
    y, x = np.mgrid[0:75, 0:170] * RES
    a = np.radians(degrees)
    along = (x - 2.2) * np.cos(a) + (y - 1.5) * np.sin(a)
    z = riser * np.clip(np.floor(along / tread) + 1, 0, 6)
    z += 0.004 * np.random.default_rng(0).standard_normal(z.shape)
    z[np.abs(y - 1.5) > 0.7] = 3.0
    return ElevationGrid(z.astype(np.float32), np.ones(z.shape, bool), (0.0, 0.0), RES)


def found(grid: ElevationGrid, up: bool, **params: object) -> bool:
    start, goal = (BELOW, ABOVE) if up else (ABOVE, BELOW)
    graph = TraversalGraph.build(grid, start, GraphParams(**{**CLIMBER, **params}), 0)
    try:
        way = plan(graph, grid, PlanRequest(start, goal, 0.0 if up else np.pi), BodyModel())
    except NoRoute:
        return False
    return way.short == 0.0


@pytest.mark.parametrize("up", [True, False])
@pytest.mark.parametrize(
    ("riser", "tread", "way"),
    [(0.15, 0.30, True), (0.17, 0.28, True), (0.18, 0.26, False), (0.20, 0.26, False)],
)
def test_stairs_are_a_way_as_far_as_the_envelope_says_from_below_and_from_above(
    riser: float, tread: float, way: bool, up: bool
) -> None:
    envelope = stored("hybrid")
    ends = max(
        float(envelope.bound(name, riser, tread, 0.0, share=partial(ending, name)))
        for name in ("stairs_up", "stairs_down")
    )
    assert (1.0 - (1.0 - ends) ** FLIGHT_RISERS <= MAX_RISK) == way, "what the envelope says"
    assert found(flight(riser, tread), up) == way


def test_without_an_envelope_stairs_are_a_slope() -> None:
    assert not found(flight(0.18, 0.26), True, controller=None)


def test_a_slope_as_steep_as_stairs_is_no_stairs() -> None:
    grid = flight(0.18, 0.26)
    x = np.arange(170) * RES
    for degrees, way in ((28, True), (35, False)):
        z = np.clip((x - 2.2) * np.tan(np.radians(degrees)), 0.0, 1.1)[None, :] + np.zeros((75, 1))
        z += 0.01 * np.random.default_rng(1).standard_normal(z.shape)
        z[np.abs(np.arange(75) * RES - 1.5) > 0.7] = 3.0
        ramp = ElevationGrid(z.astype(np.float32), grid.trusted, grid.origin, RES)
        assert found(ramp, True) == way, degrees


@pytest.mark.parametrize("tread", [0.24, 0.28])
def test_a_riser_is_as_high_as_it_is_and_a_steep_slope_as_high_as_it_goes_on(tread: float) -> None:
    """Risers 0.17 m high that the map smears over two cells, against one slope of the same steepness."""
    x = np.arange(170) * RES
    steps = 0.17 * np.clip((x - 2.0) // tread + np.clip((x - 2.0) % tread / 0.06, 0.0, 1.0), 0.0, 6.0)
    slope = np.clip((x - 2.0) * 0.85, 0.0, 1.0)
    highest = []
    for profile in (steps, slope):
        z = np.broadcast_to(profile, (40, 170)).astype(np.float32).copy()
        faces = np.zeros((40, 170, 2), np.int16)
        update_faces(faces, z, np.ones(z.shape, bool), RES, 0, 0, *z.shape)
        highest.append(0.001 * faces[20, :, 0].max())
    assert highest[0] == pytest.approx(0.17, abs=0.02)
    assert highest[1] > 0.30
