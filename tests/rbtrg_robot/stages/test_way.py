"""The search for a way to one goal."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from planning.errors import NoRoute, NoRouteReason
from planning.search.plan import Plan
from rbtrg_robot import topics as t
from rbtrg_robot.stages.map_graph import MapGraph
from rbtrg_robot.stages.way import REDRAWS
from tests.rbtrg_robot.stages.test_planner import ask, patch, planner


@pytest.mark.parametrize("narrow", [{"reaches_goal": False}, {"cost": 40.0}])
@pytest.mark.parametrize(("good", "drawn"), [(1, 1), (2, 2), (9, REDRAWS)])
def test_a_way_that_was_lost_is_searched_in_other_graphs_before_another_is_driven(
    good: int, drawn: int, narrow: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """In graphs of seeds below `good` the passage holds no edge: the plan ends before it, or leads a dear way around."""
    stage = planner()
    stage.on(t.MAP_UPDATE, patch(np.zeros((75, 150))))
    assert ask(stage, (1.5, 1.5), (5.0, 1.5)).reaches_goal
    first, search = stage._map.graph, MapGraph.search

    def in_graph(self: MapGraph, *args: Any) -> Plan:
        found = search(self, *args)
        return found if self.seed >= good else replace(found, **narrow)

    monkeypatch.setattr(MapGraph, "search", in_graph)
    answer = ask(stage, (1.5, 1.5), (5.0, 1.5), sequence=2)
    found = good <= drawn
    assert (answer.ok, answer.reaches_goal, stage._map.seed) == (True, found or "cost" in narrow, drawn)
    assert (stage._map.graph is first) != found, "without a way the graph stays as it was"
    if not found:  # what has no way any more is not searched again
        assert ask(stage, (1.5, 1.5), (5.0, 1.5), sequence=3).ok
        assert stage._map.seed == drawn


def test_where_there_is_no_way_other_graphs_are_searched_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    stage = planner()
    stage.on(t.MAP_UPDATE, patch(np.zeros((75, 150))))
    search = MapGraph.search

    def none_in_the_first(self: MapGraph, *args: Any) -> Plan:
        if self.seed < 3:
            raise NoRoute(NoRouteReason.NO_ROUTE, "no edge")
        return search(self, *args)

    monkeypatch.setattr(MapGraph, "search", none_in_the_first)
    answer = ask(stage, (1.5, 1.5), (5.0, 1.5))
    assert (answer.ok, answer.reaches_goal, stage._map.seed) == (True, True, 3)
