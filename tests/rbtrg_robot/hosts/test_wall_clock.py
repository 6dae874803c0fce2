"""A wall clock that is set while the stack runs on hardware: nothing but the stamps of logs may hang on it."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hal.lidar.config import only
from hal.safety.gate import SafetyGate
from hal.types import NS
from hal.unitree.api import SPORT, Sport
from hal.unitree.config import UnitreeConfig
from rbtrg_robot import topics as t
from rbtrg_robot.config import load
from rbtrg_robot.hosts import robot as robot_process
from rbtrg_robot.hosts.live import Node
from rbtrg_robot.processes import BY_NAME
from rbtrg_robot.stages.robot import RobotStage
from rbtrg_robot.topics import Topic
from rbtrg_robot.wire import clock as clock_module
from rbtrg_robot.wire.bus import Received, Refusals
from rbtrg_robot.wire.clock import SourceClock
from rbtrg_robot.wire.convert import odometry_msg
from rbtrg_robot.wire.messages import encode, header, stamp_of
from tests.hal.unitree.world import HOST_EPOCH, World
from tests.rbtrg_robot.hearsay import all_clear

ROOT = Path(__file__).parents[3]
HOUR = 3600 * NS


class Time:
    """`time`, as far as the source clock asks it."""

    def __init__(self) -> None:
        self.elapsed = 0
        self.step = 0

    def monotonic_ns(self) -> int:
        return 7 * NS + self.elapsed

    def time_ns(self) -> int:
        return HOST_EPOCH + self.elapsed + self.step


@pytest.fixture
def clocks(monkeypatch: pytest.MonkeyPatch) -> Time:
    """Both clocks of the computer."""
    made = Time()
    monkeypatch.setattr(clock_module, "time", made)
    return made


class FakeBus(Refusals):
    """Moves the time on whenever something waits for messages; `hear` gives what comes in."""

    def __init__(self, clocks: Time, advance: Callable[[float], None]) -> None:
        super().__init__()
        self.clock = SourceClock()
        self.publishers: dict[Topic, Any] = {}
        self.dropped = 0
        self.waiting = False
        self.sent: list[tuple[int, Topic, Any]] = []
        self.hear: Callable[[], list[tuple[Topic, Any]]] = list
        self._clocks, self._advance = clocks, advance

    def take(self, timeout: float) -> list[Received]:
        self._advance(timeout)
        self._clocks.elapsed += round(timeout * NS)
        return [Received(topic, encode(message), stamp_of(message), 0) for topic, message in self.hear()]

    def publish(self, topic: Topic, message: Any, _stamp: int) -> None:
        self.sent.append((self._clocks.elapsed, topic, message))

    def advertise(self, topic: Topic) -> None:
        pass

    def subscribe(self, wanted: Any) -> None:
        pass

    def wake(self) -> None:
        pass

    def watch_processes(self, changed: Callable[..., None]) -> None:
        for name in BY_NAME:
            changed(name, True)


def test_the_robot_drives_on_and_says_so_when_the_wall_clock_is_set(
    clocks: Time, monkeypatch: pytest.MonkeyPatch
) -> None:
    world = World(options=UnitreeConfig(lidars=only("xt16")))
    monkeypatch.setattr(robot_process, "_hardware", lambda _config, _clock: world.backend)
    bus = FakeBus(clocks, world.advance)

    def hear() -> list[tuple[Topic, Any]]:
        command = t.CMD_VEL.kind(header=header(bus.clock(), "base_link"))
        command.twist.linear.x = 0.5
        pose = odometry_msg(
            bus.clock(), np.zeros(3), (0, 0, 0, 1), np.array([world.body.v, 0, 0]), np.zeros(3)
        )
        return [(t.CMD_VEL, command), (t.POSE, pose), (t.MOTION_LIMITS, all_clear(bus.clock()))]

    bus.hear = hear
    set_at, end = 4 * NS, 8 * NS

    def stopping() -> bool:
        if clocks.elapsed >= set_at:  # back, and then far ahead
            clocks.step = -HOUR if clocks.elapsed < set_at + 2 * NS else HOUR
        return clocks.elapsed >= end

    config = load(None, ["backend=unitree", "interface=lo", "record=false"])
    speeds: list[float] = []
    driven = world.backend.drive
    monkeypatch.setattr(world.backend, "drive", lambda c: (driven(c), speeds.append(world.body.v)))
    monkeypatch.setattr(robot_process, "keep_what_is_loaded", lambda: None)  # pytest goes on
    robot_process.main(config, bus, stopping, {})  # type: ignore[arg-type]
    after = [m for at, topic, m in bus.sent if topic is t.ROBOT_STATE and set_at < at < end - NS]
    assert len(after) >= 28, "ten a second"
    assert {m.hold for m in after} == {""}
    assert {m.phase for m in after} == {"moving"}
    stamps = [stamp_of(m) for _, topic, m in bus.sent if topic is t.ROBOT_STATE]
    assert stamps == sorted(stamps)
    assert stamps[-1] - stamps[0] < end
    moves = [
        at
        for at, service, request in world.sent
        if (service, request.api) == (SPORT, Sport.MOVE) and set_at < at < end - NS
    ]
    assert max(np.diff(moves)) < 0.1 * NS
    assert min(speeds[len(speeds) // 2 : -200]) > 0.4


class Counter:
    """A stage that notes when it is ticked."""

    inputs = ()
    outputs = ()

    def __init__(self) -> None:
        self.ticks: list[int] = []

    def warm_up(self) -> None:
        pass

    def close(self) -> None:
        pass

    def on(self, _topic: Topic, _message: Any) -> list[Any]:
        return []

    def tick(self, now: int) -> list[Any]:
        self.ticks.append(now)
        return []


@pytest.mark.parametrize("step", [-HOUR, HOUR])
def test_stages_are_ticked_on_and_never_see_the_step(step: int, clocks: Time) -> None:
    stage, bus = Counter(), FakeBus(clocks, lambda _seconds: None)
    node = Node(BY_NAME["navigator"], stage, bus, simulated=False)  # type: ignore[arg-type]

    def stopping() -> bool:
        if clocks.elapsed >= 2 * NS:
            clocks.step = step
        return clocks.elapsed >= 4 * NS

    node.run(stopping)
    assert len(stage.ticks) == 40
    assert set(np.diff(stage.ticks)) == {NS // 10}
    beats = [stamp_of(m) for _, topic, m in bus.sent if topic is t.HEARTBEAT]
    assert beats == sorted(beats)


def test_all_processes_of_a_stack_share_one_clock(clocks: Time) -> None:
    first = SourceClock()
    clocks.elapsed, clocks.step = 5 * NS, -HOUR
    restarted = SourceClock(first.offset)
    assert restarted() == first() == HOST_EPOCH + 5 * NS


@pytest.mark.parametrize("ahead", [1.0, 3600.0])
def test_a_pose_from_the_future_is_none(ahead: float) -> None:
    world = World(epoch=0)
    stage = RobotStage(
        world.backend, SafetyGate(world.backend.capabilities), simulated=False, watched=frozenset()
    )
    stage.warm_up()
    now = world.now
    for at, checked in ((now, True), (now + round(ahead * NS), False), (now - NS, False)):
        pose = odometry_msg(at, np.zeros(3), (0, 0, 0, 1), np.zeros(3), np.zeros(3))
        stage.on(t.POSE, pose)
        stage.tick(now)
        assert stage._inputs(now, world.backend.state()).velocity == ((0.0, 0.0, 0.0) if checked else None)


WALL = re.compile(r"\btime\.time(_ns)?\b|datetime\.(now|utcnow|today)|time\.(localtime|strftime|ctime)")
READERS = {
    "rbtrg_robot/wire/clock.py": "once, at the start",
    "hal/unitree/backend.py": "default of a parameter; the stack gives its own clock",
    "hal/unitree/factory.py": "the same",
    "hal/unitree/low/backend.py": "the same",
    "rbtrg_robot/cli": "stamps of requests, names of folders",
    "rbtrg_robot/orders": "stamps of requests; their deadlines are on the monotonic clock",
    "rbtrg_robot/console": "stamps of requests, until when a cookie holds; ages are on the monotonic clock",
    "rbtrg_robot/bridge": "stamps of requests",
    "rbtrg_robot/access/certificates.py": "from when to when a certificate holds",
    "rbtrg_robot/process/doctor.py": "shows the date",
    "rbtrg_robot/process/report.py": "dates the archive",
}
"""Who may read the wall clock, and for what."""


def test_nothing_else_reads_the_wall_clock() -> None:
    found = {
        path.relative_to(ROOT).as_posix()
        for floor in ("hal", "mapping", "planning", "rbtrg_robot")
        for path in (ROOT / floor).rglob("*.py")
        if WALL.search(path.read_text())
    }
    assert {path for path in found if not any(path.startswith(reader) for reader in READERS)} == set()
