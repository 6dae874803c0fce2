"""The planner as a process: map patches and requests in, plans out."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from hal.types import NS
from mapping.elevation.exchange import PATCH_LAYERS, MapPatch
from mapping.grid import ElevationGrid
from planning.graph import GraphParams
from planning.risk import BodyModel
from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.config import load
from rbtrg_robot.stages import map_graph
from rbtrg_robot.stages.map_graph import MapGraph
from rbtrg_robot.stages.planner import ASK_AGAIN, PlannerStage, build
from rbtrg_robot.wire.convert import patch_msg
from rbtrg_robot.wire.messages import header

RES = 0.04


def patch(
    height: np.ndarray,
    trusted: np.ndarray | None = None,
    cell: tuple[int, int] = (0, 0),
    stamp: int = NS,
    bound: float = np.nan,
) -> Any:
    """Map message; `cell` is the lattice row and column of cell [0, 0], `bound` [m] what rays tell of the cells that
    are not trusted."""
    layers = {name: np.zeros(height.shape, np.float32) for name in PATCH_LAYERS}
    layers["trusted"] = (np.ones(height.shape) if trusted is None else trusted).astype(np.float32)
    layers["elevation"] = np.where(layers["trusted"] > 0, height, np.nan).astype(np.float32)
    layers["upper_bound"][:] = np.where(layers["trusted"] > 0, np.nan, bound)
    return patch_msg(MapPatch((cell[1] * RES, cell[0] * RES), RES, stamp, 0, layers))


def ask(stage: PlannerStage, start: tuple[float, float], goal: tuple[float, float], **fields: Any) -> Any:
    """The plan message that answers."""
    stage.tick(fields.pop("now", 2 * NS))
    request = t.PLAN_REQUEST.kind(
        **({"goal_id": "g", "sequence": 1} | fields),
        start_x=start[0],
        start_y=start[1],
        goal_x=goal[0],
        goal_y=goal[1],
    )
    return dict(stage.on(t.PLAN_REQUEST, request))[t.PLAN]


def planner(*sets: str) -> PlannerStage:
    """With the limits of the model-based controller, which the grounds here are made for."""
    anywhere = [(-100.0, -100.0), (100.0, -100.0), (100.0, 100.0), (-100.0, 100.0)]
    return build(load(None, sets, scene="flat", controller="vmc", area=anywhere))


def passage(seed: int, width: float) -> tuple[np.ndarray, tuple[float, float], tuple[float, float]]:
    """Heights of a passage 2 m long at any angle, and a place before and behind it."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[0:125, 0:125] * RES
    angle, middle = rng.uniform(0, np.pi), 2.5 + rng.uniform(-0.2, 0.2, 2)
    u = (x - middle[0]) * np.cos(angle) + (y - middle[1]) * np.sin(angle)
    v = -(x - middle[0]) * np.sin(angle) + (y - middle[1]) * np.cos(angle)
    z = np.where((np.abs(u) < 1.0) & (np.abs(v) > 0.5 * width), 1.0, 0.0) + 0.005 * rng.standard_normal(
        x.shape
    )
    z[:3], z[-3:], z[:, :3], z[:, -3:] = 1.0, 1.0, 1.0, 1.0  # nothing left to explore
    ahead = 1.5 * np.array([np.cos(angle), np.sin(angle)])
    a, b = middle - ahead, middle + ahead
    return z, (float(a[0]), float(a[1])), (float(b[0]), float(b[1]))


def test_a_goal_inside_a_known_wall_is_in_an_obstacle_and_one_beside_it_is_not() -> None:
    y, x = np.mgrid[0:125, 0:125] * RES
    walls = (np.abs(x - 3.3) < 0.8) & (np.abs(y - 2.5) < 0.8) & (np.floor(x / 0.2) % 2 == 0)
    stage = planner()
    stage.on(
        t.MAP_UPDATE, patch(np.where(walls, 1.0, 0.005 * np.random.default_rng(0).standard_normal(x.shape)))
    )
    answer = ask(stage, (1.0, 2.5), (3.3, 2.5))
    assert (answer.ok, answer.reason) == (False, "goal_in_obstacle")
    beside = ask(stage, (1.0, 2.5), (1.8, 1.2), sequence=2)
    assert (beside.ok, beside.reaches_goal) == (True, True)


