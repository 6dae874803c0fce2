"""Turns in place only where there is room: routes swept by the footprint, and the rules at start and goal."""

from __future__ import annotations

import math
from itertools import pairwise, product

import numpy as np
import pytest
from scipy import ndimage

from hal.rotation import wrap
from hal.safety.swept import FLAT, Surroundings, reach_of, turn_step, turn_tracks
from hal.types import Capabilities
from mapping.grid import ElevationGrid
from planning.errors import NoRoute
from planning.graph.describe import ALL_HEADINGS, LONE_FACES, WHEEL_RING, turn_ground
from planning.graph.faces import FACE_NOISE, update_faces
from planning.graph.graph import GraphParams, TraversalGraph
from planning.path import make_path
from planning.risk.body import BodyModel, sweep_poses
from planning.risk.table import RiskTable
from planning.risk.turns import BEND_ANGLE, STRAIGHT_ANGLE, may_turn_to, turn_cost
from planning.search.guarded import TURN_SPARE
from planning.search.plan import DriveRules, Plan, PlanRequest, Variant, plan
from tests.hal.safety.ground import BODY as RECTANGLE
from tests.planning.graph.scenes import LENGTH, WIDTH, Scene, random_scene

BODY = BodyModel()
AXLE = GraphParams().axle
SHRINK = 0.03
"""Half a heading step of 5 deg moves a corner 0.018 m, and a face lies up to half a cell from where its cells are [m].
"""


def straddles(scene: Scene, pose: np.ndarray, step: float) -> bool:
    """True if the footprint, a little smaller, covers both sides of a break higher than `step`."""
    res = scene.grid.resolution
    r0, c0 = (max(0, int((v - 0.45) / res)) for v in (pose[1], pose[0]))
    window = np.s_[r0 : r0 + int(0.9 / res) + 2, c0 : c0 + int(0.9 / res) + 2]
    z, label = scene.grid.height[window], scene.label[window]
    y, x = np.mgrid[0 : z.shape[0], 0 : z.shape[1]]
    dx, dy = (x + c0) * res - pose[0], (y + r0) * res - pose[1]
    c, s = np.cos(pose[2]), np.sin(pose[2])
    under = (np.abs(dx * c + dy * s) <= 0.5 * LENGTH - SHRINK) & (
        np.abs(dy * c - dx * s) <= 0.5 * WIDTH - SHRINK
    )
    face_c = (label[:, 1:] != label[:, :-1]) & (np.abs(np.diff(z, axis=1)) > step)
    face_r = (label[1:] != label[:-1]) & (np.abs(np.diff(z, axis=0)) > step)
    return bool((face_c & under[:, 1:] & under[:, :-1]).any() or (face_r & under[1:] & under[:-1]).any())


def turns_of(found: Plan) -> list[np.ndarray]:
    """Poses of the turns at the inner points of a route."""
    xy = found.points[:, :2]
    yaw = [float(np.arctan2(*(b - a)[::-1])) for a, b in pairwise(xy)]
    return [sweep_poses(*xy[k + 1], yaw[k], yaw[k + 1], BODY) for k in range(len(yaw) - 1)]


def bad_turns(
    scene: Scene, graph: TraversalGraph, table: RiskTable, variant: Variant, pairs: int
) -> tuple[int, int]:
    """Turns of routes between tight nodes, and how many of them sweep over a break."""
    rng = np.random.default_rng(9)
    tight = np.flatnonzero(graph.free_headings != ALL_HEADINGS)
    turns = bad = 0
    for a, b in rng.choice(tight, (pairs, 2)).tolist():
        try:
            found = plan(graph, scene.grid, PlanRequest(a, b, variant=variant), table.body, table)
        except NoRoute:
            continue
        for poses in turns_of(found):
            turns += 1
            bad += any(straddles(scene, pose, GraphParams().max_step + 0.02) for pose in poses)
    return turns, bad


