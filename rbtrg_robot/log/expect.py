"""What a run is expected to be: one line each (`max tilt < 25`, `odometry.health == good`), judged over the messages of
a run.

    [max | min | mean | last] QUANTITY < <= > >= == != VALUE [after N s]
    count TOPIC < <= > >= == != NUMBER [after N s]
    no plan longer than N x | N m [after N s]

A QUANTITY is one of QUANTITIES, or a field of a message: `odometry.overlap`, `/plan.transition_risk`. Without a word
before it every value counts. A line about something that the run does not hold does not hold.
"""

from __future__ import annotations

import math
import operator
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, fields, is_dataclass
from typing import Any

import numpy as np

from hal.errors import OperatorError
from rbtrg_robot import topics as t
from rbtrg_robot.log.read import LogError
from rbtrg_robot.log.trajectory import Trajectory, compare, of_poses
from rbtrg_robot.topics import Topic
from rbtrg_robot.wire.messages import MessageError, decode, stamp_of

Value = float | str | bool
Timed = tuple[float, Any]
"""Seconds into the run, and what was read there."""

COMPARE: dict[str, Callable[[Any, Any], bool]] = {
    "<=": operator.le, ">=": operator.ge, "==": operator.eq, "!=": operator.ne, "<": operator.lt, ">": operator.gt,
}  # fmt: skip
REDUCE: dict[str, Callable[[Sequence[Timed]], Timed]] = {
    "max": lambda seen: max(seen, key=lambda one: one[1]),
    "min": lambda seen: min(seen, key=lambda one: one[1]),
    "mean": lambda seen: (seen[-1][0], sum(value for _, value in seen) / len(seen)),
    "last": lambda seen: seen[-1],
}
NEAR_PLACE = 1.0
"""[m] The way to a place nearer than this is not compared with the straight line."""
SHORT: dict[str, Topic] = {
    "odometry": t.ODOM_HEALTH,
    "pose": t.ODOM,
    "robot": t.ROBOT_STATE,
    "map": t.MAP_STATUS,
    "goal": t.GOAL_STATUS,
    "plan": t.PLAN,
    "route": t.ROUTE_STATUS,
    "tracker": t.TRACKER_STATE,
    "guard": t.MOTION_LIMITS,
    "mission": t.MISSION_STATE,
}
"""Short names of topics."""

NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_AFTER = rf"(?:\s+after\s+(?P<after>{NUMBER})\s*s)?"
_PLAN = re.compile(rf"no\s+plan\s+longer\s+than\s+(?P<value>{NUMBER})\s*(?P<unit>x|m){_AFTER}")
_LINE = re.compile(
    rf"(?:(?P<reduce>max|min|mean|last|count)\s+)?(?P<name>[\w./]+)\s*(?P<compare><=|>=|==|!=|<|>)\s*(?P<value>.+?){_AFTER}"
)


class ExpectError(OperatorError):
    """A line that is no expectation; the message says what is wrong with it."""


@dataclass(frozen=True, slots=True)
class Quantity:
    """What is read of a run."""

    topics: tuple[Topic, ...]
    read: Callable[[Topic, Any], Iterable[Any]]
    """Values of one message."""
    unit: str = ""
    kind: type = float
    whole: Callable[[Sequence[Timed], Trajectory | None], list[Timed]] | None = None
    """Makes values of all that was read, and of the right trajectory where one is told. Raises LogError."""


@dataclass(frozen=True, slots=True)
class Expectation:
    """One line, understood."""

    text: str
    quantity: Quantity
    compare: str
    value: Value
    reduce: str = ""
    after: float = 0.0
    """[s] into the run: what was before does not count."""


@dataclass(frozen=True, slots=True)
class Verdict:
    """How a line stands."""

    text: str
    holds: bool
    told: str
    """The value that decides, when it was, and how many others are as wrong."""


def understand(text: str) -> Expectation:
    """Raises ExpectError."""
    line = text.strip()
    if found := _PLAN.fullmatch(line):
        quantity = _plans(relative=found["unit"] == "x")
        return Expectation(text, quantity, "<=", float(found["value"]), "", float(found["after"] or 0.0))
    found = _LINE.fullmatch(line)
    if not found:
        raise ExpectError(
            f"{text!r} is no expectation: write `max tilt < 25`, `odometry.health == good` or `no plan "
            "longer than 1.3 x`"
        )
    name, reduce, word = found["name"], found["reduce"] or "", found["value"].strip()
    if reduce == "count":
        topic = _topic(name, text)
        quantity = Quantity((topic,), lambda _topic, _message: (1.0,), whole=_count)
        reduce = ""
    else:
        quantity = QUANTITIES.get(name) or _field(name, text)
    value: Value = _value(word, quantity.kind, text)
    if quantity.kind is not float and (reduce not in ("", "last") or found["compare"] not in ("==", "!=")):
        raise ExpectError(f"{text!r}: {name} is no number: compare it by == or !=")
    return Expectation(text, quantity, found["compare"], value, reduce, float(found["after"] or 0.0))


