"""What the supervisor makes of a process that ends: start it again, give it up, or end `up`."""

from __future__ import annotations

import errno
import json
import os
import socket
import subprocess
import threading
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import ExitStack
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from hal.types import NS
from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.config import load
from rbtrg_robot.process import supervisor as module
from rbtrg_robot.process import zygote as zygote_module
from rbtrg_robot.process.child import FATAL, PASSING
from rbtrg_robot.process.events import Events
from rbtrg_robot.process.supervisor import StartFailed, Supervisor
from rbtrg_robot.process.zygote import Zygote, ZygoteError
from rbtrg_robot.processes import PROCESSES
from rbtrg_robot.wire.bus import Bus, Refusals
from rbtrg_robot.wire.convert import odometry_msg, transform_msg
from rbtrg_robot.wire.messages import array, header, stamp_of
from tools.bench.ports import free_port


class Scripted:
    """A zygote whose processes end as the script says: exit status and last words, or None for one that stays."""

    def __init__(self, script: list[tuple[int, str] | None]) -> None:
        self.script = script
        self.started = 0
        self.asked: list[tuple[str, bool]] = []
        """Process, and whether the first goal waits for it."""

    def fork(self, specification: dict[str, Any], log_path: Path) -> Scripted:
        self.started += 1
        self.asked.append((specification["process"], specification["hurry"]))
        self.end = self.script.pop(0)
        if self.end is not None:
            log_path.write_text(f"error: {self.end[1]}\n")
        return self

    pid = os.getpid()

    def poll(self) -> int | None:
        return None if self.end is None else self.end[0]


AWAY = (PASSING, "no LowState: is the cable in?")


def supervised(
    folder: Path, script: list[tuple[int, str] | None], process: str = "robot"
) -> tuple[Supervisor, Scripted, list[str]]:
    """A supervisor of one process alone, what starts it, and what the supervisor says."""
    zygote, said = Scripted(script), list[str]()
    others = tuple(p.name for p in PROCESSES if p.name != process)
    on = {"record": process == "recorder", "loops": {"online": process == "loops"}}
    config = load(without=others, log_dir=str(folder), **on)
    made: Any = Supervisor(config, zygote, said.append)  # type: ignore[arg-type]
    made._bus = Refusals()  # a bus on which nothing comes
    return made, zygote, said


def mend(supervisor: Supervisor) -> dict[str, Any]:
    """One turn without waiting for the backoff; the row of the process."""
    (child,) = supervisor._children.values()
    child.due = 0.0
    supervisor._mend()
    row: dict[str, Any] = supervisor.status()["processes"][0]
    return row


def test_a_robot_process_that_starts_while_the_cable_is_out_comes_back_with_the_robot(tmp_path: Path) -> None:
    supervisor, zygote, said = supervised(tmp_path, [(-9, "")] + [AWAY] * 12 + [None])
    supervisor._ready = True
    for _ in range(14):
        row = mend(supervisor)  # start
        if zygote.end is not None:
            row = mend(supervisor)  # notice the end
            assert row["state"].startswith("restarting")
    assert zygote.started == 14
    assert row["state"] == f"starting: {AWAY[1]}"
    beat = t.HEARTBEAT.kind(
        header=header(1, ""), process="robot", pid=0, state="ready", detail="", dropped=0,
        topic=[], published=array([], "uint64"), newest=array([], "int64"), longest_turn=0.0,
    )  # fmt: skip
    supervisor._health.take(t.HEARTBEAT, beat)
    row = mend(supervisor)
    assert (row["state"], row["restarts"]) == ("ready", 13)
    assert zygote.started == 14
    loss = PROCESSES[0].loss
    assert said == [
        f"robot ended (signal SIGKILL); restarting in 0.2 s: {loss}",
        f"robot ended ({AWAY[1]}); restarting in 0.5 s: {loss}",
        "robot runs again",
    ]


