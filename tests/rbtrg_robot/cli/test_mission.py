"""`mission` against the mission process alone: every command, its exit status and its words."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from rbtrg_robot import topics as t
from rbtrg_robot.cli.main import app
from rbtrg_robot.hosts.live import Node
from rbtrg_robot.missions.file import load
from rbtrg_robot.process.runfiles import RunLock
from rbtrg_robot.processes import BY_NAME
from rbtrg_robot.stages.mission.executor import MissionStage
from rbtrg_robot.wire.bus import Bus
from rbtrg_robot.wire.convert import odometry_msg, rpy_quaternion
from tests.rbtrg_robot.hearsay import map_offset
from tools.bench.ports import free_endpoint

LIMIT = 30.0


@pytest.fixture
def bus(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Bus]:
    """The bus of a stack that is one mission process, where the commands find it."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    endpoint = free_endpoint()
    lock, done = RunLock("go2w"), threading.Event()
    with Bus(endpoint, "stack", router=True) as router, Bus(endpoint, "mission") as own:
        lock.write_state(endpoint=endpoint, domain=0, ready=True, backend="sim", scene="flat")
        router.subscribe([t.PRESENCE, t.MISSION_STATE])
        node = Node(BY_NAME["mission"], MissionStage(), own, simulated=False)
        thread = threading.Thread(target=node.run, args=(done.is_set,))
        thread.start()
        try:
            yield router
        finally:
            done.set()
            thread.join()
            lock.release()


def call(*words: str, code: int = 0, typed: str = "") -> str:
    result = CliRunner().invoke(app, ["mission", *words], input=typed, catch_exceptions=False)
    assert result.exit_code == code, result.output
    return result.output


def wait_for(bus: Bus, condition: Callable[[Any], bool]) -> None:
    end = time.monotonic() + LIMIT
    while True:
        for received in bus.take(0.1):
            if received.topic is t.MISSION_STATE and condition(bus.open(received)):
                return
        assert time.monotonic() < end


@pytest.fixture
def file(tmp_path: Path) -> Callable[[str], str]:
    def write(steps: str, more: str = "") -> str:
        path = tmp_path / "m.yaml"
        path.write_text(f"name: round\n{more}\nsteps: {steps}\n")
        return str(path)

    return write


def test_a_mission_is_run_interrupted_answered_and_ended(bus: Bus, file: Callable[..., str]) -> None:
    assert call("status") == "no mission\n"
    assert "no mission is under way" in call("pause", code=2)
    name = file("[{ask: {question: 'open?'}}, {wait: 1000}, {wait: 0.1}]", "on_comms_loss: hold")
    assert "   2 wait 1000 s" in call("run", name, "--check")
    assert "it will hold unless" in call("run", name)
    assert "under way" in call("run", name, code=2)
    wait_for(bus, lambda s: s.question == "open?")
    assert "mission answer yes|no" in call("status")
    assert "none of yes, no" in call("answer", "perhaps", code=2)
    call("answer", "yes")
    wait_for(bus, lambda s: s.step == 2)
    assert "paused" in call("pause")
    call("resume")
    assert "step 3 of 3" in call("skip")
    wait_for(bus, lambda s: s.phase == "finished")
    found = json.loads(call("status", "--json"))
    assert found["actionStates"][0] == {
        "actionId": "ask-1",
        "actionType": "ask",
        "actionStatus": "FINISHED",
        "resultDescription": "answered 'yes'",
    }
    call("run", file("[{wait: 1000}]"))
    assert "stopped by" in call("stop")


def test_to_wait_tells_how_it_ended_and_is_contact(bus: Bus, file: Callable[..., str]) -> None:
    output = call("run", file("[sit, {wait: 0.1}]", "on_failure: skip"), "--wait", "--at", "2")
    assert "mission round finished" in output
    asked = file("[{ask: {question: a, timeout: 0.3}}]")
    assert "no answer within 0.3 s" in call("run", asked, "--wait", code=3)
    assert any(received.topic is t.PRESENCE for received in bus.take(0.1))


def test_what_cannot_be_done_or_read_is_refused_in_one_line(
    bus: Bus, file: Callable[..., str], tmp_path: Path
) -> None:
    assert "step 1 (look): the robot process does not turn" in call("run", file("[{look: {}}]"), code=2)
    assert "up --map" in call("run", file("[sit]", "map: sha256:0123456789abcdef"), code=2)
    assert call("status") == "no mission\n"


def test_ctrl_c_pauses_a_mission_that_is_waited_for(bus: Bus, file: Callable[..., str]) -> None:
    words = ["mission", "run", file("[{wait: 1000}]"), "--wait"]
    child = subprocess.Popen(
        [sys.executable, "-m", "rbtrg_robot.cli", *words],
        env=dict(os.environ),
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    try:
        wait_for(bus, lambda s: s.phase == "running")
        assert child.stdout is not None
        child.send_signal(signal.SIGINT)
        assert child.wait(LIMIT) == 4
        assert "paused by" in child.stdout.read()
    finally:
        child.kill()
        child.wait()


def test_a_drive_is_recorded_and_converted(bus: Bus, tmp_path: Path) -> None:
    target, drawn, again = (tmp_path / name for name in ("a.yaml", "a.geojson", "b.yaml"))
    done = threading.Event()

    def drive() -> None:
        while not done.wait(0.02):
            stamp = time.time_ns()
            bus.publish(t.TF_STATIC, map_offset(1.0, 0.0, 0.0), stamp)
            odom = odometry_msg(stamp, (2.0, 3.0, 0.0), rpy_quaternion((0, 0, 0)), (0,) * 3, (0,) * 3)
            bus.publish(t.ODOM, odom, stamp)

    thread = threading.Thread(target=drive)
    thread.start()
    try:
        recorder = subprocess.Popen(
            [sys.executable, "-m", "rbtrg_robot.cli", "mission", "record", str(target), "--name", "a"],
            env=dict(os.environ),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        assert recorder.stdin is not None
        assert recorder.stdout is not None
        answer = recorder.stdout.readline()
        while not answer.startswith("step 1"):  # until the pose is known
            recorder.stdin.write("\n")
            recorder.stdin.flush()
            answer = recorder.stdout.readline()
            assert answer
        recorder.stdin.write("wait 5\nq\n")
        recorder.stdin.flush()
        assert recorder.wait(LIMIT) == 0
    finally:
        done.set()
        thread.join()
        recorder.kill()
        recorder.wait()
    order = load(target).order("o")
    assert (order.steps[0].x, order.steps[0].y, order.steps[-1].duration) == (3.0, 3.0, 5.0)
    call("convert", str(target), str(drawn), "--origin", "31.0", "121.0", "0")
    call("convert", str(drawn), str(again), "--origin", "31.0", "121.0", "0")
    assert load(again).order("o").steps[0].x == pytest.approx(3.0, abs=1e-6)
    assert json.loads(call("schema"))["title"] == "MissionFile"


def test_home_is_shown_and_put_elsewhere(bus: Bus) -> None:
    frame = map_offset()
    bus.publish(t.TF_STATIC, frame, time.time_ns())

    def home(*words: str) -> str:
        return CliRunner().invoke(app, ["home", *words], catch_exceptions=False).output

    wait_for(bus, lambda state: state.has_home)
    assert home("show") == "home is at 0.00 0.00, heading 0 deg\n"
    assert home("set", "--yaw", "90", "2", "-3.5") == "home is at 2.00 -3.50, heading 90 deg\n"
    assert "home is X Y in metres" in str(CliRunner().invoke(app, ["home", "set", "1"]).exception)
