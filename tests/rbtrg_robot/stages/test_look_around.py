"""The planner's answer to a robot that explores."""

from __future__ import annotations

import numpy as np

from hal.safety.geofence import Fence
from mapping.elevation.exchange import MapPatch
from planning.graph.graph import GraphParams
from planning.risk.body import BodyModel
from rbtrg_robot import msg
from rbtrg_robot.stages.look_around import views_of
from rbtrg_robot.stages.map_graph import MapGraph

AREA = [(0.0, 0.0), (6.0, 0.0), (6.0, 6.0), (0.0, 6.0)]


def seen(columns: int) -> MapPatch:
    """Level ground from x 0, y 0 on, 6 m in y, `columns` of 5 cm in x."""
    height = np.zeros((120, columns), np.float32)
    layers = {
        "elevation": height,
        "variance": np.full_like(height, 1e-4),
        "trusted": np.ones_like(height),
        "upper_bound": np.full_like(height, np.nan),
        "source": np.full_like(height, 2.0),
    }
    return MapPatch((0.0, 0.0), 0.05, 1, 1, layers)


def test_ground_beyond_the_allowed_area_is_neither_looked_at_nor_left() -> None:
    found = {}
    for fence in (Fence(), Fence.of(AREA)):
        terrain = MapGraph(GraphParams(), BodyModel(), 0)
        terrain.apply(seen(180))  # to x 9 m; unseen all around
        terrain.enclose(fence)
        question = msg.ExploreQuestion(sequence=1, start_x=3.0, start_y=3.0)
        found[bool(fence)] = views_of(terrain, question, BodyModel(), 1)
        assert not found[bool(fence)].refused
    free, kept = found[False], found[True]
    assert free.x.max() > 8.0
    assert not len(kept.x), "the area is seen: there is nothing to look at"
    assert not len(kept.unreachable_x)
