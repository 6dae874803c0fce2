"""What a mission may say: the kinds of steps, and the checks of an order that came over the bus."""

from __future__ import annotations

import math
from enum import StrEnum
from typing import Any

import numpy as np

from rbtrg_robot import msg
from rbtrg_robot.areas import MOST_CORNERS
from rbtrg_robot.stages.mission.cursor import nested
from rbtrg_robot.wire.convert import MAP
from rbtrg_robot.wire.messages import encode, header


class Kind(StrEnum):
    """What a step does."""

    GOTO = "goto"
    HOME = "home"
    EXPLORE = "explore"
    COVER = "cover"
    DOCK = "dock"
    WAIT = "wait"
    ASK = "ask"
    STAND = "stand"
    SIT = "sit"
    LOOK = "look"
    RECORD = "record"
    PHOTO = "photo"


class OnFailure(StrEnum):
    """What a mission does when a step fails."""

    STOP = "stop"
    RETRY = "retry"
    SKIP = "skip"
    RETURN = "return"


class OnCommsLoss(StrEnum):
    """What a mission does when no operator is in contact."""

    CONTINUE = "continue"
    HOLD = "hold"
    RETURN = "return"


class Blocking(StrEnum):
    """VDA 5050 blockingType, as far as it occurs here."""

    HARD = "HARD"
    NONE = "NONE"


MOST_STEPS = 1000
MOST_RETRIES = 100
LEAST_SWATH = 0.3
"""[m]"""
GOAL_SPACING = 4.0
"""[m] from one goal on a lane of a cover to the next, at most."""
MOST_PLACES = 4000
"""Of those goals, by the diagonal of the area: what is remembered of them stays small."""
LONGEST_TEXT = 500
"""Characters of a name or a question."""
EVERYWHERE = frozenset(
    {Kind.GOTO, Kind.HOME, Kind.EXPLORE, Kind.COVER, Kind.DOCK, Kind.WAIT, Kind.ASK, Kind.STAND, Kind.SIT}
)
"""What every backend does. `look` is not among them: the robot process takes no attitude yet."""
WHY_NOT = {
    Kind.LOOK: "the robot process does not turn the body yet",
    Kind.RECORD: "the stack was started without a recorder",
    Kind.PHOTO: "the stack was started without a camera, or without a recorder that keeps it",
}
"""Why a step of this kind cannot be done here."""


def in_place_of(goal: msg.GoalStatus, now: int, why: str, *, sent: bool) -> msg.MissionOrder:
    """The mission that a goal of somebody becomes at `now` [ns] while it is under way (`sent`); else one that leads
    home, and `why`."""
    fields: dict[str, Any] = {"id": "home", "kind": Kind.HOME, "on_failure": OnFailure.RETRY, "retries": 3}
    name = f"way home ({why})"
    if sent:
        fields = {"id": "goal", "kind": Kind.GOTO, "on_failure": OnFailure.STOP, "x": goal.x, "y": goal.y}
        fields |= {"yaw": goal.yaw, "has_yaw": goal.has_yaw}
        name = f"goal of {goal.owner}".strip()
    return msg.MissionOrder(
        header=header(now, MAP),
        order_id=f"{goal.id}/{now}",
        name=name[:LONGEST_TEXT],
        owner=goal.owner,
        frame=MAP,
        start=1,
        steps=[msg.MissionStep(blocking_type=Blocking.HARD, **fields)],
        no_return=goal.no_return,
    )


