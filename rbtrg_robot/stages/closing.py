"""A map of this run with its loops closed, which waits until the robot has come to where it is in it."""

from __future__ import annotations

import math
from dataclasses import dataclass

from hal.rotation import wrap
from hal.types import NS
from mapping.elevation.map import ElevationMap, Move
from rbtrg_robot import msg
from rbtrg_robot.stages.prior import Prior
from rbtrg_robot.wire.convert import LayoutError
from rbtrg_robot.wire.frames import Planar


@dataclass(frozen=True, slots=True)
class Closing:
    """What is known of it when it comes."""

    prior: Prior
    """Its `start` is where `odom` lies in it."""
    lift: float
    """How much higher its newest part lies than in the map of before [m]."""
    until: int
    """Its newest scan [ns]."""
    before: Planar
    """Where `odom` lay in the map of before."""
    began: int
    """The newest scan when it came [ns]."""

    def take(self, elevation: ElevationMap, now: int, *, jumped: bool) -> int:
        """The map becomes this one; returns its known cells. now: the newest scan [ns]; jumped: the robot did not glide
        to where it is in it."""
        turn = wrap(self.prior.start[2] - self.before[2])
        c, s = math.cos(turn), math.sin(turn)
        x, y, _ = self.before
        shift = self.prior.start[0] - c * x + s * y, self.prior.start[1] - s * x - c * y, turn
        move = Move(shift, self.lift, now if jumped else self.began, now)
        return elevation.follow(self.prior.patches, self.prior.cloud, self.until, move)


def target_of(message: msg.MapPrior) -> tuple[Planar, float] | None:
    """Where `odom` lies in a map of this run, and how much higher it is; None of any other map. Raises LayoutError."""
    told = message.odom_in_map.tolist()
    if not told:
        return None
    if len(told) != 4 or not all(map(math.isfinite, told)):
        raise LayoutError("a closed map that does not tell where the robot is in it")
    return (told[0], told[1], told[2]), told[3]


def until_of(message: msg.MapPrior) -> int:
    """[ns]"""
    return message.until.sec * NS + message.until.nanosec
