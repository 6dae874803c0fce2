"""A mission file: YAML with a schema, and the order that is made from it."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import yaml
from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Field,
    Tag,
    ValidationError,
    field_validator,
    model_validator,
)

from hal.errors import OperatorError
from rbtrg_robot import msg, yaml_file
from rbtrg_robot.areas import MOST_CORNERS
from rbtrg_robot.stages.mission.order import LEAST_SWATH, Blocking, Kind
from rbtrg_robot.yaml_file import YamlError


class MissionError(OperatorError):
    """A mission file is wrong; the message names the place."""


class _Model(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


def _word(value: Any) -> Any:
    """YAML reads `yes` and `no` as truth values; here they are words."""
    return {True: "yes", False: "no"}[value] if isinstance(value, bool) else value


Word = Annotated[str, BeforeValidator(_word), Field(min_length=1, max_length=100)]
Seconds = Annotated[float, Field(ge=0, le=86400)]
OnFailureText = Annotated[str, Field(pattern=r"^(stop|skip|return|retry ([1-9][0-9]?|100))$")]


class Place(_Model):
    """Where to go, in frame `map`."""

    x: float = Field(description="[m]")
    y: float = Field(description="[m]")
    yaw_deg: float | None = Field(None, description="heading at the place [deg]; None = any")
    timeout: Seconds = Field(0.0, description="the step fails after this long [s]; 0 = never")
    accept_risk: bool = Field(
        False, description="drive it although it is likely to fail (planner.accept_risk)"
    )


class Home(_Model):
    """Where `home` and `return` go, in frame `map`."""

    x: float = Field(description="[m]")
    y: float = Field(description="[m]")
    yaw_deg: float = Field(0.0, description="[deg]")


class Nothing(_Model):
    """No fields."""


class Question(_Model):
    """What an operator must answer."""

    question: str = Field(min_length=1, max_length=500)
    choices: tuple[Word, ...] = Field(
        ("yes", "no"), min_length=1, description="the first one goes on, every other one is a failure"
    )
    timeout: Seconds = Field(0.0, description="the step fails after this long [s]; 0 = never")


class Direction(_Model):
    """Where to look, relative to the body."""

    yaw_deg: float = Field(0.0, ge=-180, le=180, description="to the left [deg]")
    pitch_deg: float = Field(0.0, ge=-90, le=90, description="up [deg]")
    seconds: Seconds = Field(1.0, description="how long [s]")


class Mark(_Model):
    """What is recorded here: the run is kept on the disk, and the log says when."""

    name: str = Field("", max_length=500)
    seconds: Seconds = Field(0.0, description="stand this long [s]; 0 = go on at once")


class _Step(_Model):
    id: str = Field("", max_length=100, description="name of the step; default: its kind and number")
    on_failure: OnFailureText | None = Field(
        None, description="stop, skip, return or `retry N`; None = that of the mission"
    )


class Goto(_Step):
    """Go to a place."""

    goto: Place


class Limits(_Model):
    """How long a step may take, and how likely it may fail."""

    timeout: Seconds = Field(0.0, description="the step fails after this long [s]; 0 = never")
    accept_risk: bool = Field(
        False, description="drive it although it is likely to fail (planner.accept_risk)"
    )


class GoHome(_Step):
    """Go home, with an id, an `on_failure` or limits of its own; otherwise `home` is enough."""

    home: Limits


class Ground(_Model):
    """What to explore."""

    area: tuple[tuple[float, float], ...] = Field(
        (), description="corners x, y of the area [m]; empty = all that can be reached"
    )
    minutes: float = Field(
        0.0, ge=0.0, le=1440.0, description="ends after about this long, the way home included; 0 = no limit"
    )
    until: float = Field(
        0.0, ge=0.0, le=1.0, description="ends when this share of the area is seen; 0 = all of it"
    )

    @field_validator("area")
    @classmethod
    def _has_corners(cls, area: tuple[tuple[float, float], ...]) -> tuple[tuple[float, float], ...]:
        if len(area) not in (0, *range(3, MOST_CORNERS + 1)):
            raise ValueError(f"an area has 3 to {MOST_CORNERS} corners")
        return area

    @model_validator(mode="after")
    def _a_share_of_something(self) -> Ground:
        if self.until > 0.0 and not self.area:
            raise ValueError("`until` needs an `area`")
        return self


class Lanes(_Model):
    """What to drive over in lanes."""

    area: tuple[tuple[float, float], ...] = Field(
        min_length=3, max_length=MOST_CORNERS, description="corners x, y of the area [m]"
    )
    swath: float = Field(
        2.0, ge=LEAST_SWATH, le=50.0, description="from one lane to the next, as wide as the sensor sees [m]"
    )
    minutes: float = Field(
        0.0, ge=0.0, le=1440.0, description="ends after about this long, the way home included; 0 = no limit"
    )


class Cover(_Step):
    """Drive over an area in lanes."""

    cover: Lanes


class Explore(_Step):
    """See all ground of an area."""

    explore: Ground


class AtDock(_Model):
    """Where base_link is when the robot is docked, in frame `map`."""

    x: float = Field(description="[m]")
    y: float = Field(description="[m]")
    yaw_deg: float = Field(description="heading [deg]")


class Dock(_Step):
    """Dock at a pose given by hand; `dock` alone goes where `/dock/pose` tells."""

    dock: AtDock | None


class Wait(_Step):
    """Stand for a while."""

    wait: Seconds = Field(description="[s]")


class Ask(_Step):
    """Wait for an operator's answer."""

    ask: Question