def test_on_random_ground_no_turn_of_a_route_sweeps_a_wall_a_ledge_or_a_pit() -> None:
    careless = BodyModel(weight_body=0.0, weight_unknown=0.0)  # whose costs do not keep it from anything
    for seed in range(3):
        scene = random_scene(seed)
        graph = TraversalGraph.build(scene.grid, scene.start, GraphParams(), seed)
        for body, variant, pairs in ((BODY, "full", 4), (careless, "full", 20)):
            turns, bad = bad_turns(scene, graph, RiskTable(graph, scene.grid, body), variant, pairs)  # type: ignore[arg-type]
            assert turns > 3 * pairs
            assert bad == 0


def ground(height: np.ndarray, res: float = 0.025) -> tuple[ElevationGrid, TraversalGraph]:
    """The graph of seen ground around (1.5, 1.5)."""
    noisy = height + 0.003 * np.random.default_rng(0).standard_normal(height.shape)
    grid = ElevationGrid(noisy.astype(np.float32), np.ones(height.shape, bool), (0.0, 0.0), res)
    return grid, TraversalGraph.build(grid, (1.5, 1.5), GraphParams(controller="vmc", blind_radius=0.0), 0)


def edges_of(grid: ElevationGrid, graph: TraversalGraph) -> tuple[np.ndarray, np.ndarray]:
    """(n,) highest edge under the wheels [m] and slope [m/m] at each node."""
    assert graph.cells is not None
    ground = grid.height, grid.trusted, graph.cells.faces, *grid.origin, grid.resolution
    told = [turn_ground(*ground, x, y, AXLE, graph.params.climbed) for x, y, _ in graph.nodes.tolist()]
    return np.array(told).T[0], np.array(told).T[1]


def test_an_edge_under_the_wheels_is_told_from_a_ramp() -> None:
    y, x = np.mgrid[0:120, 0:200] * 0.025
    for height, least, most in (
        (0.0 * x, 0.0, 0.02),
        (np.tan(np.radians(20)) * x, 0.0, 0.02),
        (0.05 * (np.abs((x - 2.0) * 0.8 + (y - 1.5) * 0.6) < 0.05), 0.03, 0.07),
        (0.05 * (np.abs(x - 1.9) < 0.6), 0.03, 0.07),
    ):
        grid, graph = ground(height)
        edge, _ = edges_of(grid, graph)
        if most < 0.03:
            assert edge.max() < most
            assert edge.min() >= least
        else:
            # where the break runs: the bar's middle, the plate's two ends
            broken = height[np.round(graph.nodes[:, 1] / 0.025).astype(int), :]
            faces = np.abs(np.diff(broken, axis=1)) > 0.02
            near = np.abs(np.arange(1, 200) * 0.025 - graph.nodes[:, :1])
            away = np.where(faces, near, np.inf).min(axis=1)
            assert edge[away < 0.15].min() > least
            assert edge.max() < most
            assert edge[away > 0.75].max() < 0.02
            assert graph.turn_price[away < 0.15, 1].min() > 0.2 > graph.turn_price[away > 0.75, 1].max()


def test_on_a_crest_between_two_ramps_and_on_rough_ground_a_turn_is_not_free() -> None:
    rng = np.random.default_rng(1)
    _, x = np.mgrid[0:75, 0:125] * 0.04
    crest = np.tan(np.radians(24)) * -np.abs(x - 2.5)
    rough = 0.04 * rng.standard_normal((25, 42)).repeat(3, 0).repeat(3, 1)[:75, :125]
    for height, reach in ((crest, 0.2), (rough, 2.0)):
        noisy = (height + 0.003 * rng.standard_normal(x.shape)).astype(np.float32)
        for along in np.linspace(-reach, reach, 9):
            edge, slope = turned_on(noisy, 0.04, 2.5 + along, 1.5, GraphParams().climbed)
            assert edge > FACE_NOISE or slope > math.tan(math.radians(12))


def turned_on(
    height: np.ndarray, res: float, x: float, y: float, climbed: float, axle: float = AXLE
) -> tuple[float, float]:
    """`turn_ground` of seen ground whose cell [0, 0] is at 0, 0."""
    seen, faces = np.ones(height.shape, bool), np.zeros((*height.shape, 2), np.int16)
    update_faces(faces, height, seen, res, 0, 0, *height.shape)
    found: tuple[float, float] = turn_ground(height, seen, faces, 0.0, 0.0, res, x, y, axle, climbed)
    return found