def test_a_supervisor_that_was_stopped_itself_ends_nobody_for_the_silence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    supervisor, zygote, said = supervised(tmp_path, [None, None])
    supervisor._ready = True
    now = 1000.0
    monkeypatch.setattr("time.monotonic", lambda: now)
    killed: list[float] = []
    monkeypatch.setattr(zygote, "kill", lambda: killed.append(now), raising=False)
    monkeypatch.setattr(zygote, "wait", lambda: None, raising=False)
    mend(supervisor)
    for _ in range(40):
        now += 0.1
        supervisor._health.take(t.HEARTBEAT, t.HEARTBEAT.kind(process="robot", state="ready"))
        mend(supervisor)
    now += 15.0
    for _ in range(58):
        mend(supervisor)
        now += 0.1
    assert killed == []
    assert said == ["the supervisor was held up for 15.0 s"]
    for _ in range(10):  # it is silent all the same
        mend(supervisor)
        now += 0.1
    assert killed
    assert "robot hangs; killing it" in said


HANG = {
    "robot": 3.0, "odometry": 3.0, "elevation": 15.0, "planner": 30.0, "navigator": 3.0,
    "mission": 3.0, "tracker": 3.0, "guard": 3.0, "recorder": 3.0, "camera": 60.0, "console": 5.0, "loops": 60.0,
}  # fmt: skip
"""How long each process may be silent [s]."""


@pytest.mark.parametrize("name", [p.name for p in PROCESSES])
def test_a_process_that_hangs_is_ended_after_its_time_and_started_anew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    supervisor, zygote, said = supervised(tmp_path, [None, None], name)
    supervisor._ready = True
    now = 1000.0
    monkeypatch.setattr("time.monotonic", lambda: now)
    monkeypatch.setattr(zygote, "kill", lambda: setattr(zygote, "end", (-9, "")), raising=False)
    monkeypatch.setattr(zygote, "wait", lambda: None, raising=False)
    mend(supervisor)
    supervisor._health.take(t.HEARTBEAT, t.HEARTBEAT.kind(process=name, state="ready"))
    while now < 1000.0 + HANG[name]:
        mend(supervisor)
        assert said == []
        now += 0.1
    for _ in range(4):
        now += 0.1
        mend(supervisor)
    assert zygote.started == 2
    assert said[0] == f"{name} hangs; killing it"
    assert said[1].startswith(f"{name} ended (signal SIGKILL); restarting in 0.2 s: ")


def test_a_process_that_still_compiles_is_not_taken_for_one_that_hangs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    supervisor, zygote, said = supervised(tmp_path, [None, None])
    supervisor._ready = True
    now = 1000.0
    monkeypatch.setattr("time.monotonic", lambda: now)
    monkeypatch.setattr(zygote, "kill", lambda: setattr(zygote, "end", (-9, "")), raising=False)
    monkeypatch.setattr(zygote, "wait", lambda: None, raising=False)
    mend(supervisor)
    (child,) = supervisor._children.values()

    def seconds(count: int, share: float) -> None:
        nonlocal now
        child.usage = SimpleNamespace(cpu_percent=lambda: share, memory_info=lambda: SimpleNamespace(rss=0))  # type: ignore[assignment]
        for _ in range(count):
            now += 1.0
            child.measure()
            mend(supervisor)

    seconds(300, 20.0)  # on a computer that others use as well
    for _ in range(100):  # a robot that waits for others
        supervisor._health.take(t.HEARTBEAT, t.HEARTBEAT.kind(process="robot", state="starting"))
        seconds(1, 0.0)
    supervisor._health.forget("robot")
    seconds(1, 20.0)
    seconds(28, 0.0)
    assert said == []
    seconds(4, 0.0)
    assert said[0] == "robot hangs; killing it"


def ready(process: str) -> Any:
    return t.HEARTBEAT.kind(header=header(1, ""), process=process, state="ready")


