"""A re-run of a live log: a process that is late, and whose newest message overtook others, is made again byte for
byte."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from hal.types import NS
from rbtrg_robot import topics as t
from rbtrg_robot.config import StackConfig, load
from rbtrg_robot.hosts.live import Node
from rbtrg_robot.hosts.lockstep import Lockstep, build_stages
from rbtrg_robot.hosts.offline import Window, rerun
from rbtrg_robot.log.film import film
from rbtrg_robot.log.picture import picture
from rbtrg_robot.log.read import CONFIG, Entry, first_of, read_run
from rbtrg_robot.log.write import LogWriter
from rbtrg_robot.processes import BY_NAME
from rbtrg_robot.topics import Topic
from rbtrg_robot.wire.bus import Received, Refusals
from rbtrg_robot.wire.messages import encode

LATE = 150
"""Recorded messages between two turns of the late process: about a third of a second."""

UP = 5_000 * 10**9
"""[ns] that the computer was up: a live recorder counts from there, simulated time from 0."""

START = 100 * 10**9
"""[ns] that the start of a stack may take: the recorder is one of the first."""


class LateBus(Refusals):
    """A bus whose inboxes keep the newest, as the live ones do, and whose reader comes late. What is published is
    kept."""

    def __init__(self, entries: list[Entry]) -> None:
        super().__init__()
        self._entries = deque(entries)
        self._wanted: dict[str, Topic] = {}
        self.published: list[tuple[Topic, bytes, int, int]] = []
        self.dropped = 0
        self.publishers: dict[Topic, Any] = {}
        self.overtaken = 0
        self.now = 0

    def clock(self) -> int:
        return self.now

    def advertise(self, _topic: Topic) -> None:
        pass

    def subscribe(self, wanted: Any) -> None:
        self._wanted |= {topic.name: topic for topic in wanted}

    def publish(self, topic: Topic, message: Any, stamp: int) -> None:
        number = 1 + sum(of is topic for of, *_ in self.published)
        self.published.append((topic, encode(message), stamp, number))

    @property
    def ended(self) -> bool:
        return not self._entries

    def take(self, _timeout: float) -> list[Received[Any]]:
        waiting: dict[str, deque[tuple[int, Received[Any]]]] = {}
        for number in range(min(LATE, len(self._entries))):
            entry = self._entries.popleft()
            self.now = entry.log_time
            topic = self._wanted.get(entry.topic)
            if topic is None:
                continue
            queue = waiting.setdefault(entry.topic, deque(maxlen=topic.depth))
            self.overtaken += len(queue) == topic.depth and topic is t.MAP_WINDOW
            queue.append((number, Received(topic, entry.data, entry.publish_time, entry.sequence)))
        return [
            received
            for _, received in sorted((pair for q in waiting.values() for pair in q), key=lambda p: p[0])
        ]


def drive(folder: Path) -> tuple[StackConfig, Path]:
    """Replanning while the map grows, recorded in lockstep."""
    config = load(
        None,
        ["recorder.profile=full", "planner.update_period=0.3", "sim.lidar_step=8"],
        scene="yard",
        map_file="",
        seed=3,
    )
    log = folder / "lockstep.mcap"
    with Lockstep(config, Lockstep.open_log(config, log)) as stack:
        stack.wait_ready()
        stack.send_goal(*config.load_scene().goals["a"][:2])
        stack.run(3.0)
    return config, log


@pytest.fixture(scope="module")
def live(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, int]:
    """A log as it would be if the planner had been a slow process, and how many windows overtook each other before
    it."""
    folder = tmp_path_factory.mktemp("live")
    config, log = drive(folder)
    (stage, _period) = build_stages(config, ["planner"])["planner"]
    stage.warm_up()
    bus: Any = LateBus([entry for entry in read_run(log) if t.BY_NAME[entry.topic] not in stage.outputs])
    node = Node(BY_NAME["planner"], stage, bus, simulated=True)
    node.run(lambda: bus.ended)
    out = folder / "live.mcap"
    with LogWriter(out, {}, {CONFIG: first_of(log).attachments[CONFIG]}) as writer:
        writer.write(t.DIAGNOSTICS, encode(t.DIAGNOSTICS.kind()), UP - START, 1, 1)
        for entry in read_run(log):
            topic = t.BY_NAME[entry.topic]
            if topic not in stage.outputs:
                writer.write(topic, entry.data, UP + entry.log_time, entry.publish_time, entry.sequence)
        for topic, payload, stamp, number in bus.published:
            if topic is not t.HEARTBEAT:
                writer.write(topic, payload, UP + stamp, stamp, number)
    return out, bus.overtaken


def of(log: Path, topic: Topic) -> list[bytes]:
    return [entry.data for entry in read_run(log) if entry.topic == topic.name]


def test_a_slow_planner_is_run_again_to_the_same_bytes(live: tuple[Path, int], tmp_path: Path) -> None:
    log, overtaken = live
    assert overtaken > 10
    said: list[str] = []
    rerun(log, ["planner"], tmp_path / "again.mcap", say=said.append)
    assert not said
    for topic in (t.PLAN, t.ROUTE, t.ROUTE_REPORT, t.ROUTE_STATUS):
        assert of(log, topic), topic.name
        assert of(tmp_path / "again.mcap", topic) == of(log, topic), topic.name
    last = max(entry.log_time for entry in read_run(log))
    for entry in read_run(tmp_path / "again.mcap"):
        assert UP - START <= entry.log_time <= last, "the log and its simulated clock show other dates"


def test_a_part_of_a_live_log_is_run_again_and_that_once_more(live: tuple[Path, int], tmp_path: Path) -> None:
    """A stage that begins in the middle numbers its messages anew: what its process took tells no order any more."""
    log, _ = live
    said: list[str] = []
    first = rerun(log, ["planner"], tmp_path / "part.mcap", start_offset=START / NS + 1.5, say=said.append)
    again = rerun(tmp_path / "part.mcap", ["planner"], tmp_path / "twice.mcap", say=said.append)
    assert not said
    assert 10 < first[t.MAP_UPDATE.name] < len(of(log, t.MAP_UPDATE))
    assert first[t.ROUTE_STATUS.name] > 5
    assert first == again
    assert of(tmp_path / "twice.mcap", t.ROUTE_STATUS) == of(tmp_path / "part.mcap", t.ROUTE_STATUS)


def test_of_a_part_nothing_behind_its_end_is_read() -> None:
    read = []

    def entries() -> Iterator[Entry]:
        for second in range(100):
            read.append(second)
            yield Entry(t.ODOM.name, t.ODOM.type, b"", second * NS, 0, 0)

    within = Window(0, 10.0, 5.0)
    assert [entry.log_time // NS for entry in within.entries(entries())] == [10, 11, 12, 13, 14, 15]
    assert read[-1] == 16


def test_what_the_log_lacks_is_told_and_the_rest_goes_on(live: tuple[Path, int], tmp_path: Path) -> None:
    log, _ = live
    holed = tmp_path / "holed.mcap"
    updates = 0
    with LogWriter(holed, {}, {CONFIG: first_of(log).attachments[CONFIG]}) as writer:
        for entry in read_run(log):
            topic = t.BY_NAME[entry.topic]
            updates += topic is t.MAP_UPDATE
            if not (topic is t.MAP_UPDATE and updates in (20, 21)):
                writer.write(topic, entry.data, entry.log_time, entry.publish_time, entry.sequence)
    said: list[str] = []
    counts = rerun(holed, ["planner"], tmp_path / "again.mcap", say=said.append)
    assert said == ["2 messages that planner took are not in the log: from there on its re-run may differ"]
    assert counts[t.ROUTE_STATUS.name] == len(of(log, t.ROUTE_STATUS))


def test_broken_messages_in_a_log_end_no_rerun_and_no_picture(tmp_path: Path) -> None:
    """Each process refuses them, too."""
    config = load(None, ["recorder.profile=full", "sim.lidar_step=8"], scene="flat")
    log = tmp_path / "log.mcap"
    with Lockstep(config, Lockstep.open_log(config, log)) as stack:
        stack.wait_ready()
    hostile = tmp_path / "hostile.mcap"
    broken = (b"", b"\0", b"\0\1\0\0" + b"\xff" * 3)
    with LogWriter(hostile, {}, {CONFIG: config.to_yaml().encode()}) as writer:
        for entry in read_run(log):
            topic = t.BY_NAME[entry.topic]
            writer.write(topic, entry.data, entry.log_time, entry.publish_time, entry.sequence)
            for data in broken:
                writer.write(topic, data, entry.log_time, entry.publish_time, 0)
    counts = rerun(hostile, ["odometry", "elevation", "guard"], tmp_path / "again.mcap")
    assert counts[t.ODOM.name] > 2
    assert film(hostile, tmp_path / "end.png") > 2
    assert picture(hostile, tmp_path / "run.png") < 0.1
