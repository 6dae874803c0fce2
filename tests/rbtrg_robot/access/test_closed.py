"""With a real robot the bus gives all rights to its own user alone: other users of the computer look and stop."""

from __future__ import annotations

import time
from collections.abc import Iterator
from itertools import count
from pathlib import Path

import pytest

from rbtrg_robot import topics as t
from rbtrg_robot.access import certificates
from rbtrg_robot.access.identity import client_tls
from rbtrg_robot.access.serve import security
from rbtrg_robot.config import StackConfig, load
from rbtrg_robot.run_folder import UnsafeFolder, bus_socket
from rbtrg_robot.topics import Role
from rbtrg_robot.wire.bus import Bus
from rbtrg_robot.wire.messages import encode
from rbtrg_robot.wire.session import Security
from tools.bench.ports import free_port

LIMIT = 20.0
STAMPS = count(1)
"""One for each sender: what came late is of the one before."""
INPUTS = [topic for topic in t.TOPICS if not topic.owner]


@pytest.fixture
def config(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> StackConfig:
    """Of a stack with a real robot that serves people outside as well."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    base = tmp_path / "keys"
    certificates.make_authority(base, 2)
    certificates.add(base, "anna", Role.OPERATOR, 2)
    network = {"listen": [f"tls/127.0.0.1:{free_port()}"], "keys": str(base / "robot")}
    return load(backend="unitree", interface="lo", port=free_port(), network=network)


@pytest.fixture
def router(config: StackConfig) -> Iterator[Bus]:
    """The supervisor's."""
    with Bus(config.endpoint, "supervisor", router=True, security=security(config)) as bus:
        bus.serve("status", lambda reply: reply(b"well"))
        yield bus


def heard(robot: Bus, sender: Bus, wanted: set[t.Topic]) -> set[t.Topic]:
    """What of INPUTS comes from a sender until all that is wanted came three times; the stop comes last, and before all
    others, which it overtakes."""
    for topic in INPUTS:
        sender.advertise(topic)
    came: set[t.Topic] = set()
    end, stamp = time.monotonic() + LIMIT, next(STAMPS)
    for _ in range(3):
        again: set[t.Topic] = set()
        while not again >= wanted and time.monotonic() < end:
            for topic in [*(x for x in INPUTS if x is not t.ROBOT_STOP), t.ROBOT_STOP]:
                sender.advertise(topic).put(encode(topic.kind()), stamp)
            again |= {received.topic for received in robot.take(0.3) if received.stamp == stamp}
        came |= again
    return came


def test_the_user_may_all_others_look_and_stop_and_people_outside_do_what_their_role_says(
    config: StackConfig, router: Bus
) -> None:
    with (
        Bus(config.endpoint, "robot") as robot,
        Bus(config.endpoint, "console") as own,
        Bus(config.public, "rviz") as other,
    ):
        robot.subscribe(INPUTS)
        assert heard(robot, own, set(INPUTS)) == set(INPUTS)
        assert heard(robot, other, {t.ROBOT_STOP}) == {t.ROBOT_STOP}
        assert other.ask("status") == b"well"
        other.subscribe([t.ROBOT_STATE])
        robot.publish(t.ROBOT_STATE, t.ROBOT_STATE.kind(), 1)
        end = time.monotonic() + LIMIT
        while not other.take(0.2):
            assert time.monotonic() < end
        tls = Security(client_tls(Path(config.network.keys).parent / "anna"))
        with Bus(config.network.listen[0], "cli", security=tls) as anna:
            allowed = {topic for topic in INPUTS if topic.publish_by}
            assert heard(robot, anna, allowed) == allowed


def test_nobody_else_opens_the_socket(config: StackConfig, router: Bus) -> None:
    assert config.endpoint == f"unixsock-stream/{bus_socket(config.robot)}"
    assert bus_socket(config.robot).is_socket()
    assert bus_socket(config.robot).parent.stat().st_mode & 0o077 == 0


def test_a_folder_too_deep_for_a_socket_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    deep = tmp_path / ("x" * 100)
    deep.mkdir()
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(deep))
    with pytest.raises(UnsafeFolder, match="XDG_RUNTIME_DIR to a shorter one"):
        load(backend="unitree", interface="lo").endpoint  # noqa: B018
    assert load().endpoint


def test_a_simulated_robot_one_with_an_open_bus_and_one_that_joins_use_the_port() -> None:
    assert load().endpoint == "tcp/127.0.0.1:7447"
    for network in ({"open_bus": True}, {"join": True}):
        config = load(backend="unitree", interface="lo", network=network)
        assert config.endpoint == config.public == "tcp/127.0.0.1:7447"
        assert security(config) is None


def test_without_people_outside_the_bus_is_closed_all_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    config = load(backend="unitree", interface="lo", port=free_port())
    with (
        Bus(config.endpoint, "supervisor", router=True, security=security(config)),
        Bus(config.endpoint, "robot") as robot,
        Bus(config.public, "rviz") as other,
    ):
        robot.subscribe(INPUTS)
        assert heard(robot, other, {t.ROBOT_STOP}) == {t.ROBOT_STOP}