class Look(_Step):
    """Look somewhere."""

    look: Direction


class Record(_Step):
    """Keep what is recorded here."""

    record: Mark


class Photo(_Step):
    """Take a photo, with an id or an `on_failure` of its own; otherwise `photo` is enough."""

    photo: Nothing


class Posture(_Step):
    """Stand up or sit down, with an id or an `on_failure` of its own; otherwise `stand` and `sit` are enough."""

    posture: Literal["stand", "sit"]


class Rounds(_Model):
    """Steps that are done several times."""

    times: Annotated[int, Field(ge=1, le=1_000_000)] | Literal["forever"] = Field(
        description="how often, or `forever`"
    )
    steps: tuple[Step, ...] = Field(min_length=1)


class Loop(_Model):
    """Do steps several times."""

    loop: Rounds


def _kind(value: Any) -> str:
    if isinstance(value, str):
        return "word"
    keys = set(value) if isinstance(value, dict) else set(getattr(type(value), "model_fields", ()))
    found = sorted(keys & set(TAGS[1:]))
    return found[0] if len(found) == 1 else ""


TAGS = (
    "word",
    "goto",
    "home",
    "explore",
    "cover",
    "dock",
    "wait",
    "ask",
    "look",
    "record",
    "photo",
    "posture",
    "loop",
)
Step = Annotated[
    Annotated[Literal["stand", "sit", "home", "dock", "photo"], Tag("word")]
    | Annotated[Goto, Tag("goto")]
    | Annotated[GoHome, Tag("home")]
    | Annotated[Explore, Tag("explore")]
    | Annotated[Cover, Tag("cover")]
    | Annotated[Dock, Tag("dock")]
    | Annotated[Wait, Tag("wait")]
    | Annotated[Ask, Tag("ask")]
    | Annotated[Look, Tag("look")]
    | Annotated[Record, Tag("record")]
    | Annotated[Photo, Tag("photo")]
    | Annotated[Posture, Tag("posture")]
    | Annotated[Loop, Tag("loop")],
    Discriminator(
        _kind,
        custom_error_type="step",
        custom_error_message="a step is one of stand, sit, home, explore, cover, dock, goto, wait, ask, look, "
        "record, photo, posture, loop",
    ),
]
Rounds.model_rebuild()
Loop.model_rebuild()


