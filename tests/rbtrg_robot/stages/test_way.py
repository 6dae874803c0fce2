"""The search for a way to one goal."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from planning.search.plan import Plan
from rbtrg_robot import topics as t
from rbtrg_robot.stages.map_graph import MapGraph
from tests.rbtrg_robot.stages.test_planner import ask, patch, planner


@pytest.mark.parametrize(("good", "asked"), [(1, 1), (2, 2), (9, 0)])
def test_a_way_that_was_lost_is_searched_in_other_graphs_before_a_frontier_is_driven_to(
    good: int, asked: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In graphs of seeds below `good` the passage holds no edge: the plan ends before it."""
    stage = planner()
    stage.on(t.MAP_UPDATE, patch(np.zeros((75, 150))))
    assert ask(stage, (1.5, 1.5), (5.0, 1.5)).reaches_goal
    first, search = stage._map.graph, MapGraph.search

    def narrow(self: MapGraph, *args: Any) -> Plan:
        return replace(search(self, *args), reaches_goal=self.seed >= good)

    monkeypatch.setattr(MapGraph, "search", narrow)
    answer = ask(stage, (1.5, 1.5), (5.0, 1.5), sequence=2)
    assert (answer.ok, answer.reaches_goal, stage._map.seed) == (True, asked > 0, asked)
    assert (stage._map.graph is first) == (asked == 0), "without a way the graph stays as it was"
    if not asked:
        monkeypatch.setattr(MapGraph, "sample_anew", None)  # what has no way any more is not searched again
        assert not ask(stage, (1.5, 1.5), (5.0, 1.5), sequence=3).reaches_goal