def test_the_wheels_of_a_short_robot_do_not_meet_what_a_long_one_turns_over() -> None:
    _, x = np.mgrid[0:40, 0:40]
    kerb = np.where((x - 20) * 0.04 > 0.34, 0.1, 0.0).astype(np.float32)
    long, _ = turned_on(kerb, 0.04, 0.8, 0.8, 0.15)
    short, _ = turned_on(kerb, 0.04, 0.8, 0.8, 0.15, axle=0.131)
    assert long == pytest.approx(0.1)
    assert short == 0.0


def test_what_a_turn_meets_is_the_highest_face_of_its_ring_and_the_mean_slope_of_four_quarters() -> None:
    rng, res, climbed, n = np.random.default_rng(4), 0.04, 0.15, 2
    y, x = np.mgrid[0:40, 0:40]
    d = np.hypot(y - 20, x - 20) * res
    ring = (d >= AXLE + WHEEL_RING[0]) & (d <= AXLE + WHEEL_RING[1])
    some = 0
    for _ in range(20):
        a, b = rng.uniform(0.02, 0.3), rng.uniform(-np.pi, np.pi)
        face = a * ((x - 20) * np.cos(b) + (y - 20) * np.sin(b) > rng.uniform(-6, 6))
        z = (face + 0.01 * x * rng.uniform(-1, 1) + 0.004 * rng.standard_normal(x.shape)).astype(np.float32)
        faces = np.zeros((40, 40, 2), np.int16)
        update_faces(faces, z, np.ones(z.shape, bool), res, 0, 0, 40, 40)
        size = np.abs(faces).max(axis=2)
        wall = ndimage.maximum_filter(size, 2 * n + 1) > 1000 * climbed
        counted = np.sort(size[ring & ~wall & (size >= 1000 * FACE_NOISE)])[::-1]
        lone = round(LONE_FACES / res**2)
        edge = 0.001 * counted[lone] if len(counted) > lone else 0.0
        even, slopes = ring & (size < 1000 * FACE_NOISE), []
        for quarter in (
            (y > 20) & (x > 20),
            (y > 20) & (x <= 20),
            (y <= 20) & (x > 20),
            (y <= 20) & (x <= 20),
        ):
            at = even & quarter
            rise = [(np.roll(z, -n, axis) - np.roll(z, n, axis))[at].mean() for axis in (1, 0)]
            slopes.append(np.hypot(*rise) / (2 * n * res))
        found = turned_on(z, res, 20 * res, 20 * res, climbed)
        np.testing.assert_allclose(found, (edge, np.nanmean(slopes)), rtol=1e-4, atol=1e-6)
        some += edge > 0.0
    assert 3 < some < 20


@pytest.mark.parametrize("res", [0.025, 0.04, 0.05])
def test_a_wall_beside_a_kerb_does_not_hide_it_and_is_no_edge(res: float) -> None:
    p = GraphParams(max_step=0.2)
    rng = np.random.default_rng(0)
    y, x = np.mgrid[0 : round(3.0 / res), 0 : round(4.0 / res)] * res
    for wall, kerb in product((0.0, 0.5), (0.0, 0.12, 0.19)):
        for thick in (0.06, 1.0):
            for at in np.arange(1.78, 1.99, 0.01):  # the wall's face anywhere between cells
                height = np.where((y > at) & (y < at + thick), wall, kerb * (x > 2.0 + 0.4 * (y - 1.5)))
                noisy = (height + 0.003 * rng.standard_normal(x.shape)).astype(np.float32)
                edge, _ = turned_on(noisy, res, 2.1, 1.5, p.climbed)
                if kerb > 0.0:
                    assert edge == pytest.approx(kerb, abs=0.03), "0.5 while the highest edge counted"
                else:
                    assert edge < 0.02