class MissionFile(_Model):
    """A mission. Lengths in metres, angles in degrees, times in seconds."""

    name: str = Field("", max_length=100)
    map: str = Field(
        "",
        pattern=r"^(sha256:[0-9a-f]{16})?$",
        description="prior map it was made on, as `mission status` tells it; empty = any",
    )
    frame: Literal["map"] = Field(
        "map", description="frame of all places; others begin anew with every start"
    )
    on_failure: OnFailureText = Field("stop", description="what a step without its own `on_failure` does")
    on_comms_loss: Literal["continue", "hold", "return"] | None = Field(
        None,
        description="when no operator is in contact: go on, stand until one is, or come home until one is; "
        "None = comms.on_loss of the stack",
    )
    comms_timeout: float | None = Field(
        None,
        gt=0,
        le=86400,
        description="no operator is in contact after this long [s]; None = comms.timeout of the stack",
    )
    no_return: bool = Field(
        False, description="stay out although the battery will be needed for the way home"
    )
    home: Home | None = Field(None, description="where `home` and `return` go; None = the home of the run")
    steps: tuple[Step, ...] = Field(min_length=1)

    def order(self, order_id: str, *, update: int = 0, start: int = 1, owner: str = "") -> msg.MissionOrder:
        """rbtrg_msgs/MissionOrder that begins with step `start`, counted from 1 as `numbered` does."""
        steps: list[msg.MissionStep] = []
        loops: list[msg.MissionLoop] = []
        self._collect(self.steps, steps, loops)
        home = self.home
        return msg.MissionOrder(
            order_id=order_id,
            order_update_id=update,
            name=self.name,
            owner=owner,
            map=self.map,
            frame=self.frame,
            on_comms_loss=self.on_comms_loss or "",
            comms_timeout=self.comms_timeout or 0.0,
            no_return=self.no_return,
            start=start,
            has_home=home is not None,
            home_x=home.x if home else 0.0,
            home_y=home.y if home else 0.0,
            home_yaw=math.radians(home.yaw_deg) if home else 0.0,
            steps=steps,
            loops=loops,
        )

    def moved(self, places: Mapping[int, tuple[float, float]]) -> MissionFile:
        """With the places of some `goto` elsewhere: x, y [m] by the number of the step, counted from 1 as `numbered`
        does. Raises MissionError where that is no `goto`."""
        count, left = itertools.count(1), dict(places)

        def other(node: Any) -> Any:
            if isinstance(node, Loop):
                inner = tuple(map(other, node.loop.steps))
                return node.model_copy(update={"loop": node.loop.model_copy(update={"steps": inner})})
            number = next(count)
            if number not in left or not isinstance(node, Goto):
                return node
            x, y = left.pop(number)
            return node.model_copy(update={"goto": node.goto.model_copy(update={"x": x, "y": y})})

        found = self.model_copy(update={"steps": tuple(map(other, self.steps))})
        if left:
            raise MissionError(f"step {min(left)} is no `goto`: only places to go to can be moved")
        return found

    def _collect(
        self, tree: tuple[Step, ...], steps: list[msg.MissionStep], loops: list[msg.MissionLoop]
    ) -> None:
        for node in tree:
            if isinstance(node, Loop):
                times = 0 if node.loop.times == "forever" else node.loop.times
                loop = msg.MissionLoop(len(steps) + 1, 0, times)
                loops.append(loop)
                self._collect(node.loop.steps, steps, loops)
                loop.last = len(steps)
            else:
                steps.append(self._step(node, len(steps) + 1))

    def _step(self, node: Any, number: int) -> msg.MissionStep:
        if isinstance(node, str):
            plain: dict[str, Any] = {
                "home": GoHome(home=Limits()),
                "dock": Dock(dock=None),
                "photo": Photo(photo=Nothing()),
            }
            node = plain.get(node) or Posture(posture=node)  # type: ignore[arg-type]
        kind = node.posture if isinstance(node, Posture) else _kind(node)
        policy, _, retries = (node.on_failure or self.on_failure).partition(" ")
        return msg.MissionStep(
            id=node.id or f"{kind}-{number}",
            kind=kind,
            blocking_type=_blocking(node).value,
            on_failure=policy,
            retries=int(retries or 0),
            **_content(node),
        )


def _blocking(node: Any) -> Blocking:
    at_once = isinstance(node, Record) and node.record.seconds == 0
    return Blocking.NONE if at_once else Blocking.HARD


def _content(node: Any) -> dict[str, Any]:
    """Fields of rbtrg_msgs/MissionStep that a step of this kind has."""
    if isinstance(node, Goto):
        p = node.goto
        yaw = math.radians(p.yaw_deg) if p.yaw_deg is not None else 0.0
        return {
            "x": p.x,
            "y": p.y,
            "yaw": yaw,
            "has_yaw": p.yaw_deg is not None,
            "timeout": p.timeout,
            "accept_risk": p.accept_risk,
        }
    if isinstance(node, GoHome):
        return {"timeout": node.home.timeout, "accept_risk": node.home.accept_risk}
    if isinstance(node, Explore):
        ground = node.explore
        corners = np.array(ground.area, np.float64).reshape(-1)
        return {"area": corners, "duration": 60.0 * ground.minutes, "until": ground.until}
    if isinstance(node, Cover):
        over = node.cover
        corners = np.array(over.area, np.float64).reshape(-1)
        return {"area": corners, "duration": 60.0 * over.minutes, "swath": over.swath}
    if isinstance(node, Dock) and node.dock is not None:
        at = node.dock
        return {"x": at.x, "y": at.y, "yaw": math.radians(at.yaw_deg), "has_yaw": True}
    if isinstance(node, Wait):
        return {"duration": node.wait}
    if isinstance(node, Ask):
        return {"text": node.ask.question, "choices": list(node.ask.choices), "timeout": node.ask.timeout}
    if isinstance(node, Look):
        d = node.look
        return {
            "yaw": math.radians(d.yaw_deg),
            "pitch": math.radians(d.pitch_deg),
            "has_yaw": True,
            "duration": d.seconds,
        }
    if isinstance(node, Record):
        return {"text": node.record.name, "duration": node.record.seconds}
    return {}