def test_before_any_map_a_request_is_answered_with_what_is_missing() -> None:
    stage = planner()
    answer = ask(stage, (0.0, 0.0), (1.0, 0.0))
    assert not answer.ok
    assert answer.reason == "start_not_on_graph"
    assert "no ground around the robot is known yet" in answer.detail
    assert t.MAP_REQUEST in dict(stage.tick(4 * NS)), "it asks for the map"


def tell(stage: PlannerStage, now: int) -> list[str]:
    """What it asks elevation for."""
    return [message.action for topic, message in stage.tick(now) if topic is t.MAP_REQUEST]


def parts(stamp: int = 1) -> list[msg.MapPart]:
    """The whole map, three tiles."""
    return [
        msg.MapPart(
            header=header(stamp, "map"), part=k, parts=3, map=patch(np.zeros((64, 64)), cell=(0, 64 * k))
        )
        for k in range(3)
    ]


def test_a_planner_that_lost_a_block_asks_for_the_whole_map_until_all_of_it_has_come() -> None:
    stage = planner()
    stage.on(t.MAP_UPDATE, patch(np.zeros((64, 64))))
    assert tell(stage, NS) == []
    for part in parts():  # somebody saves the map
        stage.on(t.MAP_PARTS, part)
    assert len(stage._map.mirror) == 1, "nothing was missing"
    stage.missed(t.MAP_UPDATE)
    assert tell(stage, 2 * NS) == ["parts"]
    first, _second, third = parts()
    stage.on(t.MAP_PARTS, first)
    stage.on(t.MAP_PARTS, third)
    assert tell(stage, 3 * NS) == [], "the rest is on its way"
    assert tell(stage, 3 * NS + ASK_AGAIN) == ["parts"]
    applied = len(stage._map._changed)
    for part in parts(stamp=2)[:2]:  # of the next sending another one is lost
        stage.on(t.MAP_PARTS, part)
    assert len(stage._map._changed) == applied + 1, "what has come is not looked at again"
    assert tell(stage, 10 * NS) == []
    assert len(stage._map.mirror) == 3


def test_what_is_lost_while_the_whole_map_comes_makes_it_come_again() -> None:
    stage = planner()
    assert tell(stage, NS) == ["parts"]
    first, second, third = parts()
    stage.on(t.MAP_PARTS, first)
    stage.missed(t.MAP_UPDATE)
    for part in (second, third):
        stage.on(t.MAP_PARTS, part)
    assert tell(stage, 10 * NS) == ["parts"]
    for part in parts(stamp=2):
        stage.on(t.MAP_PARTS, part)
    assert tell(stage, 20 * NS) == []


