"""Why the robot drives slower than it may: in words, for people."""

from __future__ import annotations

import numpy as np

from planning.braking import bend_speed
from planning.tracking.path import TrackPath
from planning.tracking.types import TrackerConfig

LIMIT_SHARE = 0.9
"""From this share of its limit on the robot drives at its limit."""
BEND_AHEAD = 0.3
"""A bend that begins within this distance [m] is what slows it down."""
WORDS = ("the ground", "the end of the path", "a slope", "its heading")


def slowed_by(line: TrackPath, s: float, params: TrackerConfig, limits: tuple[float, ...]) -> str:
    """What makes the robot slower than `TrackerConfig.max_speed`; empty where nothing clearly does.

    line, s: the path and the place on it [m]; limits: of the path's profile, its end, the slope and the heading [m/s].
    """
    least = min(limits)
    if least >= LIMIT_SHARE * params.max_speed:
        return ""
    if least < limits[0]:
        return WORDS[limits.index(least)]
    bend = max(abs(line.at(line.curvature, s + BEND_AHEAD * k / 3)) for k in range(4))
    profile = params.profile()
    fastest = bend_speed(np.array([bend]), profile["lateral_accel"], profile["max_yaw_rate"])[0]
    return "a bend" if fastest <= least + 0.05 else WORDS[0]
