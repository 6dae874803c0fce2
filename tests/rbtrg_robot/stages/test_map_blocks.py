"""Maps that are too large for one message: sent block by block, saved, and given back after a restart."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from mapping.elevation.exchange import PATCH_LAYERS, MapPatch
from mapping.elevation.map import AT_A_TIME, ElevationMap
from mapping.elevation.mirror import MapMirror
from planning.risk.body import BodyModel
from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.areas import ground_area, plain
from rbtrg_robot.config import load
from rbtrg_robot.orders.map import FetchMap, read, save
from rbtrg_robot.stages import planner
from rbtrg_robot.stages.handover import RESTORE_PATIENCE
from rbtrg_robot.stages.map_graph import MapGraph
from rbtrg_robot.wire.convert import map_patch, patch_msg
from tests.rbtrg_robot.stages.test_elevation import Fed

PLACES = (0.0, 150.0, 300.0)
"""x of three known squares [m]: 300 m by 4 m fit one message, 300 m by 300 m do not."""


def squares() -> list[MapPatch]:
    height = np.full((100, 100), 0.02, np.float32)
    one = np.ones_like(height)
    layers = dict.fromkeys(PATCH_LAYERS, one) | {
        "elevation": height,
        "source": 2.0 * one,
        "variance": 1e-4 * one,
    }
    return [MapPatch((x, x), 0.04, 7, 0, layers) for x in PLACES]


def test_a_large_map_comes_in_parts_is_saved_and_sent_again(tmp_path: Path) -> None:
    fed = Fed()
    for patch in squares():
        fed.stage.map.restore(patch)
    fed.sweep(2.0, 2.0)  # amid the first square: the ground under the wheels makes no block of its own
    pond = ground_area("pond", [(1.0, 1.0), (2.0, 1.0), (2.0, 2.0)], keep_out=True)
    line = ground_area("line", [(1.0, 1.0), (2.0, 2.0), (3.0, 3.0)], keep_out=True)
    for areas, refused in (([pond], ""), ([pond, line], "the geofence has no area")):
        ((_, told),) = fed.stage.on(t.AREAS_REQUEST, msg.Areas(id="drawn", areas=areas))
        assert (told.id, told.refused, plain(told.areas)) == ("drawn", refused, plain([pond]))
    order = FetchMap()
    outputs = fed.stage.on(t.MAP_REQUEST, msg.MapRequest(action="parts"))
    assert [topic for topic, _ in outputs] == [t.AREAS, t.MAP_CLOUD, t.MAP_PARTS]
    ticks = 0
    while order.outcome is None and ticks < 100:
        for topic, message in outputs:
            order.take(topic, message)
        ticks += 1
        outputs = [x for x in fed.stage.tick(fed.now + ticks) if x[0] in order.hears]
        assert len(outputs) <= 1
    assert order.outcome is not None
    assert order.outcome.ok
    assert len(order.patches) == ticks > 3
    known = save(order.patches, order.cloud, tmp_path / "map.npz", None, order.areas)
    assert known == sum(int(np.isin(patch.layers["source"], (1, 2)).sum()) for patch in order.patches)
    assert known >= len(PLACES) * 100 * 100
    prior = read(tmp_path / "map.npz", fed.stage.map.params)
    assert len(prior.map) == len(PLACES)
    assert plain(prior.areas) == plain([pond])
    other = ElevationMap()
    assert other.begin_on([map_patch(block, 0) for block in prior.map], order.cloud) == known
    assert other.window(301.0, 301.0, 0.5).layers["trusted"].all()


def full(stage: Any, now: int) -> list[MapPatch]:
    outputs = stage.on(t.MAP_REQUEST, msg.MapRequest(action="full"))
    for k in range(20):
        outputs += stage.tick(now + k)
    return [map_patch(message, 0) for topic, message in outputs if topic is t.MAP_FULL]


def test_viewers_get_all_blocks_of_a_large_map() -> None:
    fed = Fed()
    for patch in squares():
        fed.stage.map.restore(patch)
    fed.sweep(0.0, 0.0)
    mirror = MapMirror()
    for patch in full(fed.stage, fed.now):
        assert {"filled", "age"} <= patch.layers.keys()
        mirror.apply(patch)
    for x in PLACES:
        assert mirror.grid(mirror.view((x + 1.0, x + 1.0))).trusted.sum() >= 100 * 100


def test_a_large_prior_map_is_told_over_several_scans_and_comes_whole() -> None:
    """100 x 100 m at once, 125 MB, came in half to planner and recorder."""
    fed, mirror, side = Fed(), MapMirror(), 600
    one = np.ones((side, side), np.float32)
    layers = dict.fromkeys(PATCH_LAYERS, one) | {
        "elevation": 0.02 * one,
        "source": 2.0 * one,
        "variance": 1e-4 * one,
    }
    prior = [MapPatch((x, 100.0), 0.04, 7, 0, layers) for x in (100.0, 200.0, 300.0)]
    known = fed.stage.map.begin_on(prior, np.zeros((1, 3), np.float32))
    told = []
    for _ in range(6):
        told.append(0)
        for topic, message in fed.sweep(0.0, 0.0):
            if topic is t.MAP_UPDATE:
                mirror.apply(map_patch(message, 0))
                told[-1] += message.data[0].data.size
    assert sum(n > 0 for n in told) >= 3
    assert max(told) < AT_A_TIME + 2 * side * side
    for x in (100.0, 200.0, 300.0):
        assert mirror.grid(mirror.view((x + 12.0, 112.0))).trusted.sum() >= known / 3


def test_a_restarted_elevation_process_gets_all_parts_back() -> None:
    config = load(None, [], scene="flat")
    giver, fed = planner.build(config), Fed()
    for patch in squares():
        giver.on(t.MAP_UPDATE, patch_msg(patch))
    fed.stage.on(t.MAP_STATUS, msg.MapStatus(known_cells=1))
    restoring = msg.MapStatus(restoring=True)
    outputs = giver.on(t.MAP_STATUS, restoring)
    parts, room = 0, 0
    for k in range(20):
        for topic, message in outputs:
            if topic is t.MAP_MIRROR:
                assert fed.stage._handover.under_way == (parts < message.parts)
                fed.stage.on(topic, message)
                room = room or fed.stage.map.store.touched.size
                parts += 1
        outputs = giver.tick(k)
    assert parts == 3
    assert fed.stage.map.store.touched.size == room, "what came first was copied when more came"
    assert t.MAP_MIRROR.depth > planner.PARTS_PER_TICK
    assert not fed.stage._handover.under_way
    assert fed.stage.map.store.counts()[1] == 3 * 100 * 100
    assert "came back from the planner" in fed.status.detail


def test_a_slow_elevation_process_gets_no_part_twice_but_a_lost_one() -> None:
    """It tells twice a second that it is restoring. On a busy computer it was sent the whole map twice."""
    giver = planner.build(load(None, [], scene="flat"))
    for patch in squares():
        giver.on(t.MAP_UPDATE, patch_msg(patch))
    sent = []
    for now in range(0, 3 * planner.ASK_AGAIN, planner.ASK_AGAIN // 3):
        outputs = giver.tick(now) + giver.on(t.MAP_STATUS, msg.MapStatus(restoring=True))
        sent.append(sum(topic is t.MAP_MIRROR for topic, _ in outputs))
    assert sum(sent[:4]) == 3
    assert 3 < sum(sent) <= 9
    assert planner.ASK_AGAIN < RESTORE_PATIENCE


def test_routes_are_searched_around_the_robot_on_a_large_map() -> None:
    config = load(None, [], scene="flat")
    graph = MapGraph(config.graph_params(), BodyModel(), 0)
    for patch in squares():
        graph.apply(patch)
    for x in PLACES:
        assert graph.sync((x + 2.0, x + 2.0))
        assert graph.grid is not None
        assert max(graph.grid.shape) <= 5 * 512
        assert len(graph.ground().height) == graph.grid.shape[0]
        assert graph.graph is not None
        assert len(graph.graph.nodes) > 5
    graph.apply(squares()[0])
    graph.sync((-500.0, 0.0))
    assert graph.graph is None
