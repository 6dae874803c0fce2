"""Why a goal ended. Every surface shows the same plain words."""

from __future__ import annotations

import math
from enum import StrEnum

from hal.types import LYING, Phase
from rbtrg_robot.msg import MapStatus, OdometryHealth, RobotState


class Reason(StrEnum):
    """Reason of a goal's state, as it stands in GoalStatus and Plan."""

    NONE = ""
    INVALID = "invalid"
    OUTSIDE = "outside_area"
    KEPT_OUT = "keep_out_area"
    IN_OBSTACLE = "goal_in_obstacle"
    START_OFF_GRAPH = "start_not_on_graph"
    NO_ROUTE = "no_route"
    TOO_RISKY = "too_risky"
    LOST = "localization_lost"
    UNLOCATED = "not_located"
    UNSURE = "place_unsure"
    STUCK = "stuck"
    ESTOP = "emergency_stop"
    TIMEOUT = "timeout"
    PROCESS_LOST = "process_lost"
    ROBOT_FAULT = "robot_fault"
    LYING = "robot_lies"
    DISCONNECTED = "robot_disconnected"
    TAKEN = "taken"
    CANCELLED = "cancelled"
    PREEMPTED = "preempted"

    @classmethod
    def of(cls, word: str) -> Reason | None:
        """The reason in a message; None for a word that is none."""
        return cls(word) if word in cls._value2member_map_ else None


WORDS: dict[Reason, str] = {
    Reason.NONE: "",
    Reason.INVALID: "the goal is not a valid position",
    Reason.OUTSIDE: "the goal is outside the allowed area",
    Reason.KEPT_OUT: "the goal is in a keep-out area",
    Reason.IN_OBSTACLE: "the goal is in a known obstacle (no free place within 0.5 m)",
    Reason.START_OFF_GRAPH: "the robot stands where no route can begin",
    Reason.NO_ROUTE: "no route to the goal",
    Reason.TOO_RISKY: "the way is too likely to fail",
    Reason.LOST: "localization is lost",
    Reason.UNLOCATED: "the robot has not found itself in the map",
    Reason.UNSURE: "where the robot is is not known as well as the goal asks",
    Reason.STUCK: "the robot is stuck",
    Reason.ESTOP: "emergency stop",
    Reason.TIMEOUT: "the goal timed out",
    Reason.PROCESS_LOST: "a process the goal needs was lost",
    Reason.ROBOT_FAULT: "the robot reports a fault",
    Reason.LYING: "the robot does not stand",
    Reason.DISCONNECTED: "the robot is out of contact",
    Reason.TAKEN: "driven by hand",
    Reason.CANCELLED: "cancelled",
    Reason.PREEMPTED: "another goal took its place",
}


PATIENCE: dict[Reason, float] = {Reason.DISCONNECTED: 3.0, Reason.TAKEN: math.inf}
"""Seconds after which a goal whose cause of waiting this is ends, if not the configured ones. A robot that was out of
contact
for longer drives on only when told to: whoever plugged the cable in may stand in its way."""


def words(reason: str, detail: str = "") -> str:
    """The reason in plain words, with its detail."""
    known = Reason.of(reason)
    text = reason if known is None else WORDS[known]
    if text and detail.startswith(f"{text}: "):  # the robot's own cause of a stop says it already
        return detail
    return f"{text}: {detail}" if detail and text else text or detail


def absence(robot: RobotState | None, health: OdometryHealth | None) -> tuple[Reason, str] | None:
    """Why a goal must wait: somebody drives by hand, the robot is out of contact, or it is not known where it is."""
    if robot is not None and robot.phase == Phase.DISCONNECTED:
        return Reason.DISCONNECTED, robot.cause
    if robot is not None and robot.taken:
        return Reason.TAKEN, robot.taken
    if health is not None and health.health == "lost":
        return Reason.LOST, health.reason
    return None


def hindrance(robot: RobotState | None) -> tuple[Reason, str] | None:
    """Why a robot drives nowhere, and what to do; None where it does. `robot`: its newest RobotState message, if
    any."""
    if robot is None:
        return None
    if robot.estop:
        return Reason.ESTOP, f"{robot.estop_cause}; `rbtrg-robot resume` releases it"
    if robot.phase == Phase.FAULT:
        return Reason.ROBOT_FAULT, robot.cause
    if robot.phase in LYING:
        return Reason.LYING, "`rbtrg-robot posture stand` gets it up"
    return None


LOCATED = ("", "located", "assumed", "told", "closing")
"""`MapStatus.location` in which a goal in `map` means something."""


def unlocated(elevation: MapStatus | None) -> tuple[Reason, str] | None:
    """Why a goal in `map` means nothing yet; None where it does. `elevation`: its newest status, if any."""
    if elevation is None or elevation.location in LOCATED:
        return None
    return Reason.UNLOCATED, f"{elevation.location_detail}; drive a metre by hand, or set the pose"
