"""How likely a route fails: each thing on the way is found once, with its size, and told by its place."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial

import numpy as np
import pytest

from hal.envelope import Counted, Envelope, Table, stored
from mapping.grid import ElevationGrid
from planning.graph import GraphParams, TraversalGraph
from planning.graph.prices import ENDING, MAP_SIGMA, SLIDES_END, ending, hazards
from planning.risk.body import BodyModel
from planning.risk.chance import Chance, chance
from planning.search.explain import with_chance
from planning.search.plan import PlanRequest, plan

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
    grid: ElevationGrid, xy: np.ndarray = LINE, *, back: bool = False, controller: str | None = "hybrid"
) -> Chance:
    """The chance of a way over it."""
    graph = TraversalGraph.build(grid, (1.0, 2.0), GraphParams(max_step=0.3, controller=controller), 0)
    found = chance(graph, grid, xy, np.full(len(xy) - 1, back))
    assert found is not None
    return found


def hazard(found: Chance) -> float:
    return -math.log1p(-found.p_fail)


def kerb(height: float, angle: float = 0.0) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """A face at x 2.5 y 2.0 whose normal is `angle` [rad] off the x axis."""
    return lambda x, y: height * ((x - 2.5) * math.cos(angle) + (y - 2.0) * math.sin(angle) > 0.0)


@pytest.mark.parametrize("degrees", [0, 20, 45, 60])
@pytest.mark.parametrize(("height", "name"), [(0.16, "up"), (-0.16, "down")])
def test_a_kerb_is_one_crossing_at_its_angle(
    envelope: Envelope, height: float, name: str, degrees: int
) -> None:
    found = drive(ground(kerb(height, math.radians(degrees))))
    low, high = (
        float(hazards(envelope, name, MAP_SIGMA, 0.16 + d, math.radians(max(0, degrees + a)), 0.0))
        for d, a in ((-0.017, -11), (0.017, 11))
    )
    assert low <= hazard(found) <= high
    if found.worst:
        assert found.worst.startswith(f"{name} a 0.1")
        assert ("normal" in found.worst) == (degrees > 0) or degrees == 20, "told from 20 deg on"


def test_a_face_that_the_wheels_pass_beside_is_not_crossed() -> None:
    assert drive(ground(lambda x, y: 0.16 * (y > 2.45))).p_fail < 1e-4


def test_backward_has_its_own_trials() -> None:
    ahead, behind = (drive(ground(kerb(0.12)), back=back) for back in (False, True))
    assert behind.p_fail > 5.0 * ahead.p_fail
    assert "backward" in behind.worst


def test_even_ground_and_gentle_ramps_fail_hardly_ever() -> None:
    for shape in (lambda x, y: 0.0 * x, lambda x, y: 0.15 * x, lambda x, y: 0.15 * y):
        found = drive(ground(shape, noise=0.006))
        assert found.p_fail < 0.002
        assert found.worst == ""


def test_stairs_are_risers_not_a_slope_or_kerbs(envelope: Envelope) -> None:
    grid = ground(lambda x, y: 0.15 * np.clip(np.floor((x - 2.0) / 0.32) + 1.0, 0.0, 4.0), noise=0.0)
    found = drive(grid)
    each = float(hazards(envelope, "stairs_up", MAP_SIGMA, 0.15, 0.32, 0.0))
    assert hazard(found) == pytest.approx(4.0 * each, rel=0.3)
    assert found.worst.startswith("up stairs of 0.15 m at x ")


def test_a_turn_on_the_spot_counts_what_lies_under_its_wheels(envelope: Envelope) -> None:
    corner = np.array([(1.0, 2.0), (2.5, 2.0), (2.5, 3.5)])
    far = np.array([(1.0, 2.0), (1.6, 2.0), (1.6, 3.5)])
    astride, away = (drive(ground(kerb(0.10)), xy) for xy in (corner, far))
    assert astride.worst == "a turn of 90 deg over a 0.10 m face at x 2.5 y 2.0"
    radian = float(hazards(envelope, "spin", MAP_SIGMA, 0.10, 0.0, 1.0))
    assert hazard(astride) == pytest.approx(0.5 * math.pi * radian, rel=0.25)
    assert away.p_fail < 1e-3
    slope = drive(ground(lambda x, y: math.tan(math.radians(24.0)) * y), far)
    assert slope.worst.startswith("a turn of 90 deg on a slope of 24 deg")


def test_each_worst_thing_is_told_in_words() -> None:
    rng = np.random.default_rng(1)
    posts = (0.12 * rng.integers(0, 2, (34, 42))).repeat(3, 0).repeat(3, 1)[:100, :125]
    steep = drive(ground(lambda x, y: math.tan(math.radians(33.0)) * y))
    assert steep.worst.startswith("along a slope of 3")
    grid = ground(lambda x, y: posts)
    graph = TraversalGraph.build(
        grid, (1.0, 2.0), GraphParams(max_step=0.3, max_posts=0.2, controller="hybrid"), 0
    )
    found = chance(graph, grid, LINE, np.zeros(3, np.bool_))
    assert found is not None
    assert found.worst.startswith("among posts of 0.1")


def test_nothing_is_told_where_the_controller_or_the_map_is_not_known() -> None:
    grid = ground(kerb(0.1))
    known = TraversalGraph.build(grid, (1.0, 2.0), GraphParams(max_step=0.3), 0)
    for graph in (known, TraversalGraph.from_edges(known.nodes, known.edges, known.risk[: len(known.edges)])):
        assert chance(graph, grid, LINE, np.zeros(3, np.bool_)) is None


def test_the_whole_is_made_of_its_transitions_and_tells_the_worst_place() -> None:
    found = drive(ground(kerb(0.2, math.radians(50.0))))
    assert len(found.each) == 3
    assert found.p_fail == pytest.approx(1.0 - np.prod(1.0 - np.array(found.each)))
    assert found.p_fail > 0.005
    assert found.worst.startswith("up a 0.2")
    assert " at x 2." in found.worst


def test_the_chance_is_what_the_search_paid_for() -> None:
    """The prices of a route's moves and turns, `fall_cost` metres a hazard."""
    grid = ground(kerb(0.16, math.radians(20.0)))
    params = GraphParams(max_step=0.3, controller="hybrid", blind_radius=0.0)
    graph = TraversalGraph.build(grid, (1.0, 2.0), params, 0)
    found = with_chance(plan(graph, grid, PlanRequest((1.0, 2.0), (4.0, 2.0), 0.0), BodyModel()), graph, grid)
    paid = sum(t.price + t.turn_cost for t in found.transitions) / params.fall_cost
    assert paid > 1e-4
    assert -math.log1p(-found.p_fail) == pytest.approx(paid, rel=1e-4)