def test_much_new_ground_is_looked_at_before_a_goal_is_asked_for() -> None:
    stage, side = planner(), 660
    stage.tick(1 * NS)
    stage.on(t.MAP_UPDATE, patch(np.zeros((side, side))))
    stage.on(t.MAP_WINDOW, patch(np.zeros((75, 75)), cell=(300, 300)))
    stage.tick(1 * NS + NS // 10)
    assert stage._map.graph is None, "more of it may come"
    for k in range(3):
        stage.tick(2 * NS + k)
    graph, table = stage._map.graph, stage._map.table
    assert graph is not None
    assert table is not None
    assert table.evaluated()[0] == len(graph.indices)
    stage.on(t.MAP_UPDATE, patch(np.zeros((75, 75)), cell=(0, side), stamp=2 * NS))
    stage.tick(3 * NS)
    assert stage._map.stale, "a little more can wait"
    asked = ask(stage, (13.5, 13.5), (20.0, 20.0), now=3 * NS)
    assert (asked.ok, asked.reaches_goal) == (True, True)
    unprepared = planner()
    unprepared.on(t.MAP_UPDATE, patch(np.zeros((side, side))))
    unprepared.on(t.MAP_UPDATE, patch(np.zeros((75, 75)), cell=(0, side), stamp=2 * NS))
    same = ask(unprepared, (13.5, 13.5), (20.0, 20.0), now=3 * NS)
    assert np.array_equal(same.x, asked.x)


def test_another_map_is_prepared_too() -> None:
    stage, ground = planner(), np.zeros((660, 660))
    for epoch in (1, 2):
        stage.on(t.MAP_STATUS, t.MAP_STATUS.kind(epoch=epoch))
        stage.on(t.MAP_UPDATE, patch(ground, stamp=epoch * NS))
        stage.on(t.MAP_WINDOW, patch(np.zeros((75, 75)), cell=(300, 300)))
        assert stage._map.much_is_new
        for k in range(2):  # the graph, then its edges
            stage.tick(10 * epoch * NS + k)
        assert not stage._map.much_is_new
        assert stage._map.graph is not None


def test_a_map_that_comes_in_pieces_is_planned_on_as_far_as_it_goes() -> None:
    stage = planner()
    stage.on(t.MAP_UPDATE, patch(np.zeros((75, 75))))
    first = ask(stage, (1.5, 1.5), (5.0, 1.5))
    assert first.ok
    assert not first.reaches_goal
    assert first.x[-1] > 2.2, "to the frontier on the goal's side"
    stage.on(t.MAP_UPDATE, patch(np.zeros((75, 75)), cell=(0, 75)))
    second = ask(stage, (1.5, 1.5), (5.0, 1.5), sequence=2)
    assert second.ok
    assert second.reaches_goal
    assert math.dist((second.x[-1], second.y[-1]), (5.0, 1.5)) < 0.01


def test_a_route_that_the_map_contradicts_is_reported() -> None:
    stage = planner()
    stage.on(t.MAP_UPDATE, patch(np.zeros((75, 150))))
    assert ask(stage, (1.5, 1.5), (5.0, 1.5)).reaches_goal
    assert dict(stage.tick(3 * NS))[t.ROUTE_STATUS].valid
    wall = np.zeros((75, 10))
    wall[:, 4:6] = 1.0
    stage.on(t.MAP_UPDATE, patch(wall, cell=(0, 80)))
    status = dict(stage.tick(4 * NS))[t.ROUTE_STATUS]
    assert not status.valid
    assert "m face at (" in status.detail


def test_what_comes_into_the_way_is_seen_in_the_window_and_driven_around_before_the_map_has_it() -> None:
    stage = planner("planner.turning=0")  # the turns of the way around would be reason enough to leave it
    stage.on(t.MAP_UPDATE, patch(np.zeros((100, 150))))
    assert stage.on(t.MAP_WINDOW, patch(np.zeros((50, 50)), stamp=2 * NS)) == [], "nothing is driven yet"
    free = ask(stage, (1.5, 2.0), (5.0, 2.0))
    stage.tick(3 * NS)
    assert stage.on(t.MAP_WINDOW, patch(np.zeros((70, 80)), cell=(15, 10), stamp=3 * NS)) == []
    box = np.zeros((70, 80))
    box[25:45, 60:68] = 0.4  # x 2.8 to 3.1, y 1.6 to 2.4
    (topic, status), *others = stage.on(t.MAP_WINDOW, patch(box, cell=(15, 10), stamp=4 * NS))
    assert (topic, status.valid, others) == (t.ROUTE_STATUS, False, [])
    assert "m face at (2." in status.detail
    assert stage.on(t.MAP_WINDOW, patch(box, cell=(15, 10), stamp=5 * NS)) == [], "said once"

    around = ask(stage, (1.5, 2.0), (5.0, 2.0), sequence=2, now=5 * NS)
    assert around.reaches_goal
    near = np.abs(np.array(around.x) - 2.95) < 0.15
    assert np.abs(np.array(around.y)[near] - 2.0).min() > 0.4 + 0.2, "half the body beside the box"
    # The box has gone before the map's changes are sent: neither mirror nor graph keep it.
    stage.on(t.MAP_UPDATE, patch(np.zeros((10, 10)), stamp=6 * NS))
    stage.tick(7 * NS)
    kept = ask(stage, (1.5, 2.0), (5.0, 2.0), sequence=3, now=8 * NS)
    assert kept.length == around.length, "the way around stays while another is hardly shorter"
    again = ask(stage, (1.5, 2.0), (5.0, 2.0), goal_id="another", sequence=4, now=8 * NS)
    assert again.length == free.length


def test_a_malformed_window_is_survived() -> None:
    stage = planner()
    stage.on(t.MAP_UPDATE, patch(np.zeros((75, 150))))
    ask(stage, (1.5, 1.5), (5.0, 1.5))
    broken = patch(np.zeros((20, 20)), stamp=2 * NS)
    broken.info.length_x = 3.0
    assert stage.on(t.MAP_WINDOW, broken) == []
    assert dict(stage.tick(3 * NS))[t.ROUTE_STATUS].valid
    shifted = patch(np.indices((70, 80))[1] % 2 * 0.4, stamp=4 * NS)  # off the lattice, and full of faces
    shifted.info.pose.position.x += 0.3 * RES
    assert stage.on(t.MAP_WINDOW, shifted)
    assert ask(stage, (1.5, 1.5), (5.0, 1.5), sequence=2, now=5 * NS).reaches_goal


def test_what_the_navigator_wants_avoided_is_driven_around() -> None:
    stage = planner()
    stage.on(t.MAP_UPDATE, patch(np.zeros((100, 150))))
    avoid = np.array([3.0, 2.0, 0.5])
    answer = ask(stage, (1.5, 2.0), (4.5, 2.0), avoid=avoid)
    assert answer.ok
    assert np.hypot(np.array(answer.x) - 3.0, np.array(answer.y) - 2.0).min() > 0.4
    straight = ask(stage, (1.5, 2.0), (4.5, 2.0), goal_id="another", sequence=2)
    assert straight.length < answer.length


def test_a_place_to_avoid_in_which_the_robot_stands_does_not_hold_it() -> None:
    # A robot that got stuck three times beside a wall slid into a disc around one of these places, and found no way for
    # 5 s.
    stage = planner()
    stage.on(t.MAP_UPDATE, patch(np.zeros((100, 150))))
    avoid = np.array([1.6, 1.8, 0.3, 3.0, 2.0, 0.5])
    answer = ask(stage, (1.5, 2.0), (4.5, 2.0), avoid=avoid)
    assert answer.ok
    assert np.hypot(np.array(answer.x) - 3.0, np.array(answer.y) - 2.0).min() > 0.4, "the other one counts"


def test_a_passage_that_one_sample_misses_is_found_in_another_at_once() -> None:
    stages = found = elsewhere = 0
    for seed in range(40):
        z, start, goal = passage(seed, 0.52)
        stage = planner()
        stage.on(t.MAP_UPDATE, patch(z))
        ok = ask(stage, start, goal).reaches_goal
        stages += 1
        found += ok
        elsewhere += ok and stage._map.seed > 0
        if ok:
            assert ask(stage, start, goal, sequence=1).reaches_goal, "a graph that has a route is kept"
        if elsewhere and stages >= 10:
            break
    assert elsewhere > 0
    assert found >= 0.7 * stages


def test_a_sample_that_held_no_route_is_not_drawn_again_and_one_that_did_is_kept() -> None:
    z = np.zeros((75, 150))
    kept = MapGraph(GraphParams(), BodyModel(), 5)
    z[30:45, 60:75] = 1.0
    grid = ElevationGrid(z.astype(np.float32), np.ones_like(z, bool), (0.0, 0.0), RES)
    drawn = []
    for fails in (True, False, True, True):
        kept.refresh((1.5, 1.5), grid, [])
        assert kept.graph is not None
        drawn.append(np.array(kept.graph.nodes[:, :2]))
        if fails:
            kept.sample_anew((1.5, 1.5), (5.0, 1.5))
    assert np.array_equal(drawn[1], drawn[2]), "the one that held a route"
    assert not any(np.array_equal(drawn[a], drawn[b]) for a, b in ((0, 1), (0, 3), (1, 3)))


def test_on_a_large_map_other_nodes_are_drawn_at_once_around_the_robot_and_the_goal_alone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(map_graph, "WHOLE_CELLS", 10_000)
    monkeypatch.setattr(map_graph, "REDRAWN_AROUND", 0.7)
    found = 0
    for seed in range(12):
        z, start, goal = passage(seed, 0.5)
        stage = planner()
        stage.on(t.MAP_UPDATE, patch(z))
        stage._sync(start)
        first = stage._map.graph
        assert first is not None
        answer = ask(stage, start, goal)
        if answer.ok and not answer.reaches_goal:  # what blocks the way is judged from near
            start = float(answer.x[-1]), float(answer.y[-1])
            answer = ask(stage, start, goal, sequence=1)
        graph, drawn = stage._map.graph, stage._map.seed
        if drawn and answer.reaches_goal:
            assert graph is not None
            assert graph.cells is not None
            assert first.cells is not None
            here, before = graph.cells, first.cells
            away = np.hypot(*(here.where[:, :, None] - [start, goal]).T).T.min(axis=2) > 2.0
            assert away.sum() > 30
            assert np.array_equal(here.chosen[away], before.chosen[away])
            assert np.array_equal(here.where[away], before.where[away])
            assert ask(stage, start, goal, sequence=2).reaches_goal
            assert stage._map.graph is graph, "a sample that has a route is kept"
            found += 1
    assert found >= 2


def test_a_passage_of_054_is_found_at_once() -> None:
    found = 0
    for seed in range(12):
        z, start, goal = passage(seed, 0.54)
        stage = planner()
        stage.on(t.MAP_UPDATE, patch(z))
        found += ask(stage, start, goal).reaches_goal
    assert found >= 11


def test_no_limit_of_the_graph_is_looser_than_the_robots_own() -> None:
    loose = ["graph.max_step=0.3", "graph.max_slope=0.9", "graph.max_gap=0.5"]
    assert load(None, scene="flat").graph.max_step is None
    for flags, step, gap in (
        ({"scene": "flat"}, 0.20, 0.12),
        ({"scene": "flat", "controller": "vmc"}, 0.10, 0.10),
        ({"backend": "unitree"}, 0.15, 0.10),
    ):
        for config in (load(None, loose, **flags), load(None, **flags)):
            params = config.graph_params()
            assert (params.max_step, params.max_gap) == (step, gap)
            assert params.max_slope == config.capabilities().max_slope < 0.6
    assert load(None, ["graph.max_step=0.05"], scene="flat").graph_params().max_step == 0.05
    ground = np.zeros((75, 150))
    ground[:, 75:] = 0.15  # a kerb the graph was told to drive over, and this robot cannot
    stage = planner(*loose)
    stage.on(t.MAP_UPDATE, patch(ground))
    assert not ask(stage, (1.5, 1.5), (5.0, 1.5)).reaches_goal
    stage = build(load(None, ["graph.max_step=0.15"], scene="flat"))
    stage.on(t.MAP_UPDATE, patch(ground))
    assert ask(stage, (1.5, 1.5), (5.0, 1.5)).reaches_goal


@pytest.mark.campaign
def test_a_baseline_plans_in_the_planners_place_and_its_path_is_watched() -> None:
    stage = build(load(None, ["planner.method=tools.baselines.t_hybrid:plan"], scene="flat"))
    height = 0.006 * np.random.default_rng(0).standard_normal((100, 125))
    height[:60, 60:64] = 0.8
    stage.on(t.MAP_UPDATE, patch(height))
    answer = ask(stage, (1.0, 1.0), (4.0, 1.0))
    assert (answer.ok, answer.reaches_goal) == (True, True)
    assert len(answer.transition_risk) == 0, "no graph"
    assert answer.length > 4.0, "around the wall"
    (status,) = [m for topic, m in stage.tick(4 * NS) if topic is t.ROUTE_STATUS]
    assert (status.valid, status.detail) == (True, "")
    height[:, 45:49] = 0.8
    stage.on(t.MAP_UPDATE, patch(height, stamp=5 * NS))
    (status,) = [m for topic, m in stage.tick(6 * NS) if topic is t.ROUTE_STATUS]
    assert not status.valid
    assert "face" in status.detail
    refused = ask(stage, (1.0, 1.0), (4.0, 1.0), sequence=2, now=7 * NS)
    assert (refused.ok, refused.reason) == (False, "no_route")


def hidden(ground: np.ndarray, bound: np.ndarray) -> Any:
    """Map message of `ground` (cols,) [m] along x in a lane 1.2 m wide; NaN: not seen, but known to be below `bound`
    (cols,) [m]."""
    layers = {name: np.zeros((60, len(ground)), np.float32) for name in PATCH_LAYERS}
    layers["elevation"][:] = ground
    layers["elevation"][:15], layers["elevation"][45:] = 0.8, 0.8
    layers["trusted"][:] = np.isfinite(layers["elevation"])
    layers["upper_bound"][:] = np.where(np.isfinite(layers["elevation"]), layers["elevation"], bound)
    return patch_msg(MapPatch((0.0, 0.0), RES, NS, 0, layers))


def test_a_way_leads_over_ground_behind_a_crest_and_is_driven_as_far_as_it_was_seen() -> None:
    x = np.arange(150) * RES
    ridge = np.maximum(0.0, 0.16 - 0.27 * np.abs(x - 2.6))
    seen = np.where((x > 2.64) & (x < 3.6), np.nan, ridge)
    stage = planner()
    stage.on(t.MAP_UPDATE, hidden(seen, 0.16 - 0.12 * (x - 2.6)))
    answer = ask(stage, (1.2, 1.2), (5.0, 1.2))
    assert answer.ok
    assert not answer.reaches_goal, "not yet"
    front_wheels = answer.x[-1] + 0.21
    assert 2.4 < front_wheels < 2.64, "they stay on what was seen"
    assert answer.speed[-1] == 0.0
    stage.on(t.MAP_UPDATE, hidden(ridge, ridge))
    assert ask(stage, (float(answer.x[-1]), 1.2), (5.0, 1.2), sequence=2, now=4 * NS).reaches_goal


def test_where_nothing_leads_nearer_to_a_goal_that_is_far_there_is_no_route_and_another_graph_is_drawn() -> (
    None
):
    x = np.arange(150) * RES
    lane = np.where((x < 0.3) | (x > 5.6), 0.8, np.where(x > 3.0, 0.15, 0.0))
    stage = planner()
    stage.on(t.MAP_UPDATE, hidden(lane, lane))
    first = ask(stage, (1.2, 1.2), (5.0, 1.2))
    assert (first.ok, first.reaches_goal) == (True, False), (
        "what closes the way from afar may be the map's error"
    )
    seed, graph = stage._map.seed, stage._map.graph
    there = ask(stage, (float(first.x[-1]), float(first.y[-1])), (5.0, 1.2), sequence=2)
    assert (there.ok, there.reason) == (False, "no_route")
    assert "no way leads nearer" in there.detail
    assert stage._map.seed > seed
    assert stage._map.graph is graph is not None, "the rest of it is good"


def test_nothing_leads_over_a_pit_whose_rim_a_ray_passed_under() -> None:
    x = np.arange(150) * RES
    pit = (x > 2.6) & (x < 3.6)
    for slope in (0.6, 1.0, 3.0):  # of the rays that fell into it: from near they are steep
        stage = planner()
        stage.on(t.MAP_UPDATE, hidden(np.where(pit, np.nan, 0.0), -slope * (x - 2.6)))
        answer = ask(stage, (1.2, 1.2), (5.0, 1.2))
        assert not (answer.ok and answer.reaches_goal)
        assert not answer.ok or answer.x[-1] + 0.21 < 2.6


def test_a_way_that_only_leads_over_unseen_ground_at_the_feet_is_none() -> None:
    x = np.arange(150) * RES
    stage = planner()
    ground = np.where(x < 0.7, 0.8, 0.0)
    stage.on(t.MAP_UPDATE, hidden(np.where((x > 1.45) & (x < 2.2), np.nan, ground), np.full(150, 0.05)))
    answer = ask(stage, (1.2, 1.2), (5.0, 1.2))
    assert (answer.ok, answer.reason) == (False, "no_route")
    assert "cannot see" in answer.detail
    # With another way around, that one is taken, and kept to while the first stays hidden.
    seen = np.ones((150, 150))
    seen[20:60, 38:55] = 0.0  # x 1.5 to 2.2, y 0.8 to 2.4
    layers = {name: np.zeros(seen.shape, np.float32) for name in PATCH_LAYERS} | {
        "trusted": seen.astype(np.float32)
    }
    layers["elevation"][seen == 0.0] = np.nan
    layers["upper_bound"][:] = 0.05
    stage = planner()
    stage.on(t.MAP_UPDATE, patch_msg(MapPatch((0.0, 0.0), RES, NS, 0, layers)))
    for sequence, y in ((1, 1.2), (2, 1.3)):
        around = ask(stage, (1.26, y), (3.5, 1.2), sequence=sequence)
        assert around.ok
        assert around.length > 0.5
        assert np.abs(np.array(around.y) - 1.6).max() > 0.8


def test_where_no_frontier_is_left_the_robot_looks_at_what_is_hidden() -> None:
    x = np.arange(150) * RES
    lane = np.where((x < 0.3) | (x > 4.4), 0.8, 0.0)
    stage = planner()
    stage.on(t.MAP_UPDATE, hidden(np.where((x > 2.6) & (x < 4.4), np.nan, lane), np.full(150, 0.05)))
    answer = ask(stage, (1.2, 1.2), (8.0, 1.2))
    assert (answer.ok, answer.reaches_goal) == (True, False)
    assert 2.0 < answer.x[-1] + 0.21 < 2.6
    stage.on(t.MAP_UPDATE, hidden(lane, lane))
    assert not ask(stage, (1.2, 1.2), (8.0, 1.2), sequence=2, now=4 * NS).ok


def test_a_way_that_is_too_likely_to_fail_is_refused_unless_it_is_accepted() -> None:
    """A kerb that the controller climbs askew: its place and chance stand in the refusal."""
    y, x = np.mgrid[0:100, 0:150] * RES
    height = 0.11 * (x - 3.0 + (y - 2.0) > 0.0)
    stage = planner("planner.accept_risk=0.0")
    stage.on(t.MAP_UPDATE, patch(height))
    refused = ask(stage, (1.0, 2.0), (5.0, 2.0), start_yaw=0.0)
    assert (refused.ok, refused.reason) == (False, "too_risky")
    assert 0.0 < refused.p_fail < 0.2
    assert refused.worst
    assert refused.worst in refused.detail
    assert "--accept" in refused.detail
    accepted = ask(stage, (1.0, 2.0), (5.0, 2.0), start_yaw=0.0, accept_risk=True)
    assert accepted.ok
    assert accepted.p_fail == pytest.approx(refused.p_fail)
    usual = planner()
    usual.on(t.MAP_UPDATE, patch(height))
    assert ask(usual, (1.0, 2.0), (5.0, 2.0), start_yaw=0.0).ok