def parse(values: Any, what: str) -> MissionFile:
    """From loaded YAML. Raises MissionError; `what` names the file in it."""
    if not isinstance(values, dict):
        raise MissionError(f"{what} is no mission: it must hold `key: value` lines, `steps` among them")
    try:
        return MissionFile.model_validate(values)
    except ValidationError as error:
        raise MissionError(f"{what}: {_explain(error)}") from error


def outing(
    kind: Literal["explore", "cover"], ground: dict[str, Any], *, back: bool, accept: bool
) -> MissionFile:
    """Explore `ground` (fields of `Ground`) or cover it (`Lanes`), and come `back`, with `accept` although the way is
    likely to fail. Raises MissionError."""
    steps: list[Any] = [{kind: ground, "on_failure": "skip" if back else "stop"}]
    if back:
        steps.append({"home": {"accept_risk": accept}, "on_failure": "retry 3"})
    return parse({"name": kind, "steps": steps, "no_return": not back}, kind)


def load(path: Path) -> MissionFile:
    """Read a file. Raises MissionError."""
    try:
        return parse(yaml_file.read(path), str(path))
    except OSError as error:
        raise MissionError(f"cannot read {path}: {error.strerror}") from error
    except YamlError as error:
        raise MissionError(f"{path} is not YAML: {error}") from error


def dump(mission: MissionFile) -> str:
    """YAML that `load` reads."""
    values = mission.model_dump(mode="json", exclude_defaults=True)
    text: str = yaml.dump(values, Dumper=_Dumper, sort_keys=False, allow_unicode=True)
    return text


class _Dumper(yaml.SafeDumper):
    """Puts text with line ends of other scripts (U+0085, U+2028) into double quotes: in others PyYAML makes spaces of
    them."""


def _text(dumper: _Dumper, text: str) -> yaml.ScalarNode:
    style = None if text.isprintable() else '"'
    return dumper.represent_scalar("tag:yaml.org,2002:str", text, style=style)


_Dumper.add_representer(str, _text)


def numbered(order: msg.MissionOrder) -> Iterator[str]:
    """The steps of an order in words, as `mission run --check` prints them."""
    for number, step in enumerate(order.steps, 1):
        opening = [loop for loop in order.loops if loop.first == number]
        for loop in opening:
            how_often = f"{loop.times} times" if loop.times else "for ever"
            yield f"     steps {loop.first} to {loop.last}, {how_often}:"
        yield f"{number:4d} {describe(step)}"


def describe(step: msg.MissionStep) -> str:
    """A step in a few words; its kind alone where that is none of ours."""
    words: dict[str, str] = {
        Kind.GOTO: f"goto {step.x:.2f} {step.y:.2f}"
        + (f" yaw {math.degrees(step.yaw):.0f} deg" if step.has_yaw else ""),
        Kind.DOCK: f"dock at {step.x:.2f} {step.y:.2f} yaw {math.degrees(step.yaw):.0f} deg"
        if step.has_yaw
        else "dock where /dock/pose tells",
        Kind.WAIT: f"wait {step.duration:g} s",
        Kind.ASK: f"ask {step.text!r} ({', '.join(step.choices)})",
        Kind.EXPLORE: "explore" + (f" an area of {len(step.area) // 2} corners" if len(step.area) else ""),
        Kind.COVER: f"cover an area of {len(step.area) // 2} corners in lanes {step.swath:g} m apart",
        Kind.RECORD: f"record {step.text}".strip(),
    }
    return words.get(step.kind, step.kind)


def _explain(error: ValidationError) -> str:
    first = error.errors()[0]
    parts = [part for part in first["loc"] if part not in TAGS]
    place = " ".join(
        f"step {part + 1}" if isinstance(part, int) else part for part in parts if part != "steps"
    )
    more = f" (and {error.error_count() - 1} more)" if error.error_count() > 1 else ""
    where = f"{place}: " if place else ""
    if first["type"] == "extra_forbidden":
        return f"{where}there is no such key; `rbtrg-robot mission schema` lists them{more}"
    if parts and parts[-1] == "on_failure":
        return f"{where}it is stop, skip, return or `retry N`, got {first['input']!r}{more}"
    return f"{where}{first['msg']}{more}"