def test_where_kernels_are_compiled_the_planner_has_a_core_to_itself(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    started: list[str] = []
    stays = SimpleNamespace(pid=os.getpid(), poll=lambda: None)
    zygote: Any = SimpleNamespace(fork=lambda spec, _log: started.append(spec["process"]) or stays)
    supervisor: Any = Supervisor(load(log_dir=str(tmp_path)), zygote, print)
    supervisor._bus = Refusals()
    supervisor._compiling = SimpleNamespace(cold=True)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1})
    supervisor._mend()
    wanted = {p.name for p in PROCESSES} - set(load().absent)
    assert wanted - set(started) == {"elevation", "odometry", "robot"}
    assert {row["state"] for row in supervisor.status()["processes"]} == {"starting"}
    for compiled, then in (("guard", "elevation"), ("elevation", "odometry"), ("odometry", "robot")):
        supervisor._mend()
        assert then not in started
        supervisor._health.take(t.HEARTBEAT, ready(compiled))
        supervisor._mend()
        assert started[-1] == then
    assert sorted(started) == sorted(wanted)
    kept: Any = Supervisor(load(log_dir=str(tmp_path)), zygote, print)
    kept._compiling = SimpleNamespace(cold=False)
    started.clear()
    kept._mend()
    assert len(started) == len(wanted), "all at once"