def refusal(order: msg.MissionOrder, possible: frozenset[Kind], prior_map: str) -> str:
    """Why an order is not accepted, and what to do; empty where it is.

    `possible`: what this stack can do; `prior_map`: hash of the map it was started with, or empty.
    """
    if not order.order_id:
        return "the order has no id"
    if order.frame != MAP:
        return f"frame {order.frame!r} is not {MAP}: other frames begin anew with every start"
    if order.map not in ("", prior_map):
        running = f"{prior_map} is loaded" if prior_map else "none is loaded"
        return f"it was made on map {order.map}, {running}: start the stack with `up --map FILE`"
    if order.on_comms_loss not in ("", *OnCommsLoss):
        return f"on_comms_loss {order.on_comms_loss!r} is none of {', '.join(OnCommsLoss)}"
    if not (math.isfinite(order.comms_timeout) and order.comms_timeout >= 0):
        return "comms_timeout must not be less than 0 s"
    if not all(map(math.isfinite, (order.home_x, order.home_y, order.home_yaw))):
        return "home has numbers that are not finite"
    if not 1 <= len(order.steps) <= MOST_STEPS:
        return f"a mission has 1 to {MOST_STEPS} steps, this one has {len(order.steps)}"
    if not 1 <= order.start <= len(order.steps):
        return f"there is no step {order.start}: the mission has {len(order.steps)}"
    if len({step.id for step in order.steps}) < len(order.steps):
        return "two steps have the same id"
    for number, step in enumerate(order.steps, 1):
        if why := _step_refusal(step, possible):
            return f"step {number} ({step.kind}): {why}"
    count = len(order.steps)
    if any(not 1 <= loop.first <= loop.last <= count for loop in order.loops) or not nested(order.loops):
        return "its loops cross each other or the end of the mission"
    return ""


def _step_refusal(step: msg.MissionStep, possible: frozenset[Kind]) -> str:
    if step.kind not in Kind._value2member_map_:
        return f"there are only {', '.join(Kind)}"
    kind = Kind(step.kind)
    if kind not in possible:
        return WHY_NOT.get(kind, "this robot cannot do that")
    if not all(map(math.isfinite, (step.x, step.y, step.yaw, step.pitch, step.duration, step.timeout))):
        return "it has numbers that are not finite"
    if step.duration < 0 or step.timeout < 0:
        return "times are not negative"
    if kind in (Kind.EXPLORE, Kind.COVER) and (why := _area_refusal(step, kind)):
        return why
    if step.on_failure not in OnFailure._value2member_map_:
        return f"on_failure {step.on_failure!r} is none of {', '.join(OnFailure)}"
    if step.retries > MOST_RETRIES:
        return f"at most {MOST_RETRIES} retries"
    if step.blocking_type not in (Blocking.HARD, *([Blocking.NONE] if kind is Kind.RECORD else [])):
        return f"blocking type {step.blocking_type!r} does not go with it"
    if max(map(len, (step.id, step.text, *step.choices))) > LONGEST_TEXT:
        return f"its text is longer than {LONGEST_TEXT} characters"
    if kind is Kind.ASK and not step.choices:
        return "there is nothing to answer"
    return ""


def _area_refusal(step: msg.MissionStep, kind: Kind) -> str:
    if not np.isfinite(step.area).all() or len(step.area) not in (0, *range(6, 2 * MOST_CORNERS + 2, 2)):
        return f"an area has 3 to {MOST_CORNERS} corners, each with finite x and y"
    if kind is Kind.COVER:
        if not len(step.area):
            return "it needs an area"
        if not step.swath >= LEAST_SWATH:
            return f"a swath is at least {LEAST_SWATH} m"
        across = math.hypot(*np.ptp(step.area.reshape(-1, 2), axis=0))
        most = (across / step.swath + 1.0) * (across / GOAL_SPACING + 2.0)
        return "" if most <= MOST_PLACES else "the area is too large for this swath: cover it in parts"
    if not 0.0 <= step.until <= 1.0:
        return "`until` is a share from 0 to 1"
    return "`until` needs an area" if step.until > 0.0 and not len(step.area) else ""


def update_refusal(old: msg.MissionOrder, new: msg.MissionOrder, at: int) -> str:
    """Why `new` cannot replace `old` at step `at`; empty if it can: finished and present steps must stay."""
    if new.order_update_id <= old.order_update_id:
        return f"update {new.order_update_id} is not newer than {old.order_update_id}"
    if len(new.steps) < at or any(
        encode(a) != encode(b) for a, b in zip(old.steps[:at], new.steps[:at], strict=True)
    ):
        return f"it changes steps up to {at}, which were begun"
    loops = [[(x.first, x.last, x.times) for x in order.loops if x.first <= at] for order in (old, new)]
    return "it changes a loop that was begun" if loops[0] != loops[1] else ""
