"""The bus: order, bounded inboxes, late joiners, deaths, and errors in words."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import replace

import pytest
import zenoh

from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.scope import Scope
from rbtrg_robot.wire import keys
from rbtrg_robot.wire.bus import Bus, BusError, Received
from rbtrg_robot.wire.messages import encode, header, stamp_of
from rbtrg_robot.wire.session import stack_id
from tools.bench.ports import free_endpoint


@pytest.fixture
def endpoint() -> str:
    """A free loopback endpoint."""
    return free_endpoint()


@pytest.fixture
def router(endpoint: str) -> Iterator[Bus]:
    """A router on it."""
    with Bus(endpoint, "supervisor", router=True) as bus:
        yield bus


def collect(bus: Bus, count: int, topic: t.Topic | None = None) -> list[Received]:
    """At least `count` messages, or what came in 30 s. `topic`: of this one alone."""
    got: list[Received] = []
    end = time.monotonic() + 30.0
    while time.monotonic() < end:
        got += [r for r in bus.take(0.1) if topic is None or r.topic.name == topic.name]
        if len(got) >= count:
            break
    return got


def test_what_shared_memory_lacks_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    """In a container whose filter forbids `mlock` the port was named instead."""

    def forbidden(_config: object) -> None:
        raise zenoh.ZError("Unable to create POSIX shm segment: OS error 1 at segment.rs:85.")

    monkeypatch.setattr(zenoh, "open", forbidden)
    with pytest.raises(BusError, match="mlock"):
        Bus(free_endpoint(), "supervisor", router=True)


def test_messages_arrive_in_order_with_stamp_and_sequence(router: Bus, endpoint: str) -> None:
    with Bus(endpoint, "a") as a, Bus(endpoint, "b") as b:
        b.subscribe([t.IMU, t.GOAL_STATUS])
        a.publish(t.GOAL_STATUS, t.GOAL_STATUS.kind(id="first"), 1)
        collect(b, 1)  # the subscription is known to the publisher's side
        got: list[Received] = []
        for begin in range(0, 100, 10):  # sensors' messages may be dropped from a long burst
            for i in range(begin, begin + 10):
                a.publish(t.IMU, t.IMU.kind(header=header(i, "base_link")), i)
            got += collect(b, 10)
    assert [r.stamp for r in got] == list(range(100))
    assert [r.sequence for r in got] == list(range(1, 101))
    assert [stamp_of(r.decode()) for r in got] == list(range(100))


def test_a_message_that_comes_under_the_key_of_another_topic_is_refused(
    router: Bus, endpoint: str, caplog: pytest.LogCaptureFixture
) -> None:
    """Zenoh 1.10 mixes keys up while sessions come back to a router that hung: the IMU's messages came as odometry;
    truth would decode as such."""
    payload = encode(msg.Odometry(header=header(5, "odom"), child_frame_id="base_link"))
    with Bus(endpoint, "a") as a, Bus(endpoint, "b") as b:
        b.subscribe([t.ODOM, t.GOAL_STATUS])
        under_odom = a.session.declare_publisher(keys.key(t.ODOM, a.scope))
        gids = {topic: keys.gid("token", keys.key(topic, a.scope), bytes(4)) for topic in (t.TRUTH, t.ODOM)}
        senders = [gids[t.TRUTH], gids[t.ODOM], bytes(16), gids[t.ODOM][:15] + b"?"]
        matched = threading.Event()
        listener = under_odom.declare_matching_listener(lambda _status: matched.set())
        assert under_odom.matching_status.matching or matched.wait(5.0)
        listener.undeclare()
        for number, gid in enumerate(senders, 1):
            under_odom.put(payload, attachment=keys.attachment(number, 5, gid))
        under_odom.put(payload)
        a.publish(t.GOAL_STATUS, msg.GoalStatus(header=header(5, "map"), id="last"), 5)
        got = collect(b, 4)
        assert [(x.topic, x.sequence) for x in got] == [
            (t.ODOM, 2),
            (t.ODOM, 3),
            (t.ODOM, 0),
            (t.GOAL_STATUS, 1),
        ]
        assert b.refused == 2
    assert "/odom: message refused (1 so far): a message of another topic" in caplog.text


def test_no_two_topics_have_the_same_mark() -> None:
    topics = [x for x in vars(t).values() if isinstance(x, t.Topic)]
    assert len({keys.mark(keys.key(topic, Scope())) for topic in topics}) == len(topics) > 40


def test_a_slow_reader_keeps_the_newest(router: Bus, endpoint: str) -> None:
    with Bus(endpoint, "a") as a, Bus(endpoint, "b") as b:
        b.subscribe([t.GOAL_STATUS, t.CMD_VEL])
        a.publish(t.GOAL_STATUS, t.GOAL_STATUS.kind(id="x"), 1)
        collect(b, 1)
        for i in range(49):
            a.publish(t.CMD_VEL, t.CMD_VEL.kind(header=header(i, "base_link")), i)
        seen: list[Received] = []
        # The two topics have queues of their own: either end may come first. On a computer that has no time for 20 ms
        # Zenoh drops the last of a
        # burst, so they are sent until they come.
        end = time.monotonic() + 20.0
        while time.monotonic() < end:
            a.publish(t.CMD_VEL, t.CMD_VEL.kind(header=header(49, "base_link")), 49)
            a.publish(t.GOAL_STATUS, t.GOAL_STATUS.kind(id="end"), 2)
            seen += b.take(1.0)
            if {(t.GOAL_STATUS, 2), (t.CMD_VEL, 49)} <= {(r.topic, r.stamp) for r in seen}:
                break
        else:
            pytest.fail("the newest never came")
    assert [r.stamp for r in seen if r.topic is t.CMD_VEL][-1] == 49


ROUTER = """
import sys
from rbtrg_robot.wire.bus import Bus
with Bus(sys.argv[1], "supervisor", router=True):
    print(flush=True)
    sys.stdin.read()