@pytest.mark.parametrize("towards", [(1.0, 0.0), (0.7, -0.7)])
def test_turns_cost_more_the_steeper_the_ground(towards: tuple[float, float]) -> None:
    y, x = np.mgrid[0:120, 0:200] * 0.025
    means = []
    for degrees in (0, 8, 16, 24):
        tilted = np.tan(np.radians(degrees)) * (x * towards[0] + y * towards[1]) / np.hypot(*towards)
        grid, graph = ground(tilted)
        assert len(graph.nodes) > 50
        _, slope = edges_of(grid, graph)
        np.testing.assert_allclose(np.degrees(np.arctan(slope)), degrees, atol=1.5)
        means.append(graph.turn_price.mean(axis=0))
    assert (means[0] == 0.0).all()
    assert (np.diff(means, axis=0) > 0.0).all()
    assert means[-1][1] > 5.0, "a turn on the spot at 24 deg"


def test_a_robot_drives_off_a_bar_before_it_turns_round() -> None:
    _, x = np.mgrid[0:120, 0:240] * 0.025
    bar = 0.06 * (np.abs(x - 3.0) < 0.05)
    results = []
    for height in (bar, 0.0 * bar):
        grid, graph = ground(height)
        found = plan(graph, grid, PlanRequest((3.0, 1.5), (1.0, 1.5), start_yaw=0.0), BODY)
        results.append((found, graph))
    grid, _ = ground(bar)
    (off, graph), (level, _) = results
    assert sum(t.turn_cost for t in off.transitions) < 0.1
    yaw = [0.0, *(float(np.arctan2(*(b - a)[::-1])) for a, b in pairwise(off.points[:, :2]))]
    sharp = [
        k for k, (a, b) in enumerate(pairwise(yaw)) if abs(np.angle(np.exp(1j * (b - a)))) > np.radians(31)
    ]
    assert sharp
    assert sharp[0] > 0, "it drives off the bar first"
    assert all(graph.turn_price[off.nodes[k]].max() == 0.0 for k in sharp)
    assert sum(t.turn_cost for t in level.transitions) == 0.0
    assert level.length < off.length
    path = make_path(off, grid, BODY)
    assert path.initial_turn is not None
    assert abs(path.initial_turn) < 0.7, "less than what the tracker stops for"


def corridor(width: float) -> tuple[ElevationGrid, TraversalGraph]:
    """A straight passage along x between walls."""
    y = np.arange(0.0, 3.0, 0.025)
    height = np.tile(np.where(np.abs(y - 1.5) > 0.5 * width, 1.0, 0.0)[:, None], (1, 240)).astype(np.float32)
    grid = ElevationGrid(height, np.ones_like(height, bool), (0.0, 0.0), 0.025)
    return grid, TraversalGraph.build(grid, (1.5, 1.5), GraphParams(), 0)


def test_in_a_narrow_passage_the_robot_drives_on_but_does_not_turn_round() -> None:
    grid, graph = corridor(0.70)
    ends = [graph.nearest_node((x, 1.5)) for x in (1.0, 3.0, 5.0)]
    assert None not in ends
    left, middle, right = (int(v) for v in ends if v is not None)
    assert plan(graph, grid, PlanRequest(middle, right, 0.0), BODY).length == pytest.approx(2.0, abs=0.3)
    assert plan(graph, grid, PlanRequest(middle, left, np.pi), BODY).length == pytest.approx(2.0, abs=0.3)
    for request in (PlanRequest(middle, left, 0.0), PlanRequest(middle, right, 0.0, np.pi / 2)):
        with pytest.raises(NoRoute, match="turns"):
            plan(graph, grid, request, BODY)
        free = RiskTable(graph, grid, BODY)
        free.arcs = free.arcs._replace(room=np.full(len(graph.nodes), ALL_HEADINGS))
        assert plan(graph, grid, request, BODY, free).length < 2.6, "it is the turn that forbids it"
    wide_grid, wide = corridor(1.4)
    a, b = wide.nearest_node((3.0, 1.5)), wide.nearest_node((1.0, 1.5))
    assert plan(wide, wide_grid, PlanRequest(a, b, 0.0, 0.0), BODY).length < 2.6  # type: ignore[arg-type]