class Judge:
    """Reads a run once for all its expectations."""

    def __init__(self, expectations: Sequence[Expectation], reference: Trajectory | None = None) -> None:
        """`reference`: the trajectory that `ate`, `rpe` and `rpe_deg` compare with; None: the simulator's truth."""
        self._expectations = expectations
        self._reference = reference
        self._seen: list[list[Timed]] = [[] for _ in expectations]
        self.topics = {topic for one in expectations for topic in one.quantity.topics}
        """What it reads."""
        self.broken = 0
        """Messages that could not be read."""

    def take(self, topic: Topic, payload: bytes, seconds: float) -> None:
        """A message, `seconds` into the run."""
        if topic not in self.topics:
            return
        try:
            message = decode(payload, topic.kind)
        except MessageError:
            self.broken += 1
            return
        for seen, one in zip(self._seen, self._expectations, strict=True):
            if topic in one.quantity.topics and seconds >= one.after:
                seen += [(seconds, value) for value in one.quantity.read(topic, message)]

    def verdicts(self) -> list[Verdict]:
        """Of each line, in their order."""
        return [self._verdict(one, seen) for one, seen in zip(self._expectations, self._seen, strict=True)]

    def _verdict(self, one: Expectation, seen: list[Timed]) -> Verdict:
        quantity = one.quantity
        try:
            values = quantity.whole(seen, self._reference) if quantity.whole else seen
        except LogError as error:
            return Verdict(one.text, False, str(error))
        if not values:
            names = ", ".join(topic.name for topic in quantity.topics)
            when = f" after {one.after:g} s" if one.after else ""
            return Verdict(one.text, False, f"nothing to judge: no value on {names}{when}")
        if quantity.kind is float and (lost := [at for at, value in values if math.isnan(value)]):
            return Verdict(one.text, False, f"no number at {lost[0]:.1f} s")
        judged = [REDUCE[one.reduce](values)] if one.reduce else values
        wrong = [(at, value) for at, value in judged if not COMPARE[one.compare](value, one.value)]
        if wrong:
            many = f" ({len(wrong)} of {len(values)})" if len(judged) > 1 else ""
            return Verdict(one.text, False, _told(wrong[0], quantity) + many)
        pick = {"<": "max", "<=": "max", ">": "min", ">=": "min"}.get(one.compare, "last")
        return Verdict(one.text, True, _told(REDUCE[pick](judged), quantity))


def _told(of: Timed, quantity: Quantity) -> str:
    at, value = of
    shown = f"{value:.4g} {quantity.unit}".rstrip() if quantity.kind is float else str(value) or "(empty)"
    return shown if quantity.whole else f"{shown} at {at:.1f} s"


def _value(word: str, kind: type, text: str) -> Value:
    if kind is str:
        return word.strip("'\"")
    if kind is bool:
        if word not in ("true", "false"):
            raise ExpectError(f"{text!r}: it is true or false, not {word!r}")
        return word == "true"
    found = re.fullmatch(rf"({NUMBER})\s*(m/s|m|s|deg)?", word)
    if not found:
        raise ExpectError(f"{text!r}: {word!r} is no number")
    return float(found[1])


def _topic(name: str, text: str) -> Topic:
    topic = SHORT.get(name) or t.BY_NAME.get(name)
    if topic is None:
        raise ExpectError(
            f"{text!r}: there is no {name!r}; quantities are {', '.join(QUANTITIES)}; topics are {', '.join(SHORT)}, "
            "or by their names, as `rbtrg-robot topic list` shows them"
        )
    return topic


