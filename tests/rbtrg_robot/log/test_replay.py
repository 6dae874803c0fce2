"""A log on the bus: nothing that moves a robot, and nothing at all beside one."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import Any

import pytest
from mcap.records import Channel, Schema

from rbtrg_robot import topics as t
from rbtrg_robot.config import load
from rbtrg_robot.console.child import play_run
from rbtrg_robot.log.read import Entry
from rbtrg_robot.log.replay import Controls, ReplayError, alone, play
from rbtrg_robot.log.write import LogWriter
from rbtrg_robot.process.router import open_bus
from rbtrg_robot.process.runfiles import RobotTaken, RunLock
from rbtrg_robot.wire.bus import Bus
from rbtrg_robot.wire.messages import encode, header
from rbtrg_robot.wire.session import stack_id
from tests.rbtrg_robot.conftest import Here
from tools.bench.ports import free_endpoint

LONG = 50_000_000_000
"""[ns] that a replay waits: less than LONGEST_PAUSE."""


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """One message of each topic, then nothing for long."""
    path = tmp_path / "log_0.mcap"
    with LogWriter(path, {}) as writer:
        for topic in t.TOPICS:
            writer.write(topic, encode(topic.kind()), 1, 1, 1)
        writer.write(t.IMU, encode(t.IMU.kind(header=header(1, "base_link"))), LONG, LONG, 2)
    return path


def heard(there: Bus, bus: Bus, last: t.Topic[Any]) -> list[t.Topic[Any]]:
    """What comes up to a message of `last`, which is sent until it comes."""
    topics: list[t.Topic[Any]] = []
    for _ in range(200):
        bus.publish(last, last.kind(), 1)
        topics += [received.topic for received in there.take(0.05)]
        if last in topics:
            return topics
    raise AssertionError


def test_whatever_a_log_calls_its_topics_nothing_moves_a_robot(tmp_path: Path) -> None:
    path, endpoint = tmp_path / "a.mcap", free_endpoint()
    unsafe = [topic for topic in t.TOPICS if not topic.safe_to_replay]
    with LogWriter(path, {}) as writer:
        stamp = 2**64 - 1  # no stamp on the wire is so late: this ended the replay
        writer.write(t.ODOM, encode(t.ODOM.kind()), 1, stamp, 1)
        for number, topic in enumerate(unsafe, 2):
            for name in (
                topic.name,
                topic.name.removeprefix("/"),
                f"//{topic.name}",
                f"/x/..{topic.name}",
                f"{topic.name}/",
            ):
                entry = Entry(name, topic.type, encode(topic.kind()), 1, 1, 1)
                writer.copy(
                    entry,
                    Schema(number, b"", "ros2msg", topic.type),
                    Channel(number, name, "cdr", {}, number),
                )
    with Bus(endpoint, "tracker", router=True) as there, Bus(endpoint, "replay") as bus:
        there.subscribe(t.TOPICS)
        heard(there, bus, t.CLOCK)
        report = play(
            bus, path, controls=Controls(), check=alone(bus), patterns=["*", "/cmd_vel", "/robot/*"]
        )
        assert set(heard(there, bus, t.DIAGNOSTICS)) - {t.CLOCK} == {t.ODOM, t.DIAGNOSTICS}
    assert report.messages == 1
    assert len(report.skipped) == 5 * len(unsafe)


def test_a_robot_that_comes_ends_the_replay(log: Path) -> None:
    endpoint = free_endpoint()
    came = []
    with Bus(endpoint, "replay", router=True) as bus:
        check = alone(bus)
        playing = threading.Event()

        def robot() -> None:
            playing.wait(10.0)
            came.append(Bus(endpoint, "robot"))

        thread = threading.Thread(target=robot)
        thread.start()
        try:
            with pytest.raises(ReplayError, match="a robot is live"):
                play(
                    bus,
                    log,
                    controls=Controls(),
                    check=check,
                    patterns=["*"],
                    progress=lambda *_: playing.set(),
                )
        finally:
            thread.join()
            came[0].close()
        with pytest.raises(ReplayError):
            check()  # for good: it may be restarting


def test_beside_a_robot_nothing_is_played_in_the_console_either(log: Path) -> None:
    endpoint = free_endpoint()
    with Bus(endpoint, "robot", router=True) as there:
        there.subscribe([t.ODOM])
        with pytest.raises(ReplayError, match="--without robot"):
            play_run(endpoint, "0", str(log), "1", "0")
        assert there.take(0.0) == []


def test_a_robot_whose_process_is_down_comes_back(here: Here, log: Path) -> None:
    lock = RunLock("go2w")
    try:
        for processes, words in (
            (["planner", "robot"], "a simulated robot is live"),
            (["planner"], "nothing answers"),
        ):
            lock.write_state(
                endpoint=free_endpoint(), domain=0, ready=True, backend="sim", scene="", processes=processes
            )
            ended = here("replay", str(log))
            assert ended.returncode == 1
            assert words in ended.stderr
    finally:
        lock.release()


def test_no_stack_joins_a_router_that_a_log_is_played_on() -> None:
    endpoint = free_endpoint()
    config = load(None, ["network.join=true"], port=int(endpoint.rpartition(":")[2]))
    with (
        Bus(endpoint, "replay", router=True),
        pytest.raises(RobotTaken, match="a log is played"),
        open_bus(config, stack=stack_id()),
    ):
        pass


def test_stamps_that_roll_over_are_not_waited_for(tmp_path: Path) -> None:
    path = tmp_path / "log_0.mcap"
    with LogWriter(path, {}) as writer:
        for log_time in (10**9, 2**64 - 1, 10**9 + 1):
            writer.write(t.ODOM, encode(t.ODOM.kind()), log_time, 1, 1)
    with Bus(free_endpoint(), "replay", router=True) as bus:
        report = play(bus, path, controls=Controls(), check=alone(bus), patterns=["*"])
    assert report.messages == 3
    assert [round(gap / 3.15e7) for _, gap in report.jumps] == [586, -586]
    assert report.seconds < 1.0