"""


def test_commands_wait_for_a_router_that_does_not_run_for_a_moment(endpoint: str) -> None:
    """A busy computer lost velocities and the guard's limits: two waited, the others were dropped."""
    words = t.HEARTBEAT.kind(detail="x" * 2900)  # short enough to go through the socket, which is full soon
    with subprocess.Popen(
        [sys.executable, "-c", ROUTER, endpoint], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as router:
        assert router.stdout is not None
        router.stdout.readline()
        with Bus(endpoint, "a") as a, Bus(endpoint, "b") as b:
            b.subscribe([replace(t.CMD_VEL, depth=100), t.HEARTBEAT])
            a.publish(t.CMD_VEL, t.CMD_VEL.kind(), 0)
            a.publish(t.HEARTBEAT, words, 0)
            collect(b, 2)
            os.kill(router.pid, signal.SIGSTOP)
            for _ in range(5000):
                a.publishers[t.HEARTBEAT].put(encode(words), 0)
            for i in range(1, 13):
                a.publish(t.CMD_VEL, t.CMD_VEL.kind(header=header(i, "base_link")), i)
            os.kill(router.pid, signal.SIGCONT)
            got = collect(b, 12, t.CMD_VEL)
        router.communicate(b"")
    assert [r.stamp for r in got] == list(range(1, 13))


def test_a_late_joiner_gets_the_latched_message(router: Bus, endpoint: str) -> None:
    with Bus(endpoint, "a") as a:
        a.publish(t.GOAL_STATUS, t.GOAL_STATUS.kind(id="old"), 1)
        a.publish(t.GOAL_STATUS, t.GOAL_STATUS.kind(id="newest"), 2)
        with Bus(endpoint, "b") as b:
            b.subscribe([t.GOAL_STATUS])
            assert [r.decode().id for r in collect(b, 1)] == ["newest"]


def test_the_death_of_a_process_is_seen(router: Bus, endpoint: str) -> None:
    changes: list[tuple[str, bool]] = []
    came, gone = threading.Event(), threading.Event()

    def changed(process: str, alive: bool) -> None:
        changes.append((process, alive))
        if process == "a":
            (came if alive else gone).set()

    router.watch_processes(changed)
    with Bus(endpoint, "a") as a:
        assert came.wait(10.0)
        assert "a" in a.processes()
        assert not gone.is_set()
    assert gone.wait(10.0)
    assert ("a", True) in changes


def test_a_foreign_node_of_the_same_name_changes_nothing(endpoint: str) -> None:
    """Any ROS node may be called tracker; its end is not the tracker's, and its life does not hide the tracker's
    death."""
    stack = stack_id()
    changes: list[tuple[str, bool]] = []
    turn = threading.Condition()

    def changed(process: str, alive: bool) -> None:
        with turn:
            changes.append((process, alive))
            turn.notify()

    def seen(*expected: tuple[str, bool]) -> None:
        with turn:
            assert turn.wait_for(lambda: changes == list(expected), 10.0), changes

    with Bus(endpoint, "supervisor", router=True, stack=stack) as watcher:
        watcher.watch_processes(changed)
        own = ("supervisor", True)
        with Bus(endpoint, "tracker", stack=stack):
            seen(own, ("tracker", True))
            with Bus(endpoint, "tracker"), Bus(endpoint, "end", stack=stack):
                seen(own, ("tracker", True), ("end", True))
            foreign = Bus(endpoint, "tracker")
            seen(own, ("tracker", True), ("end", True), ("end", False))
        seen(own, ("tracker", True), ("end", True), ("end", False), ("tracker", False))
        with Bus(endpoint, "tracker", stack=stack):  # started again
            seen(own, ("tracker", True), ("end", True), ("end", False), ("tracker", False), ("tracker", True))
            foreign.close()


def test_a_process_that_was_started_anew_lives_though_the_one_before_ends_late(endpoint: str) -> None:
    stack = stack_id()
    changes: list[bool] = []
    turn = threading.Condition()

    def changed(process: str, alive: bool) -> None:
        with turn:
            changes.extend([alive] * (process == "tracker"))
            turn.notify()

    def seen(*expected: bool) -> None:
        with turn:
            assert turn.wait_for(lambda: changes == list(expected), 10.0), changes

    with Bus(endpoint, "supervisor", router=True, stack=stack) as watcher:
        watcher.watch_processes(changed)
        before = Bus(endpoint, "tracker", stack=stack)
        seen(True)
        with Bus(endpoint, "tracker", stack=stack):
            seen(True, True)
            before.close()
            seen(True, True, False, True)
        seen(True, True, False, True, False)


@pytest.mark.parametrize(
    "scopes", [(Scope(1), Scope(2)), (Scope.of(0, "a"), Scope.of(0, "b")), (Scope.of(0, "a"), Scope())]
)
def test_robots_of_other_domains_or_names_share_a_router_and_hear_nothing_of_each_other(
    router: Bus, endpoint: str, scopes: tuple[Scope, Scope]
) -> None:
    stack = stack_id()
    one, other = scopes
    everybody = {"absent": {topic.owner for topic in t.TOPICS}}
    with (
        Bus(endpoint, "tracker", one, stack=stack, **everybody) as a,
        Bus(endpoint, "tracker", other, stack=stack, **everybody) as b,
    ):
        heard: list[tuple[str, bool]] = []
        b.watch_processes(lambda process, alive: heard.append((process, alive)))
        topics = [topic for topic in t.TOPICS if topic is not t.CLOCK]
        b.subscribe(topics)
        a.subscribe(topics)
        a.serve("status", lambda reply: reply(b"of a"))
        for topic in topics:
            a.publish(topic, topic.kind(), 1)
        assert {r.topic for r in collect(a, len(topics))} == set(topics), "its own robot hears everything"
        b.publish(t.GOAL_STATUS, t.GOAL_STATUS.kind(id="b"), 1)
        (own,) = collect(b, 1)
        assert own.decode().id == "b"
        assert b.ask("status", timeout=0.3) is None
        with Bus(endpoint, "cli", other) as asker:
            assert asker.processes() - {"supervisor"} == {"tracker", "cli"}
        a.close()
        assert b.take(0.3) == []
    assert heard[0] == ("tracker", True)
    assert ("tracker", False) not in heard, "the other robot's tracker is none of ours"


def test_queries_are_answered_and_time_out(router: Bus, endpoint: str) -> None:
    router.serve("status", lambda reply: reply(b"well"))
    with Bus(endpoint, "cli") as cli:
        assert cli.ask("status") == b"well"
        assert cli.ask("nobody", timeout=0.3) is None


def test_a_taken_port_and_a_missing_stack_are_told_in_words(router: Bus, endpoint: str) -> None:
    with pytest.raises(BusError, match="--port"):
        Bus(endpoint, "other", router=True)
    with pytest.raises(BusError, match="rbtrg-robot up"):
        Bus("tcp/127.0.0.1:9", "cli")


def test_a_second_node_of_the_same_robot_is_seen_and_that_of_another_robot_is_none(
    router: Bus, endpoint: str
) -> None:
    own, a = stack_id(), Scope.of(0, "a")
    with Bus(endpoint, "supervisor", a, stack=own) as first:
        with Bus(endpoint, "supervisor", Scope.of(0, "b"), stack=stack_id()) as other:
            assert not other.second("supervisor")
        with Bus(endpoint, "guard", a, stack=own) as guard:
            assert not guard.second("supervisor"), "its own supervisor"
        assert not first.second("supervisor")
        with Bus(endpoint, "supervisor", a, stack=stack_id()) as second:
            assert second.second("supervisor")
