"""Nothing that comes over the bus ends the supervisor: what is no message is counted, told, and never handed on."""

from __future__ import annotations

from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest

from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.cli.table import render
from rbtrg_robot.config import load
from rbtrg_robot.process.events import Events
from rbtrg_robot.process.health import Health
from rbtrg_robot.process.supervisor import Supervisor
from rbtrg_robot.wire.bus import Received, Refusals
from rbtrg_robot.wire.convert import LayoutError, map_patch
from rbtrg_robot.wire.messages import PARALLEL, MessageError, array, decode, encode


class Inbox(Refusals):
    """A bus that brings what a test puts in."""

    def __init__(self) -> None:
        super().__init__()
        self.waiting: list[Received[Any]] = []
        self.published: list[tuple[t.Topic, Any]] = []

    def take(self, _timeout: float) -> list[Received[Any]]:
        taken, self.waiting = self.waiting, []
        return taken

    def publish(self, topic: t.Topic, message: Any, _stamp: int) -> None:
        self.published.append((topic, decode(encode(message), topic.kind)))

    def put(self, topic: t.Topic, payload: bytes) -> None:
        self.waiting.append(Received(topic, payload, 0, 0))


@pytest.fixture
def supervisor(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Supervisor:
    """One that has no processes to start: it only listens."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    made = Supervisor(load(record=False, log_dir=str(tmp_path)), None, print)  # type: ignore[arg-type]
    made._bus = Inbox()  # type: ignore[assignment]
    made._mend = made._measure = lambda: None  # type: ignore[method-assign]
    return made


def turn(supervisor: Supervisor, topic: t.Topic, payload: bytes) -> dict[str, Any]:
    supervisor._bus.put(topic, payload)  # type: ignore[attr-defined]
    supervisor._turn(Mock())
    return supervisor.status()


def unequal() -> msg.Heartbeat:
    return msg.Heartbeat(process="odometry", topic=["/odom", "/tf"], published=array([1], "uint64"))


def test_two_bytes_of_robot_state_leave_the_supervisor_up_and_are_not_kept(supervisor: Supervisor) -> None:
    status = turn(supervisor, t.ROBOT_STATE, b"\x00\x01")
    assert status["refused"] == 1
    assert supervisor._kept == {}  # a restarted robot process would be handed it again and again


def test_a_heartbeat_with_unequal_lists_leaves_the_supervisor_up(supervisor: Supervisor) -> None:
    status = turn(supervisor, t.HEARTBEAT, encode(unequal()))
    assert status["refused"] == 1
    assert supervisor._health.beats == {}


@pytest.mark.parametrize("topic", dict.fromkeys((*Health.WATCHED, *Events.HEARS)), ids=lambda x: x.name)
def test_no_mutation_of_a_watched_message_ends_the_supervisor(supervisor: Supervisor, topic: t.Topic) -> None:
    rng = np.random.default_rng(3)
    whole = encode(topic.kind())
    for _ in range(200):
        broken = bytearray(whole[: rng.integers(1, len(whole) + 1)])
        for place in rng.integers(0, len(broken), 3):
            broken[place] = rng.integers(0, 256)
        turn(supervisor, topic, bytes(broken))
    assert supervisor._bus.refused > 50
    assert len(supervisor._health.topics) <= len(t.TOPICS)
    assert supervisor._health.beats.keys() <= supervisor._children.keys()


def test_a_mission_of_an_unknown_phase_leaves_the_supervisor_up(supervisor: Supervisor) -> None:
    state = msg.MissionState(order_id="o", phase="dancing", step=9)
    assert turn(supervisor, t.MISSION_STATE, encode(state))["robot"]["mission"]["phase"] == "dancing"


def test_strangers_heartbeats_take_no_memory(supervisor: Supervisor) -> None:
    for number in range(100):
        name = f"stranger{number}"
        beat = msg.Heartbeat(
            process=name, topic=[name], published=array([1], "uint64"), newest=array([1], "int64")
        )
        turn(supervisor, t.HEARTBEAT, encode(beat))
    assert (supervisor._health.beats, supervisor._health.topics) == ({}, {})


def test_status_tells_who_refused_how_many(supervisor: Supervisor) -> None:
    turn(supervisor, t.ROBOT_STATE, b"\x00\x01")
    status = turn(supervisor, t.HEARTBEAT, encode(msg.Heartbeat(process="navigator", refused=7)))
    (line,) = [str(part) for part in render(status).renderables if "refused" in str(part)]
    assert line == "messages refused: navigator 7, supervisor 1"


@pytest.mark.parametrize("kind", PARALLEL, ids=lambda x: x.__name__)
def test_unequal_lists_are_as_broken_as_broken_bytes(kind: type[msg.Message]) -> None:
    for names in PARALLEL[kind]:
        for name in names:
            message = kind()
            blank = getattr(message, name)
            if name == "data":
                setattr(message, name, [msg.Float32MultiArray()])
            else:
                setattr(
                    message,
                    name,
                    [*blank, "x"] if isinstance(blank, list) else np.append(blank, blank.dtype.type(1)),
                )
            with pytest.raises(MessageError, match="differ in length"):
                decode(encode(message), kind)


@pytest.mark.parametrize(
    ("resolution", "length"), [(0.0, 1.0), (np.nan, 1.0), (-0.04, 1.0), (0.04, np.inf), (0.04, -1.0)]
)
def test_a_map_without_a_size_is_refused(resolution: float, length: float) -> None:
    info = msg.GridMapInfo(resolution=resolution, length_x=length, length_y=length)
    with pytest.raises(LayoutError):
        map_patch(msg.GridMap(info=info), 0)