def test_a_slide_ends_a_drive_seldom_and_on_stairs_never(envelope: Envelope) -> None:
    """The tracker leads back who slid there, but who stands astride may fall in the next turn."""
    table = envelope.manoeuvres["up"]
    row = {
        name: (0.2, 0.0, 0.0, 9.0, *kinds, 0.0) for name, kinds in (("stuck", (0, 3, 0)), ("slid", (0, 0, 4)))
    }
    stuck, slid = (Table(per=table.per, axes=table.axes, cells=(row[name],)) for name in ("stuck", "slid"))
    assert ENDING == ("fell", "stuck", "touched")
    assert ending("up", stuck) == ending("stairs_up", stuck) == pytest.approx(3.5 / 4.0)
    assert ending("up", slid) == pytest.approx((4.0 * SLIDES_END + 0.5) / 5.0)
    assert ending("stairs_up", slid) == pytest.approx(0.5 / 5.0)
    here = Counted(physics="a", date="2026-01-01", commit="", manoeuvres={"up": stuck})
    there = here.model_copy(update={"manoeuvres": {"up": slid}})
    both = Envelope(robot="", controller="", elsewhere={"there": there}, **dict(here))
    share = partial(ending, "up")
    at = 0.2, 0.0, 0.0
    each = [share(m.manoeuvres["up"]) * float(m.mean("up", *at)) for m in (here, there)]
    assert float(both.mean("up", *at, share=share)) == pytest.approx(max(each)), "the worse model counts"
    assert max(each) < max(share(stuck), share(slid)) * float(both.mean("up", *at)), "no mix of both"
