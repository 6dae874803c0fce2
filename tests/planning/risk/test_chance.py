"""How likely a route fails: each thing on the way is found once, with its size, and told by its place."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from hal.envelope import Envelope, stored
from mapping.grid import ElevationGrid
from planning.graph import GraphParams, TraversalGraph
from planning.graph.prices import ENDING, ending, hazards
from planning.risk.chance import Chance, Drive, Part, Way, chance

RES = 0.04
LINE = np.array([(1.0, 2.0), (2.0, 2.0), (3.0, 2.0), (4.0, 2.0)])


@pytest.fixture(scope="module")
def envelope() -> Envelope:
    return stored("hybrid")


def ground(height: Callable[[np.ndarray, np.ndarray], np.ndarray], noise: float = 0.003) -> ElevationGrid:
    """5 x 4 m of it, with the noise of a map [m]."""
    y, x = np.mgrid[0:100, 0:125] * RES
    z = height(x, y) + noise * np.random.default_rng(0).standard_normal(x.shape)
    return ElevationGrid(z.astype(np.float32), np.ones(x.shape, bool), (0.0, 0.0), RES)


def drive(
    envelope: Envelope,
    grid: ElevationGrid,
    xy: np.ndarray = LINE,
    *,
    back: bool = False,
    yaw: float = math.nan,
) -> tuple[Chance, list[Part]]:
    """The chance of a way over it, and its parts that may go wrong."""
    params = GraphParams(max_step=0.3)
    graph = TraversalGraph.build(grid, (1.0, 2.0), params, 0)
    assert graph.cells is not None
    way = Way(xy, np.full(len(xy) - 1, back), yaw, math.nan)
    return chance(envelope, grid, graph.cells, way, params), list(
        Drive(envelope, grid, graph.cells, way, params).parts()
    )


def kerb(height: float, angle: float = 0.0) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """A face at x 2.5 y 2.0 whose normal is `angle` [rad] off the x axis."""
    return lambda x, y: height * ((x - 2.5) * math.cos(angle) + (y - 2.0) * math.sin(angle) > 0.0)


@pytest.mark.parametrize("degrees", [0, 20, 45, 60])
@pytest.mark.parametrize(("height", "name"), [(0.16, "up"), (-0.16, "down")])
def test_a_kerb_is_one_crossing_at_its_angle(
    envelope: Envelope, height: float, name: str, degrees: int
) -> None:
    _, parts = drive(envelope, ground(kerb(height, math.radians(degrees))))
    faces = [p for p in parts if p.words.startswith(name)]
    assert len(faces) == 4, "each wheel crosses it once"
    share = ending(envelope.manoeuvres[name])
    low, high = (
        float(hazards(envelope, name, 0.0, 0.16 + d, math.radians(max(0, degrees + a)), 0.0, share=share))
        for d, a in ((-0.012, -8), (0.012, 8))
    )
    assert low <= sum(p.hazard for p in faces) <= high
    assert np.mean([p.x for p in faces]) == pytest.approx(2.5, abs=0.08)


def test_a_kerb_under_the_left_wheels_is_half_of_one(envelope: Envelope) -> None:
    whole, half = (
        drive(envelope, ground(shape, noise=0.0))[1]
        for shape in (kerb(0.16), lambda x, y: 0.16 * ((x > 2.5) & (y > 2.0)))
    )
    both = [sum(p.hazard for p in parts if p.words.startswith("up a")) for parts in (whole, half)]
    assert both[1] == pytest.approx(0.5 * both[0], rel=0.15)


def test_a_face_that_the_wheels_pass_beside_is_not_crossed(envelope: Envelope) -> None:
    _, parts = drive(envelope, ground(lambda x, y: 0.16 * (y > 2.45)))
    assert not [p for p in parts if p.words.startswith(("up", "down"))]


def test_backward_has_its_own_trials(envelope: Envelope) -> None:
    ahead, behind = (drive(envelope, ground(kerb(0.12)), back=back)[0] for back in (False, True))
    assert behind.p_fail > 5.0 * ahead.p_fail
    assert "backward" in behind.worst


def test_even_ground_and_gentle_ramps_fail_hardly_ever(envelope: Envelope) -> None:
    for shape in (lambda x, y: 0.0 * x, lambda x, y: 0.15 * x, lambda x, y: 0.15 * y):
        found, _ = drive(envelope, ground(shape, noise=0.006))
        assert found.p_fail < 0.002
        assert found.worst == ""


def test_stairs_are_risers_not_a_slope_or_kerbs(envelope: Envelope) -> None:
    grid = ground(lambda x, y: 0.15 * np.clip(np.floor((x - 2.0) / 0.32) + 1.0, 0.0, 4.0), noise=0.0)
    found, parts = drive(envelope, grid)
    stairs = [p for p in parts if p.words.startswith("up stairs")]
    assert len(stairs) == 16, "four wheels on four risers"
    assert not [p for p in parts if "slope" in p.words and p.hazard > 1e-3]
    share = ending(envelope.manoeuvres["stairs_up"])
    each = float(hazards(envelope, "stairs_up", 0.0, 0.15, 0.32, 0.0, share=share))
    assert sum(p.hazard for p in stairs) == pytest.approx(4.0 * each, rel=0.3)
    assert found.worst.startswith("up stairs of 0.15 m")


def test_a_turn_on_the_spot_counts_what_lies_under_and_beside_it(envelope: Envelope) -> None:
    corner = np.array([(1.0, 2.0), (2.5, 2.0), (2.5, 3.5)])
    far = np.array([(1.0, 2.0), (1.6, 2.0), (1.6, 3.5)])
    astride, away = (drive(envelope, ground(kerb(0.10)), xy)[1] for xy in (corner, far))
    told = [p for p in astride if p.words.startswith("a turn of 90 deg astride a 0.1")]
    share = ending(envelope.manoeuvres["spin"])
    radian = float(hazards(envelope, "spin", 0.0, 0.10, 0.0, 1.0, share=share))
    assert sum(p.hazard for p in told) == pytest.approx(0.5 * math.pi * radian, rel=0.25)
    assert not [p for p in away if p.words.startswith("a turn") and p.hazard > 1e-4]


def test_a_height_that_is_not_sure_fails_more_often(envelope: Envelope) -> None:
    grid = ground(kerb(0.2), noise=0.0)
    unsure = ElevationGrid(
        grid.height, grid.trusted, grid.origin, RES, variance=np.full(grid.shape, 0.03**2, np.float32)
    )
    assert drive(envelope, unsure)[0].p_fail > 1.2 * drive(envelope, grid)[0].p_fail


def test_the_whole_is_made_of_its_transitions_and_tells_the_worst_place(envelope: Envelope) -> None:
    found, _ = drive(envelope, ground(kerb(0.2, math.radians(50.0))))
    assert len(found.each) == 3
    assert found.p_fail == pytest.approx(1.0 - np.prod(1.0 - np.array(found.each)))
    assert found.p_fail > 0.005
    assert found.worst.startswith("up a 0.2")
    assert " at x 2." in found.worst


def test_what_ends_no_drive_counts_as_the_share_that_does(envelope: Envelope) -> None:
    """A slide off the line is led back: of the failures up a face few end a drive, but never none."""
    table = envelope.manoeuvres["up"]
    assert ENDING == ("fell", "stuck", "touched")
    assert 0.0 < ending(table) < 0.3
    stuck = table.model_copy(update={"cells": ((0.2, 0.0, 0.0, 9.0, 0.0, 3.0, 0.0, 0.0),)})
    assert ending(stuck) == pytest.approx(3.5 / 4.0)
