"""One real `up`: processes, signals, kills. Slow, so nearly everything is asked of one run."""

from __future__ import annotations

import itertools
import json
import math
import os
import re
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import psutil
import pytest
from rosbags.highlevel import AnyReader

from rbtrg_robot import topics as t
from rbtrg_robot.config import load
from rbtrg_robot.log.read import read_run
from rbtrg_robot.log.summary import is_intact
from rbtrg_robot.process.leftovers import shared_segments
from rbtrg_robot.processes import PROCESSES
from rbtrg_robot.stages.navigation.goal import goal_request
from rbtrg_robot.wire.bus import Bus
from rbtrg_robot.wire.messages import decode, stamp_of
from tests.places import extension
from tests.rbtrg_robot.process.command import SPARSE, command
from tests.rbtrg_robot.wire.ros2_files import client_command, write_definitions
from tools.bench.ports import free_port

pytestmark = pytest.mark.timeout(420)
START_LIMIT = 240.0


class Stack:
    """A stack of its own: runtime folder, port, log folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.logs = folder / "logs"
        self.port = free_port()

    def run(self, *arguments: str, limit: float = 120.0) -> subprocess.CompletedProcess[str]:
        return command(self.folder, *arguments, limit=limit)

    def up(self, *without: str) -> subprocess.CompletedProcess[str]:
        return self.run(
            *("up", "--detach", "--scene", "flat", "--set", "recorder.profile=full", *SPARSE),
            *("--port", str(self.port), "--console-port", "0", "--log-dir", str(self.logs)),
            *(word for name in without for word in ("--without", name)),
            limit=START_LIMIT,
        )

    def status(self) -> dict[str, Any]:
        done = self.run("status", "--json")
        assert done.returncode == 0, done.stderr
        found: dict[str, Any] = json.loads(done.stdout)
        return found

    def processes(self) -> dict[str, dict[str, Any]]:
        return {row["process"]: row for row in self.status()["processes"]}

    def bus(self) -> Bus:
        return Bus(f"tcp/127.0.0.1:{self.port}", "test")

    def log(self) -> Path:
        (run,) = self.logs.iterdir()
        return run


class Observer:
    """The robot as the simulator knows it, on the simulator's clock."""

    def __init__(self, bus: Bus) -> None:
        self._bus = bus
        self.speed = 0.0
        self.stamp = 0
        self.place = (0.0, 0.0)
        self.goal = ""
        bus.subscribe([t.TRUTH, t.GOAL_STATUS])

    def until(self, condition: Callable[[], bool], limit: float) -> None:
        """Watch until `condition()`; `limit` in wall seconds, generous because machines differ."""
        end = time.monotonic() + limit
        while not condition():
            assert time.monotonic() < end, "it did not happen"
            for received in self._bus.take(0.1):
                message = received.decode()
                if received.topic is t.TRUTH:
                    twist = message.twist.twist.linear
                    self.speed = math.hypot(twist.x, twist.y)
                    self.stamp = received.stamp
                    self.place = (message.pose.pose.position.x, message.pose.pose.position.y)
                else:
                    self.goal = message.state

    def send(self, goal_id: str, x: float, y: float) -> None:
        """Until it is answered."""
        request = goal_request(time.time_ns(), goal_id, x, y)
        self.goal = ""
        end = time.monotonic() + 30.0
        while self.goal in ("", "idle"):
            assert time.monotonic() < end
            self._bus.publish(t.GOAL_REQUEST, request, 0)
            due = time.monotonic() + 1.0
            self.until(lambda due=due: self.goal not in ("", "idle") or time.monotonic() > due, 5.0)  # type: ignore[misc]


@pytest.fixture
def stack(tmp_path: Path) -> Iterator[Stack]:
    """Always taken down."""
    made = Stack(tmp_path)
    yield made
    made.run("down")


def errand(stack: Stack) -> None:
    """The program of the docs drives the robot by the console."""
    address = stack.run("console")
    assert address.returncode == 0, address.stderr
    script = stack.folder / "errand.py"
    script.write_text(extension("errand"))
    robot = stack.status()["robot"]
    x, y = robot["x"] - 0.8, robot["y"]
    done = subprocess.run(
        [sys.executable, str(script), address.stdout.strip(), str(x), str(y)],
        capture_output=True,
        text=True,
        timeout=120.0,
        check=False,
    )
    assert (done.returncode, done.stdout.split()[:1]) == (0, ["reached"]), done.stdout + done.stderr
    robot = stack.status()["robot"]
    assert math.dist((robot["x"], robot["y"]), (x, y)) < 0.4