def held(grid: ElevationGrid, graph: TraversalGraph, found: Plan) -> int:
    """Turns on the spot of a route that the guard's kernel holds on the map, for a body a little larger."""
    around = Surroundings(
        np.where(grid.trusted, grid.height, np.float32(np.nan)),
        np.full_like(grid.height, np.nan),
        np.zeros(grid.shape, np.uint8),
        np.zeros(grid.shape, np.uint8),
        np.zeros(grid.shape, np.float32),
        grid.origin,
        grid.resolution,
    )
    robot = Capabilities("", max_step=graph.params.max_step, max_slope=graph.params.max_slope)
    count = 0
    for poses in turns_of(found):
        turn = float(poses[-1, 2] - poses[0, 2])
        if abs(turn) > BEND_ANGLE:
            tracks = turn_tracks(abs(turn), np.sign(turn), RECTANGLE, spare=TURN_SPARE)
            place = (float(poses[0, 0]), float(poses[0, 1]), float(poses[0, 2]))
            count += reach_of(tracks, turn_step(RECTANGLE), around, place, FLAT, robot, seen=False).kind > 0
    return count


def test_what_the_planner_calls_room_to_turn_the_guard_does_not_hold() -> None:
    rng = np.random.default_rng(3)
    counts = np.zeros(2, int)
    for seed in range(4):
        scene = random_scene(seed)
        graph = TraversalGraph.build(scene.grid, scene.start, GraphParams(), seed)
        places = graph.nodes[np.flatnonzero(graph.free_headings != ALL_HEADINGS), :2]
        table = RiskTable(graph, scene.grid, BODY)
        for a, b in rng.choice(len(places), (12, 2)).tolist():
            pair = tuple(places[a].tolist()), tuple(places[b].tolist())
            for k, guarded in enumerate((False, True)):
                rules = DriveRules(straight=True, guarded=guarded)
                try:
                    found = plan(graph, scene.grid, PlanRequest(*pair, rules=rules), BODY, table)
                except NoRoute:
                    continue
                counts[k] += held(scene.grid, graph, found)
    assert counts[0] > 5, "the two rules differ"
    assert counts[1] < 0.2 * counts[0], "some have no other way"


@pytest.mark.parametrize("room", [3.0, 0.90])
def test_it_turns_where_the_guard_lets_it_and_if_there_is_no_such_place_where_it_can(room: float) -> None:
    y, x = np.mgrid[0:120, 0:240] * 0.025
    half = np.where(x < 3.2, 0.45, 0.5 * room)
    height = np.where((np.abs(y - 1.5) > half) | (x < 0.3) | (x > 5.5), 1.0, 0.0).astype(np.float32)
    grid = ElevationGrid(height, np.ones_like(height, bool), (0.0, 0.0), 0.025)
    graph = TraversalGraph.build(grid, (2.0, 1.5), GraphParams(blind_radius=0.0), 0)
    for guarded in (False, True):
        rules = DriveRules(backward=1.2 if room > 1.0 else np.inf, guarded=guarded)
        found = plan(graph, grid, PlanRequest((4.5, 1.5), (1.2, 1.5), np.pi, 0.0, rules=rules), BODY)
        assert found.transitions[-1].backward is (guarded and room > 1.0), "it turned before the passage"


def test_a_turn_at_the_goal_ends_beside_no_blocked_heading() -> None:
    room = np.uint64(ALL_HEADINGS)
    for k in (9, 10, 11):  # 45, 50 and 55 deg
        room &= ~(np.uint64(1) << np.uint64(k))
    deg = np.radians
    assert may_turn_to(room, deg(0), deg(35))
    assert not may_turn_to(room, deg(0), deg(43)), "the heading next to the end is blocked"
    assert not may_turn_to(room, deg(0), deg(50))
    assert may_turn_to(room, deg(50), 0.0)
    assert may_turn_to(room, deg(90), deg(-25))
    assert not may_turn_to(room, deg(90), deg(-33))