def _field(name: str, text: str) -> Quantity:
    """A field of a message, `TOPIC.FIELD`."""
    lead, _, path = name.partition(".")
    topic = _topic(lead, text)
    value: Any = topic.kind()
    annotation = ""
    for part in path.split("."):
        held = {f.name: str(f.type) for f in fields(value)} if is_dataclass(value) else {}
        if part not in held:
            more = f"it has {', '.join(held)}" if held else "it has no fields"
            raise ExpectError(f"{text!r}: there is no field {part!r} in {lead}; {more}")
        value, annotation = getattr(value, part), held[part]
    kinds = {"bool": bool, "str": str, "list[str]": str, "int": float, "float": float}
    kind = (bool if "bool" in annotation else float) if "NDArray" in annotation else kinds.get(annotation)
    if kind is None:
        raise ExpectError(f"{text!r}: {name} is no value but a group; name one of its fields")
    get = operator.attrgetter(path)

    def read(_topic: Topic, message: Any) -> Iterable[Any]:
        found = get(message)
        if isinstance(found, np.ndarray):
            return [kind(part) for part in found.ravel().tolist()]
        return [kind(part) for part in found] if isinstance(found, list) else [kind(found)]

    return Quantity((topic,), read, kind=kind)


def _count(seen: Sequence[Timed], _reference: Trajectory | None) -> list[Timed]:
    return [(0.0, float(len(seen)))]


def _tilt(_topic: Topic, message: Any) -> Iterable[float]:
    """[deg] between the body's up and the world's."""
    q = message.pose.pose.orientation
    return (math.degrees(math.acos(min(1.0, max(-1.0, 1.0 - 2.0 * (q.x**2 + q.y**2))))),)


def _speed(_topic: Topic, message: Any) -> Iterable[float]:
    v = message.twist.twist.linear
    return (math.hypot(v.x, v.y),)


def _place(topic: Topic, message: Any) -> Iterable[Any]:
    p, q = message.pose.pose.position, message.pose.pose.orientation
    return ((topic, stamp_of(message), (p.x, p.y, p.z), (q.x, q.y, q.z, q.w)),)


def _driven(seen: Sequence[Timed], _reference: Trajectory | None) -> list[Timed]:
    places = np.array([value[2] for _, value in seen])
    return [(0.0, float(np.linalg.norm(np.diff(places, axis=0), axis=1).sum()))] if len(places) else []


def _way(seen: Sequence[Timed], topic: Topic) -> Trajectory | None:
    found = [value for _, value in seen if value[0] is topic]
    if not found:
        return None
    stamps, positions, orientations = zip(*(value[1:] for value in found), strict=True)
    return of_poses(np.array(stamps, np.int64), np.array(positions), np.array(orientations), topic.name)


def _error(figure: str) -> Callable[[Sequence[Timed], Trajectory | None], list[Timed]]:
    """A figure of the comparison of odometry with what is right."""

    def whole(seen: Sequence[Timed], reference: Trajectory | None) -> list[Timed]:
        own, right = _way(seen, t.ODOM), reference or _way(seen, t.TRUTH)
        if own is None:
            return []
        if right is None:
            raise LogError(
                f"nothing to compare with: the run holds no {t.TRUTH.name}; `against: FILE` names a trajectory"
            )
        return [(0.0, float(getattr(compare(own, right), figure)))]

    return whole


def _plans(*, relative: bool) -> Quantity:
    """Length of each plan [m], or in straight lines between its ends."""

    def read(_topic: Topic, plan: Any) -> Iterable[float]:
        if not plan.ok or len(plan.x) < 2:
            return ()
        length = float(np.hypot(np.diff(plan.x), np.diff(plan.y)).sum())
        straight = math.hypot(plan.x[-1] - plan.x[0], plan.y[-1] - plan.y[0])
        if not relative:
            return (length,)
        return (length / straight,) if straight >= NEAR_PLACE else ()

    return Quantity((t.PLAN,), read, "x" if relative else "m")


QUANTITIES: dict[str, Quantity] = {
    "tilt": Quantity((t.ODOM,), _tilt, "deg"),
    "speed": Quantity((t.ODOM,), _speed, "m/s"),
    "driven": Quantity((t.ODOM,), _place, "m", whole=_driven),
    "ate": Quantity((t.ODOM, t.TRUTH), _place, "m", whole=_error("ate")),
    "rpe": Quantity((t.ODOM, t.TRUTH), _place, "m", whole=_error("rpe_distance")),
    "rpe_deg": Quantity((t.ODOM, t.TRUTH), _place, "deg", whole=_error("rpe_distance_deg")),
}
"""By name: tilt of the trunk, speed and length of the way by odometry; ATE of odometry, and RPE over 1 m."""