def test_up_goal_kill_stop_down(stack: Stack) -> None:
    up = stack.up()
    assert up.returncode == 0, up.stderr
    assert "ready" in up.stdout
    assert re.search(r"^console: http://127\.0\.0\.1:\d+/enter\?token=\S+$", up.stdout, re.MULTILINE), (
        up.stdout
    )
    second = stack.up()
    assert second.returncode == 1
    status = stack.status()
    assert str(status["pid"]) in second.stderr
    assert status["ready"]
    assert {row["state"] for row in status["processes"]} == {"ready"}
    children = psutil.Process(status["pid"]).children(recursive=True)
    assert {p.pid for p in children} > {row["pid"] for row in status["processes"]}
    assert len(children) == len(PROCESSES) - len(load().absent) + 1  # and the zygote

    with stack.bus() as bus:
        watch = Observer(bus)
        watch.until(lambda: watch.stamp > 0, 10.0)
        x, y = watch.place
        watch.send("far", x + 2.0, y)
        watch.until(lambda: watch.speed > 0.3, 60.0)
        victim = stack.processes()["tracker"]["pid"]
        os.kill(victim, signal.SIGKILL)
        watch.until(lambda: watch.speed < 0.08, 30.0)
        watch.until(lambda: watch.speed > 0.3 or watch.goal in ("reached", "aborted"), 60.0)
        watch.until(lambda: watch.goal in ("reached", "aborted"), 120.0)
        assert watch.goal == "reached"
        assert math.dist(watch.place, (x + 2.0, y)) < 0.25

    assert stack.processes()["tracker"]["restarts"] == 1
    errand(stack)

    rate = stack.run("topic", "hz", "/odom", "--seconds", "1")
    assert rate.returncode == 0
    assert "Hz" in rate.stdout

    stop = stack.run("stop")
    assert stop.returncode == 0, stop.stderr
    assert stack.status()["robot"]["estop"] is True
    refused = stack.run("goal", "0", "0", "--wait")
    assert refused.returncode == 2
    assert "emergency stop" in refused.stderr
    assert stack.run("resume").returncode == 0
    assert stack.status()["robot"]["estop"] is False
    nan = stack.run("goal", "nan", "1", "--wait")
    assert nan.returncode == 2
    beside = stack.run("replay", str(stack.log()))
    assert beside.returncode == 1
    assert "robot is live" in beside.stderr

    segments = {path for child in children for path in shared_segments(child)}
    assert segments
    down = stack.run("down")
    assert down.returncode == 0
    _gone, alive = psutil.wait_procs(children, timeout=30.0)
    assert not alive
    assert not [path for path in segments if path.exists()]
    log = stack.log() / "log_0.mcap"
    assert is_intact(log)
    counts: Counter[str] = Counter()
    commands: list[tuple[int, float]] = []
    speeds: dict[float, float] = {}
    for entry in read_run(log):
        counts[entry.topic] += 1
        if entry.topic == t.CMD_VEL.name:
            commands.append((entry.sequence, stamp_of(decode(entry.data, entry.type)) / 1e9))
        elif entry.topic == t.TRUTH.name:
            message: Any = decode(entry.data, entry.type)
            twist = message.twist.twist.linear
            speeds[stamp_of(message) / 1e9] = math.hypot(twist.x, twist.y)
    # By the log's own clock, from the last command of the tracker that died: the next one counts from 1 again.
    (last,) = [before for (_, before), (count, _) in itertools.pairwise(commands) if count == 1]
    stood = next(stamp for stamp, speed in speeds.items() if stamp > last and speed < 0.1)
    assert stood - last < 0.6
    for name in (
        "/lidar/main/points",
        "/lidar/head/points",
        "/odom",
        "/elevation_map/update",
        "/plan",
        "/goal/request",
        "/cmd_vel",
    ):
        assert counts[name] > 0, name


@pytest.mark.campaign
def test_a_ros_2_client_that_is_not_ours_reads_the_robot_and_drives_it(stack: Stack, tmp_path: Path) -> None:
    up = stack.up()
    assert up.returncode == 0, up.stderr
    with stack.bus() as bus:
        watch = Observer(bus)
        watch.until(lambda: watch.stamp > 0, 10.0)
        x, y = watch.place
        definitions = write_definitions(tmp_path / "msg")
        client = subprocess.run(
            client_command(stack.port, definitions, x + 0.8, y),
            env={**os.environ, "HOME": str(tmp_path)},
            capture_output=True,
            text=True,
            timeout=90,
            check=True,
        )
        found = json.loads(client.stdout.splitlines()[-1])
        assert set(found["topics"]) >= {
            "/odom",
            "/imu/data",
            "/lidar/main/points",
            "/tf_static",
            "/plan/path",
        }
        assert found["got"]["/imu/data"] == pytest.approx(9.81, abs=3.0)
        assert found["got"]["/lidar/main/points"][0] > 1000
        assert "lidar_main" in found["got"]["/tf_static"]
        assert found["got"]["/plan/path"] > 1
        watch.until(lambda: math.dist(watch.place, (x + 0.8, y)) < 0.25, 120.0)


@pytest.mark.campaign
def test_when_up_is_killed_nothing_survives_it_and_the_log_does(stack: Stack) -> None:
    up = stack.up(
        "planner", "elevation", "camera", "mission"
    )  # which take long to start, and nothing waits for
    assert up.returncode == 0, up.stderr
    supervisor = psutil.Process(stack.status()["pid"])
    children = supervisor.children(recursive=True)
    recorder = stack.processes()["recorder"]["pid"]
    with stack.bus() as bus:
        watch = Observer(bus)
        watch.until(lambda: watch.stamp > 3_000_000_000, 60.0)
        os.kill(recorder, signal.SIGKILL)
        kills = [watch.stamp]
        watch.until(lambda: watch.stamp > kills[0] + 5_000_000_000, 60.0)
        supervisor.kill()
        kills.append(watch.stamp)
    _gone, alive = psutil.wait_procs(children, timeout=30.0)
    assert not alive
    logs = sorted(stack.log().glob("log_*.mcap"))
    assert len(logs) == 2
    for log, killed in zip(logs, kills, strict=True):
        readable = log
        if not is_intact(log):
            assert stack.run("log", "recover", str(log)).returncode == 0
            readable = log.with_suffix(".recovered.mcap")
        with AnyReader([readable]) as reader:
            truth = [c for c in reader.connections if c.topic == "/ground_truth/odom"]
            newest = max(stamp_of(reader.deserialize(raw, c.msgtype)) for c, _, raw in reader.messages(truth))
        assert killed - newest < 1_100_000_000  # a flush every second of the wall clock
    again = stack.run("status")
    assert again.returncode == 1
    assert "rbtrg-robot up" in again.stderr
