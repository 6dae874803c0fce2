"""A route as messages: the plan that is driven, the path for ROS tools, and the report that tells people why."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from planning.errors import NoRouteReason
from planning.graph.graph import TraversalGraph
from planning.path import Path
from planning.risk.table import RiskTable
from planning.search.plan import Plan
from planning.search.worst import worst_poses
from rbtrg_robot import msg
from rbtrg_robot.stages.navigation.reasons import Reason
from rbtrg_robot.wire.convert import MAP, point, yaw_quaternion
from rbtrg_robot.wire.messages import array, header

F64 = "float64"
EVERY_SAMPLE = 5
"""Samples of the path between two in a report: 0.1 m."""


REASONS = {
    NoRouteReason.BAD_INPUT: Reason.INVALID,
    NoRouteReason.NO_TERRAIN: Reason.START_OFF_GRAPH,
    NoRouteReason.OUTSIDE_MAP: Reason.NO_ROUTE,
    NoRouteReason.START_NOT_ON_GRAPH: Reason.START_OFF_GRAPH,
    NoRouteReason.NOT_CONNECTED: Reason.NO_ROUTE,
    NoRouteReason.GOAL_IN_OBSTACLE: Reason.IN_OBSTACLE,
    NoRouteReason.GOAL_UNKNOWN: Reason.NO_ROUTE,
    NoRouteReason.NO_ROUTE: Reason.NO_ROUTE,
}


@dataclass(frozen=True, slots=True)
class RouteBase:
    """What a report begins with."""

    header: msg.Header
    id: str
    question: bool = False

    def _fields(self, graph: TraversalGraph | None) -> dict[str, Any]:
        fields: dict[str, Any] = {"header": self.header, "id": self.id, "question": self.question}
        if graph is None:
            return fields
        source = np.repeat(np.arange(len(graph.nodes)), np.diff(graph.indptr))
        once = source < graph.indices
        return fields | {
            **{f"graph_{axis}": array(graph.nodes[:, k], "float32") for k, axis in enumerate("xyz")},
            "graph_from": array(source[once], "uint32"),
            "graph_to": array(graph.indices[once], "uint32"),
            "graph_risk": array(graph.risk[once], "float32"),
        }

    def refused(self, reason: Reason, detail: str, graph: TraversalGraph | None = None) -> msg.RouteReport:
        """There is no route."""
        return msg.RouteReport(**self._fields(graph), ok=False, reason=reason.value, detail=detail)

    def report(
        self,
        found: Plan,
        path: Path,
        table: RiskTable,
        native: Plan | None = None,
        graph: TraversalGraph | None = None,
    ) -> msg.RouteReport:
        """A route and why. `native`: what the native cost alone would have chosen."""
        worst, turn = worst_poses(found, table.sampler, table.body)
        each = found.transitions
        peak = {
            name: array([max((p[name] for p in x.peak.values()), default=0.0) for x in each], F64)
            for name in ("d_fb", "a_lr", "p_int")
        }
        few = _some(path, EVERY_SAMPLE)
        alternative = np.zeros((0, 3)) if native is None else native.points
        transitions = {
            "length": [x.length for x in each],
            "cost": [x.cost for x in each],
            "turn": turn,
            "risk": [x.risk for x in each],
            "body": [x.body for x in each],
            "unknown": [x.unknown for x in each],
            "p_fail": [np.nan] * len(each) if found.chance is None else found.chance.each,
        }
        values: dict[str, Any] = {
            **self._fields(graph),
            **peak,
            **{axis: array(path.points[few, k], F64) for k, axis in enumerate("xyz")},
            **{f"node_{axis}": array(found.points[:, k], F64) for k, axis in enumerate("xyz")},
            **{f"transition_{name}": array(column, F64) for name, column in transitions.items()},
            **{f"worst_{name}": array(worst[:, k], F64) for k, name in enumerate(("x", "y", "yaw"))},
        }
        return msg.RouteReport(
            **values,
            ok=True,
            reaches_goal=found.reaches_goal,
            cost=found.cost,
            length=found.length,
            p_fail=found.p_fail,
            worst=worst_of(found),
            duration=duration(path),
            yaw=array(path.yaw[few], F64),
            native_x=array(alternative[:, 0], F64),
            native_y=array(alternative[:, 1], F64),
            native_length=0.0 if native is None else native.length,
            native_body=0.0 if native is None else max((x.body for x in native.transitions), default=0.0),
        )


def worst_of(found: Plan) -> str:
    """Where a plan is most likely to fail, in words."""
    return "" if found.chance is None else found.chance.worst


def too_risky(found: Plan, accepted: float) -> str:
    """Why a goal is refused whose way fails more often than is accepted, and what may be done."""
    return (
        f"it fails {100 * found.p_fail:.0f} times of 100, {100 * accepted:.0f} are accepted (planner.accept_risk); "
        f"worst: {worst_of(found)}; send the goal with --accept to drive it anyway, or choose another"
    )


def duration(path: Path) -> float:
    """[s] at the path's own speeds."""
    step = np.hypot(*np.diff(path.points[:, :2], axis=0).T)
    speed = np.maximum((path.speed[1:] + path.speed[:-1]) / 2, 0.05)
    return float((step / speed).sum())


def plan_fields(found: Plan, path: Path, message: msg.PlanRequest) -> dict[str, Any]:
    """What a rbtrg_msgs/Plan says of a route and its path."""
    return {
        "ok": True,
        "reaches_goal": found.reaches_goal,
        "cost": found.cost,
        "length": found.length,
        "p_fail": found.p_fail,
        "worst": worst_of(found),
        "x": array(path.points[:, 0], F64),
        "y": array(path.points[:, 1], F64),
        "z": array(path.points[:, 2], F64),
        "yaw": array(path.yaw, F64),
        "speed": array(path.speed, F64),
        "least_speed": array(path.least, F64),
        "has_goal_yaw": message.has_goal_yaw,
        "goal_yaw": message.goal_yaw,
        "node_x": array(found.points[:, 0], F64),
        "node_y": array(found.points[:, 1], F64),
        "transition_length": array([x.length for x in found.transitions], F64),
        "transition_risk": array([x.risk for x in found.transitions], F64),
        "transition_body": array([x.body for x in found.transitions], F64),
        "transition_unknown": array([x.unknown for x in found.transitions], F64),
    }


def _some(path: Path, every: int) -> list[int]:
    """Rows of the path, `every` samples apart, and the last one."""
    rows = range(0, len(path.points), every)
    return sorted({*rows, *range(len(path.points))[-1:]})


def path_msg(path: Path, now: int) -> msg.Path:
    """nav_msgs/Path of where the path goes and the heading of the body there, a pose every 0.2 m and the last one."""
    stamp = header(now, MAP)
    few = _some(path, 10)
    poses = [
        msg.PoseStamped(stamp, msg.Pose(point(p), yaw_quaternion(yaw)))
        for p, yaw in zip(path.points[few], path.yaw[few], strict=True)
    ]
    return msg.Path(header=stamp, poses=poses)