def test_the_console_is_told_when_it_serves_whoever_else_compiles(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    supervisor, zygote, said = supervised(tmp_path, [None], "console")
    monkeypatch.setattr(supervisor, "_write_state", lambda _lock: None)
    monkeypatch.setattr(supervisor, "_missing", lambda: "the planner has not started")
    monkeypatch.setattr(module, "console_address", lambda *_, **__: "http://there")
    monkeypatch.setattr(zygote, "mend", lambda: False, raising=False)
    monkeypatch.setattr(zygote, "reap", lambda _known: None, raising=False)
    heard: list[Any] = []
    supervisor._bus = SimpleNamespace(  # type: ignore[assignment]
        take=lambda _limit: heard,
        open=lambda received: received.message,
        publish=lambda *_: None,
        intrusion=lambda: "",
        refused=0,
    )
    supervisor._turn(None)  # type: ignore[arg-type]
    assert said == []
    heard.append(SimpleNamespace(topic=t.HEARTBEAT, payload=b"", message=ready("console")))
    for _ in range(2):
        supervisor._turn(None)  # type: ignore[arg-type]
    assert said == ["console: http://there"]
    assert not supervisor.status()["ready"]


def test_who_asks_is_told_the_stop_that_was_told_before_however_slow_the_supervisor_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    config = load(
        without=tuple(p.name for p in PROCESSES), record=False, log_dir=str(tmp_path), port=free_port()
    )
    zygote: Any = SimpleNamespace(mend=lambda: False, reap=lambda _known: None)
    supervisor = Supervisor(config, zygote, lambda _: None)
    turned, go_on, over = threading.Event(), threading.Event(), threading.Event()

    def hold(_status: dict[str, Any]) -> None:
        turned.set()
        go_on.wait(20.0)

    with ThreadPoolExecutor(2) as pool, ExitStack() as ending:
        running = pool.submit(supervisor.run, over.is_set, hold)
        ending.callback(go_on.set)
        ending.callback(over.set)
        assert turned.wait(20.0)
        robot = ending.enter_context(Bus(config.endpoint, "robot", config.scope))
        cli = ending.enter_context(Bus(config.endpoint, "cli", config.scope))
        cli.subscribe([t.ROBOT_STATE])
        for latched in (False, True, False, True):
            robot.publish(t.ROBOT_STATE, msg.RobotState(estop=latched), 1)
            assert [received.decode().estop for received in cli.take(20.0)] == [latched]
            answer = pool.submit(cli.ask, "status", timeout=20.0)
            wait([answer], 0.1)  # one that was kept from before would come meanwhile
            go_on.set()
            told = json.loads(answer.result() or b"{}")
            go_on.clear()
            assert told["robot"]["estop"] is latched
        with Bus(config.endpoint, "gone", config.scope) as gone:
            assert gone.ask("status", timeout=0.1) is None
        turned.clear()
        go_on.set()
        assert turned.wait(20.0), "who asked and left ends nothing"
        over.set()
        running.result()


def test_the_process_that_starts_the_others_is_asked_each_second_and_a_new_one_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    supervisor, zygote, said = supervised(tmp_path, [])
    now = 1000.0
    asked: list[float] = []
    monkeypatch.setattr("time.monotonic", lambda: now)
    monkeypatch.setattr(zygote, "mend", lambda: asked.append(now) or len(asked) == 2, raising=False)
    monkeypatch.setattr(zygote, "reap", lambda _known: None, raising=False)
    for tenth in range(31):
        now = 1000.0 + tenth / 10
        supervisor._measure()
    assert asked == pytest.approx([1000.0, 1001.0, 1002.0, 1003.0], abs=0.11)
    assert said == ["the process that starts the others ended; there is a new one, and the robot drives on"]


def test_what_a_restart_cannot_mend_is_given_up(tmp_path: Path) -> None:
    supervisor, zygote, said = supervised(tmp_path, [(FATAL, "there is no scene 'yrad'")])
    supervisor._ready = True
    for _ in range(5):
        row = mend(supervisor)
    assert zygote.started == 1
    assert row["state"] == "failed: there is no scene 'yrad'"
    assert said == ["robot gave up: there is no scene 'yrad'"]


def test_a_computer_without_memory_for_a_process_keeps_the_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    supervisor, zygote, said = supervised(tmp_path, [(-9, ""), None])
    supervisor._ready = True
    mend(supervisor)
    mend(supervisor)
    plain = zygote.fork

    def full(*_: Any) -> Scripted:
        raise ZygoteError("cannot start processes")

    monkeypatch.setattr(zygote, "fork", full)
    for _ in range(3):
        assert mend(supervisor)["state"].startswith("restarting")
    monkeypatch.setattr(zygote, "fork", plain)
    assert mend(supervisor)["state"].startswith("starting")
    assert said[1:] == ["robot cannot be started (cannot start processes); trying again"]


def test_what_no_first_goal_needs_is_compiled_once_the_stack_is_ready(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    supervisor, zygote, _said = supervised(tmp_path, [None] * 3, "planner")
    monkeypatch.setattr(supervisor, "_missing", lambda: "")
    monkeypatch.setattr(supervisor, "_write_state", lambda _lock: None)
    supervisor._compiling.cold = True
    (planner,) = supervisor._children.values()
    supervisor._spawn(planner)
    supervisor._look(None)  # type: ignore[arg-type]
    supervisor._spawn(planner)
    assert zygote.asked == [("planner", True), ("kernels", False), ("planner", False)]


def test_a_zygote_that_finds_no_memory_is_replaced_later(monkeypatch: pytest.MonkeyPatch) -> None:
    made: Any = Zygote.__new__(Zygote)
    made._socket, theirs = socket.socketpair()
    made._process = subprocess.Popen(["/bin/true"])
    made._process.wait()
    with monkeypatch.context() as full:

        def popen(*_: Any, **__: Any) -> None:
            raise BlockingIOError(errno.EAGAIN, os.strerror(errno.EAGAIN))

        full.setattr(zygote_module.subprocess, "Popen", popen)
        assert made.mend() is False
        assert made.mend() is False
        with pytest.raises(ZygoteError, match="cannot start processes"):
            made.fork({}, Path("x.log"))
    theirs.close()
    made._socket.close()


@pytest.mark.parametrize("end", [AWAY, (FATAL, "there is no scene 'yrad'")])
def test_before_the_stack_was_ready_the_first_word_ends_it(tmp_path: Path, end: tuple[int, str]) -> None:
    supervisor, zygote, _said = supervised(tmp_path, [end])
    mend(supervisor)
    with pytest.raises(StartFailed, match=end[1].replace("?", r"\?")):
        mend(supervisor)
    assert zygote.started == 1


def test_what_happens_is_said_once() -> None:
    said: list[str] = []
    events = Events(said.append)
    goal, mission, elevation = t.GOAL_STATUS.kind, t.MISSION_STATE.kind, t.MAP_STATUS.kind
    for topic, message in (
        (t.MAP_STATUS, elevation()),
        (t.GOAL_STATUS, goal(id="g", state="accepted")),
        (t.GOAL_STATUS, goal(id="g", state="moving")),
        (t.GOAL_STATUS, goal(id="g", state="moving", distance_left=1.0)),
        (t.MISSION_STATE, mission()),
        (t.MISSION_STATE, mission(order_id="o", name="round", phase="running", step=1)),
        (t.MISSION_STATE, mission(order_id="o", name="round", phase="running", step=2)),
        (t.MISSION_STATE, mission(order_id="o", name="round", phase="running", question="open?")),
        (t.MAP_STATUS, elevation(warning="it does not fit")),
        (t.MAP_STATUS, elevation()),
        (t.MAP_STATUS, elevation()),
        (t.GOAL_STATUS, goal(id="g", state="aborted", reason="stuck", detail="here")),
    ):
        events.take(topic, message)
    assert said == [
        "goal g moving, more than 99 % to arrive",
        "mission round running",
        "mission round running: open?",
        "map: it does not fit",
        "map: well again",
        "goal g aborted: stuck (here)",
    ]


def test_an_event_tells_when_where_and_who_did_it() -> None:
    events = Events(lambda _: None, least_battery=0.1, clock=lambda: 7)
    at = msg.Pose(msg.Point(4.0, 5.0, 0.0))
    frames = msg.TFMessage(
        transforms=[transform_msg(1, "map", "odom", np.array([1.0, 2.0, 0.0]), (0, 0, 0, 1.0))]
    )
    odom = odometry_msg(1, (3.0, 0.0, 0.4), (0.0, 0.0, 0.0, 1.0), (0.0,) * 3, np.zeros(3))
    stopped = {"estop": True, "estop_cause": "emergency stop: Anna", "battery": 0.9}
    refused = {"refused_reason": ["old hands", "stopped until resume"], "battery": 0.19}

    def refusal(second: int, count: int) -> msg.RobotState:
        counts = np.array([count, 50 * second], np.uint32)
        return msg.RobotState(header=header(second * NS, ""), refused_count=counts, **refused)

    for topic, message in (
        (t.TOUCHED, msg.PoseStamped(pose=at)),
        (t.TF_STATIC, frames),
        (t.ODOM, odom),
        (t.GOAL_STATUS, msg.GoalStatus(id="g", owner="Bert", state="moving", x=9.0, y=8.0)),
        (t.ROBOT_STATE, msg.RobotState(**stopped)),
        (t.GOAL_STATUS, msg.GoalStatus(id="g", owner="Bert", state="aborted", reason="emergency_stop")),
        (t.ROBOT_COMMAND, msg.RobotCommand(mode="resume", cause="Carl")),
        (t.ROBOT_STATE, msg.RobotState(battery=0.9)),
        (t.MAP_STATUS, msg.MapStatus(detail="the map was loaded")),
        (t.ROBOT_STATE, refusal(20, 1)),
        (t.ROBOT_STATE, refusal(21, 30)),  # hands that are old twenty times a second
        (t.ROBOT_STATE, refusal(22, 30)),
        (t.ROBOT_STATE, refusal(40, 31)),
    ):
        events.take(topic, message)
    told = [(e.number, e.severity, e.kind, e.who, (e.x, e.y) if e.has_place else None) for e in events.due()]
    here = (4.0, 2.0)
    assert told == [
        (1, 1, "touch", "", (4.0, 5.0)),
        (2, 0, "goal", "Bert", (9.0, 8.0)),
        (3, 2, "stop", "Anna", here),
        (4, 1, "goal", "Bert", here),
        (5, 0, "release", "Carl", here),
        (6, 0, "map", "", here),
        (7, 1, "battery", "", here),
        (8, 1, "refusal", "", here),
        (9, 1, "refusal", "", here),
    ]
    assert events.due() == []
    assert events.newest()[2] == {
        "number": 3,
        "stamp": 7e-9,
        "logged": 0.0,
        "kind": "stop",
        "severity": "error",
        "text": "e-stop: emergency stop: Anna",
        "who": "Anna",
        "place": [4.0, 2.0],
    }
    events.happened("process", "planner runs again")
    assert [(e.number, stamp_of(e), e.header.frame_id, e.text) for e in events.due()] == [
        (10, 7, "map", "planner runs again")
    ]
