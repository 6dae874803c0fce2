"""The planner's answer to a robot that explores: places to look from, as messages."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planning.risk.body import BodyModel
from planning.search.viewpoints import Survey, viewpoints
from rbtrg_robot import msg
from rbtrg_robot.areas import MOST_CORNERS
from rbtrg_robot.stages.map_graph import MapGraph
from rbtrg_robot.wire.convert import MAP
from rbtrg_robot.wire.messages import array, header

F64 = "float64"


def views_of(terrain: MapGraph, question: msg.ExploreQuestion, body: BodyModel, now: int) -> msg.Viewpoints:
    """The graph follows the map first; `now` [ns]."""
    answer = msg.Viewpoints(header=header(now, MAP), sequence=question.sequence)
    start, area = (question.start_x, question.start_y), _pairs(question.area)
    home = (question.home_x, question.home_y) if question.has_home else None
    numbers = np.concatenate([start, question.area, question.barred, home or ()])
    if not np.isfinite(numbers).all() or len(question.area) not in (0, *range(6, 2 * MOST_CORNERS + 2, 2)):
        answer.refused = "the question has numbers that are not finite, or its area no corners"
        return answer
    if question.anew and terrain.graph is not None:
        terrain.sample_anew(start, home or start)
    elif terrain.stale or terrain.graph is None:
        terrain.sync(start)
    graph, grid = terrain.graph, terrain.grid
    if graph is None or grid is None or graph.cells is None or not len(graph.nodes):
        answer.refused = "no ground around the robot is known yet"
        return answer
    target = (question.target_x, question.target_y) if question.has_target else None
    survey = Survey(start, area if len(area) else None, home, target, _pairs(question.barred))
    found = viewpoints(graph, grid, survey, body.weight_native)
    answer.x, answer.y = array(found.xy[:, 0], F64), array(found.xy[:, 1], F64)
    answer.gain, answer.way = array(found.gain, F64), array(found.way, F64)
    answer.seen, answer.hidden, answer.home = found.seen, found.hidden, found.home
    # What lies beyond the fence is not left: nobody wants it seen.
    left = np.array([at for at in found.unreachable if terrain.fence.breach(*at)[0] <= 0.0]).reshape(-1, 2)
    answer.unreachable_x, answer.unreachable_y = (array(left[:, k], F64) for k in (0, 1))
    return answer


def _pairs(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n, 2) from x and y one after the other; a last one alone is left out."""
    return np.asarray(values[: len(values) // 2 * 2], np.float64).reshape(-1, 2)