def test_bends_and_turns_on_the_spot_have_their_own_prices() -> None:
    for turn in (0.01, 0.1, 0.2, -0.4, -0.5, 0.6, -3.0):
        size = abs(turn)
        wanted = 13.0 * max(size - STRAIGHT_ANGLE, 0.0) if size <= BEND_ANGLE else 20.0 * size
        assert turn_cost(13.0, 20.0, turn, 0.3) == pytest.approx(0.3 * size + wanted)


@pytest.mark.parametrize("seed", [1, 3])
def test_a_robot_askew_before_a_kerb_that_goes_down_turns_away_from_it(seed: int) -> None:
    _, x = np.mgrid[0:200, 0:200] * 0.025
    height = np.where(x < 2.5, 0.19, 0.0).astype(np.float32)
    grid = ElevationGrid(height, np.ones(x.shape, bool), (0.0, 0.0), 0.025)
    graph = TraversalGraph.build(
        grid, (1.0, 2.5), GraphParams(max_step=0.2, controller="hybrid", blind_radius=0.0), seed
    )
    yaw, rules = np.radians(-80), DriveRules(backward=1.3, turning=0.3, straight=True)
    found = plan(graph, grid, PlanRequest((2.32, 2.0), (4.0, 2.0), yaw, rules=rules), BODY)
    course = np.arctan2(*np.diff(found.points[:, :2], axis=0).T[::-1])
    heading = course + np.pi * np.array([t.backward for t in found.transitions])
    turn = np.abs(wrap(np.diff(np.append(yaw, heading))))
    beside = np.abs(found.points[:-1, 0] - 2.5) < 0.3
    assert turn[beside].max() <= np.radians(15), (
        "26 and 28 deg while such a turn cost as much as one on a bar"
    )
    assert turn[~beside].sum() > np.radians(60)


def test_a_robot_turns_round_before_a_ramp_and_not_on_it() -> None:
    _, x = np.mgrid[0:120, 0:240] * 0.025
    rise = np.tan(np.radians(27)) * np.clip(x - 2.2, 0.0, 2.4)
    noisy = rise + 0.003 * np.random.default_rng(0).standard_normal(x.shape)
    grid = ElevationGrid(noisy.astype(np.float32), np.ones(x.shape, bool), (0.0, 0.0), 0.025)
    graph = TraversalGraph.build(
        grid, (0.8, 1.5), GraphParams(max_slope=0.53, controller="hybrid", blind_radius=0.0), 0
    )
    rules = DriveRules(backward=1.3, turning=0.3)
    # up on the ramp it has to look back down
    found = plan(graph, grid, PlanRequest((0.8, 1.5), (3.4, 1.5), 0.0, np.pi, rules=rules))
    up = [t.backward for k, t in enumerate(found.transitions) if found.points[k + 1, 0] > 2.0]
    assert len(up) > 2
    assert all(up)


@pytest.mark.parametrize(("controller", "backward"), [(None, True), ("hybrid", False)])
def test_faces_that_are_climbed_forward_only_are_turned_to(controller: str | None, backward: bool) -> None:
    _, x = np.mgrid[0:120, 0:240] * 0.025
    bar = 0.15 * (np.abs(x - 2.6) < 0.06)
    noisy = bar + 0.003 * np.random.default_rng(0).standard_normal(x.shape)
    grid = ElevationGrid(noisy.astype(np.float32), np.ones(x.shape, bool), (0.0, 0.0), 0.025)
    params = GraphParams(max_step=0.20, controller=controller, blind_radius=0.0)
    graph = TraversalGraph.build(grid, (4.0, 1.5), params, 0)
    rules = DriveRules(backward=1.1, turning=1.0, straight=True)
    found = plan(graph, grid, PlanRequest((4.0, 1.5), (1.2, 1.5), 0.0, rules=rules))
    over = [t.backward for k, t in enumerate(found.transitions) if 2.1 < found.points[k, 0] < 3.1]
    assert over
    assert all(over) == any(over) == backward
