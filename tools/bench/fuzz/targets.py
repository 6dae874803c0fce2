"""Who takes messages: every stage, the supervisor, the console, the recorder, replay and `log check`."""

from __future__ import annotations

import asyncio
import json
import math
from collections.abc import Callable
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Protocol

from hal.types import NS
from rbtrg_robot import topics as t
from rbtrg_robot.config import StackConfig, load
from rbtrg_robot.console.app import Site
from rbtrg_robot.console.desk import Desk, Page
from rbtrg_robot.console.feed import HEARD, Feed, Slots
from rbtrg_robot.hosts.lockstep import build_stages
from rbtrg_robot.hosts.robot import build
from rbtrg_robot.log.read import LogError
from rbtrg_robot.log.recorder import Recorder
from rbtrg_robot.log.replay import Controls, play
from rbtrg_robot.log.stats import summarize
from rbtrg_robot.log.write import LogWriter
from rbtrg_robot.process.health import Health
from rbtrg_robot.process.supervisor import Supervisor
from rbtrg_robot.processes import BY_NAME, PROCESSES
from rbtrg_robot.stages.stage import Stage
from rbtrg_robot.topics import Role, Topic
from rbtrg_robot.wire.bus import Received, Refusals
from rbtrg_robot.wire.messages import MessageError, decode, encode, stamp_in

Samples = dict[Topic, list[bytes]]


def newest_stamp(samples: Samples) -> int:
    """Where the clock of the recorded drive ended [ns]."""
    return max(stamp_in(payload, t.CLOCK.type) for payload in samples[t.CLOCK])


FILE_MESSAGES = 200
"""Messages of one log that replay and `log check` read."""


class Target(Protocol):
    """Something that takes what comes."""

    inputs: tuple[Topic, ...]

    def take(self, topic: Topic, payload: bytes) -> None:
        """One message as its process would take it."""

    def turn(self, now: int) -> None:
        """What its process does between messages; `now` [ns]."""

    def close(self) -> None:
        """Release what was opened."""


class OneStage:
    """A stage behind the wire. It begins with sound messages, so that it has something to lose."""

    def __init__(self, stage: Stage, samples: Samples, restores: tuple[Topic, ...] = ()) -> None:
        """`restores`: topics whose newest messages are handed to it after a restart."""
        self._stage = stage
        self.inputs = tuple(dict.fromkeys([*stage.inputs, *restores]))
        stage.warm_up()
        sound = [(topic, payload) for topic in stage.inputs for payload in samples[topic]]
        for topic, payload in sound:
            self.take(topic, payload)

    def take(self, topic: Topic, payload: bytes) -> None:
        """A message that is none is counted by the host and not handed on."""
        try:
            message = decode(payload, topic.kind)
        except MessageError:
            return
        self._send(self._stage.on(topic, message))

    def turn(self, now: int) -> None:
        """A tick."""
        self._send(self._stage.tick(now))

    def _send(self, outputs: list[tuple[Topic, Any]]) -> None:
        for _, message in outputs:
            encode(message)

    def close(self) -> None:
        """End the stage."""
        self._stage.close()


class StubBus(Refusals):
    """A bus that brings what is put in and drops what goes out."""

    def __init__(self) -> None:
        super().__init__()
        self.waiting: list[Received[Any]] = []

    def take(self, _timeout: float) -> list[Received[Any]]:
        """What was put in."""
        taken, self.waiting = self.waiting, []
        return taken

    def publish(self, _topic: Topic, message: Any, _stamp: int) -> None:
        """It must be a message."""
        encode(message)

    def advertise(self, _topic: Topic) -> StubBus:
        """Itself: it is a publisher too."""
        return self

    def put(self, _payload: bytes, _stamp: int) -> None:
        """Away with it."""

    def wake(self) -> None:
        """It never sleeps."""


class TheSupervisor:
    """The supervisor without processes to start."""

    inputs: tuple[Topic, ...] = tuple(
        dict.fromkeys([*Health.WATCHED, *(topic for row in PROCESSES for topic in row.restores)])
    )

    def __init__(self, _config: StackConfig, _samples: Samples, folder: Path) -> None:
        config = load(None, [], record=False, log_dir=str(folder), robot=f"fuzz{folder.name}")
        made: Any = Supervisor(config, None, lambda _text: None)  # type: ignore[arg-type]
        self._bus = made._bus = StubBus()
        made._mend = made._measure = lambda: None
        nothing: Any = lambda *_, **__: None  # noqa: E731 - no file
        made._latch = SimpleNamespace(follow=nothing)
        made._mission = SimpleNamespace(write=nothing)
        made._write_state = lambda lock: None
        self._supervisor = made

    def take(self, topic: Topic, payload: bytes) -> None:
        """One turn with one message in it."""
        self._bus.waiting.append(Received(topic, payload, 0, 0))
        self._supervisor._turn(None)

    def turn(self, now: int) -> None:
        """`status` and `diagnostics` as people ask for them."""
        self._supervisor._diagnosis_due = 0.0
        self._supervisor._turn(None)

    def close(self) -> None:
        """Nothing to release."""


