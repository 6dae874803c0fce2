"""`goal --wait` that is interrupted, and `resume`, against a stack that answers as it is told to."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.process.runfiles import RunLock
from rbtrg_robot.wire.bus import Bus, Received, Reply
from rbtrg_robot.wire.messages import header
from tools.bench.ports import free_endpoint

LIMIT = 60.0
"""[s] until a command must have ended."""


class Stack:
    """A router with a run folder; commands find it there."""

    def __init__(self, bus: Bus) -> None:
        self.bus = bus

    def run(
        self, words: list[str], answer: Callable[[Received], None], interrupt: Callable[[], bool]
    ) -> tuple[int, str]:
        """Exit status and output of a command; it is interrupted once `interrupt()`."""
        child = subprocess.Popen(
            [sys.executable, "-m", "rbtrg_robot.cli", *words],
            env=dict(os.environ),
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        try:
            end = time.monotonic() + LIMIT
            told = False
            while child.poll() is None:
                assert time.monotonic() < end
                for received in self.bus.take(0.05):
                    answer(received)
                if interrupt() and not told:
                    told = True
                    child.send_signal(signal.SIGINT)
            assert child.stdout is not None
            return child.returncode, child.stdout.read()
        finally:
            child.kill()
            child.wait()


@pytest.fixture
def stack(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Stack]:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))  # others compile there: a command says so
    endpoint = free_endpoint()
    lock = RunLock("go2w")
    try:
        with Bus(endpoint, "stack", router=True) as bus:
            bus.subscribe([t.ROBOT_COMMAND, t.GOAL_REQUEST])
            lock.write_state(endpoint=endpoint, domain=0, ready=True, backend="sim", scene="flat")
            yield Stack(bus)
    finally:
        lock.release()


def test_an_interrupted_goal_is_cancelled(stack: Stack) -> None:
    requests: list[msg.GoalRequest] = []

    def answer(received: Received) -> None:
        requests.append(received.decode())
        last = requests[-1]
        status = msg.GoalStatus(header=header(1, "map"), id=requests[0].id, owner=last.owner)
        status.state = "cancelled" if last.action == 1 else "moving"
        stack.bus.publish(t.GOAL_STATUS, status, 1)

    code, said = stack.run(["goal", "1.0", "2.0", "--wait"], answer, lambda: bool(requests))
    assert code == 4, said
    assert said.splitlines() == ["cancelling the goal", "goal cancelled"]
    assert requests[-1].action == 1
    assert requests[-1].id == requests[0].id
    assert requests[-1].owner == requests[0].owner != ""


def test_a_goal_waits_until_the_stack_is_ready(stack: Stack) -> None:
    """The supervisor answers that the planner starts, three times; then that it runs."""
    asked, requests = list[bool](), list[bool]()

    def status(reply: Reply) -> None:
        asked.append(ready := len(asked) >= 3)
        rows = [{"process": "planner", "state": "ready" if ready else "starting"}]
        told = {"ready": ready, "compiling": "", "lacks": "planner has not started", "processes": rows}
        reply(json.dumps(told).encode())

    def answer(received: Received) -> None:
        requests.append(asked[-1])
        moving = msg.GoalStatus(header=header(1, "map"), id=received.decode().id, state="moving")
        stack.bus.publish(t.GOAL_STATUS, moving, 1)

    stack.bus.serve("status", status)
    code, said = stack.run(["goal", "1.0", "2.0"], answer, lambda: False)
    assert code == 0, said
    assert said.splitlines() == [
        "not ready yet, waiting up to 600 s: planner has not started",
        "goal moving",
    ]
    assert asked == [False, False, False, True]
    assert all(requests), "nothing is sent before"


@pytest.mark.parametrize(
    ("state", "code", "words"),
    [
        ("aborted", 0, "goal moving"),
        ("moving", 1, "rbtrg-robot: the goal is not over: it is moving"),
        pytest.param("reached", 1, "rbtrg-robot: the last goal was reached", marks=pytest.mark.campaign),
    ],
)
def test_a_goal_that_was_not_reached_is_sent_again(stack: Stack, state: str, code: int, words: str) -> None:
    requests: list[msg.GoalRequest] = []
    before = msg.GoalStatus(
        header=header(1, "map"), id="old", x=3.0, y=-1.0, yaw=0.5, has_yaw=True, state=state
    )

    def answer(received: Received) -> None:
        requests.append(received.decode())
        status = msg.GoalStatus(header=header(1, "map"), id=requests[-1].id, state="moving")
        stack.bus.publish(t.GOAL_STATUS, status, 1)

    def tell() -> bool:
        if not requests:
            stack.bus.publish(t.GOAL_STATUS, before, 1)
        return False

    got, said = stack.run(["goal", "--again"], answer, tell)
    assert (got, said.splitlines()) == (code, [words])
    if code == 0:
        assert requests[-1].id != "old"
        assert (requests[-1].x, requests[-1].y, requests[-1].yaw) == (3.0, -1.0, 0.5)
    else:
        assert requests == []


@pytest.mark.parametrize(
    ("states", "code", "words"),
    [
        ((0,), 0, "nothing to resume"),
        ((5, 0), 0, "resumed"),
        ((5, 7), 1, "stopped again: somebody else"),
    ],
)
def test_resume_names_what_it_releases(stack: Stack, states: tuple[int, ...], code: int, words: str) -> None:
    orders: list[msg.RobotCommand] = []

    def tell() -> bool:
        latch = states[-1] if orders else states[0]
        state = msg.RobotState(
            header=header(1, ""), latch=latch, estop=latch > 0, estop_cause="somebody else"
        )
        stack.bus.publish(t.ROBOT_STATE, state, 1)
        return False

    status, said = stack.run(["resume"], lambda received: orders.append(received.decode()), tell)
    assert status == code, said
    assert words in said
    assert {order.latch for order in orders} == ({5} if len(states) > 1 else set())
