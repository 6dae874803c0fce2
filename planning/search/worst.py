"""Where on a route the body is worst off, and how far it turns: what a person wants to see of a plan."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from planning.risk.body import BodyModel, edge_poses, sweep_poses
from planning.risk.footprint import poses_features
from planning.risk.pose_sets import turn_angle
from planning.risk.terrain import Sampler
from planning.search.request import Plan


def worst_poses(
    found: Plan, sampler: Sampler, body: BodyModel
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Of each transition: the pose x, y [m], yaw [rad] with the largest sum of scaled features (eq. 2, 3), (n, 3); its
    turn [rad], (n,).

    The pose sets are those of eq. 3: the edge, the turn before it, the turn at the goal with the last edge.
    """
    points, request = found.points, found.request
    count = len(found.transitions)
    if not count:  # also a route of another planner
        return np.zeros((0, 3)), np.zeros(0)
    heading = np.arctan2(*np.diff(points[:, :2], axis=0).T[::-1])
    heading = heading + np.pi * np.array([x.backward for x in found.transitions])
    before = [heading[0] if request.start_yaw is None else request.start_yaw, *heading[:-1]]
    sets, turns = [], np.zeros(count)
    for k in range(count):
        turns[k] = turn_angle(before[k], heading[k])
        x, y = points[k, :2]
        along = edge_poses(points[k, :2], points[k + 1, :2], body)
        along[:, 2] = heading[k]
        poses = [sweep_poses(x, y, before[k], heading[k], body), along]
        if k == count - 1 and request.goal_yaw is not None:
            poses.append(sweep_poses(points[-1, 0], points[-1, 1], heading[k], request.goal_yaw, body))
        sets.append(np.concatenate(poses))
    every = np.concatenate(sets)
    risk = np.minimum(poses_features(sampler, every) / body.scales, 3.0).sum(axis=1)
    ends = np.cumsum([len(poses) for poses in sets])
    worst = [
        every[first + int(risk[first:end].argmax())] for first, end in zip([0, *ends[:-1]], ends, strict=True)
    ]
    out = np.array(worst)
    out[:, 2] = [math.remainder(yaw, 2 * math.pi) for yaw in out[:, 2]]
    return out, turns