class TheConsole:
    """The console with one page that looks, asks, and says what nobody understands."""

    inputs: tuple[Topic, ...] = tuple(dict.fromkeys([*HEARD, *Desk.HEARS]))

    def __init__(self, config: StackConfig, samples: Samples, _folder: Path) -> None:
        bus: Any = StubBus()
        self._loop = asyncio.new_event_loop()
        self._feed = Feed(bus, config.capabilities(), self._loop)
        self._desk = Desk(config, bus, self._feed, self._loop)
        door: Any = None  # nobody comes in: the page is there already
        self._site = Site(config, door, self._desk, self._feed, self._loop)
        self._slots = Slots(self._feed)
        self._page = Page(1, Role.OPERATOR, self._slots)
        self._slots.cloud = True
        self._feed.join(self._slots)
        self._wishes = 0
        for topic in self.inputs:
            for payload in samples[topic]:
                self.take(topic, payload)

    def take(self, topic: Topic, payload: bytes) -> None:
        """One message as `Serving.turn` hands it on."""
        received = Received(topic, payload, 0, 0)
        if topic in Desk.HEARS:
            self._desk.take(received)
        if topic in HEARD:
            self._feed.take(received)
        self._site._hear(self._page, self._slots, payload[:200].decode("latin1"))

    def turn(self, now: int) -> None:
        """The page asks for something and takes all frames."""
        self._desk.tick()
        self._feed.tick(now / NS)
        self._loop.run_until_complete(asyncio.sleep(0))
        self._feed.terrain_for(self._slots)
        while self._slots.take() is not None:
            pass
        self._wishes += 1
        wish = WISHES[self._wishes % len(WISHES)]
        self._site._hear(self._page, self._slots, json.dumps(wish))

    def close(self) -> None:
        """End the loop."""
        for task in (tasks := asyncio.all_tasks(self._loop)):
            task.cancel()
        self._loop.run_until_complete(asyncio.wait(tasks) if tasks else asyncio.sleep(0))
        self._loop.close()


WISHES: tuple[dict[str, Any], ...] = (
    {"do": "goal", "n": 1, "x": 2.0, "y": 0.5},
    {"do": "ask", "n": 2, "x": 2.0, "y": 0.5, "graph": True},
    {"do": "drive", "v": 0.2, "w": -0.1, "t": 0},
    {"do": "cancel", "n": 3},
    {"do": "stop"},
    {"do": "resume", "n": 4},
    {"do": "posture", "n": 5, "what": "stand"},
    {"do": "goal", "n": [], "x": None, "y": "1e999"},
)
"""What a page says, one each turn."""


class TheRecorder:
    """It writes what it does not read."""

    inputs: tuple[Topic, ...] = tuple(topic for topic in t.TOPICS if topic.recorded)

    def __init__(self, config: StackConfig, _samples: Samples, folder: Path) -> None:
        self._now = NS
        params = config.recorder.model_copy(update={"rotate_megabytes": 20, "keep_gb": 0.05, "spare_gb": 0.0})
        clock: Any = lambda: self._now  # noqa: E731 - a clock that stands still between turns
        self._recorder = Recorder(folder / "run", params, {}, {}, clock)
        self._folder = folder
        self._number = 0

    def take(self, topic: Topic, payload: bytes) -> None:
        """With a stamp and a sequence that came in a strange attachment."""
        self._number += 1
        strange = (0, -1, 2**63 - 1, -(2**63), self._now)[self._number % 5]
        self._recorder.write(topic, payload, strange, strange)

    def turn(self, now: int) -> None:
        """Flush, rotate, look at the disk; old files go."""
        self._now = now
        self._recorder.housekeep()
        for old in sorted((self._folder / "run").glob("*.mcap"), key=lambda p: p.stat().st_mtime)[:-3]:
            old.unlink()

    def close(self) -> None:
        """Write the index."""
        self._recorder.close()


class AFile:
    """Somebody who reads logs: of broken messages, and logs that are broken themselves."""

    inputs: tuple[Topic, ...] = TheRecorder.inputs

    def __init__(
        self, read: Callable[[Path], object], _config: StackConfig, _samples: Samples, folder: Path
    ) -> None:
        self._read = read
        self._path = folder / "fuzz.mcap"
        self._writer: LogWriter | None = None
        self._count = 0

    def take(self, topic: Topic, payload: bytes) -> None:
        """Into the file; a full one is read whole, then with a hole, then cut."""
        if self._writer is None:
            self._writer = LogWriter(self._path, {})
        self._writer.write(topic, payload, self._count * NS // 100, self._count, self._count)
        self._count += 1
        if self._count % FILE_MESSAGES:
            return
        self._writer.close()
        self._writer = None
        self._read(self._path)
        whole = self._path.read_bytes()
        at = 7919 * self._count % len(whole)
        for data in (whole[:at] + bytes(16) + whole[at + 16 :], whole[:at]):
            self._path.write_bytes(data)
            try:
                self._read(self._path)
            except LogError:
                continue
        self._path.unlink()

    def turn(self, now: int) -> None:
        """Nothing."""

    def close(self) -> None:
        """Drop the last file."""
        if self._writer is not None:
            self._writer.close()


def _play(path: Path) -> None:
    bus: Any = StubBus()
    play(bus, path, controls=Controls(rate=math.inf), check=lambda: None, patterns=["*"])


def _check(path: Path) -> None:
    summarize(path).problems()


def _stage(name: str, config: StackConfig, samples: Samples, _folder: Path) -> Target:
    restores = BY_NAME[name].restores
    if name == "robot":
        robot = OneStage(build(config), samples, restores)
        for now in range(0, newest_stamp(samples), NS):  # the simulator does not jump
            robot.turn(now)
        return robot
    return OneStage(build_stages(config, [name])[name][0], samples, restores)


TARGETS: dict[str, Callable[[StackConfig, Samples, Path], Target]] = {
    **{row.name: partial(_stage, row.name) for row in PROCESSES if row.hosted or row.name == "robot"},
    "supervisor": TheSupervisor,
    "console": TheConsole,
    "recorder": TheRecorder,
    "replay": partial(AFile, _play),
    "log_check": partial(AFile, _check),
}
