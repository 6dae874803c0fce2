"""The console's process beside a made-up robot: CPU and bytes with 0, 1 and 3 pages and with video, the stop's round
trip alone and beside video and a replay, when old is called old."""

from __future__ import annotations

import argparse
import http.client
import json
import os
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import psutil
from websockets.sync.client import connect

from hal.mujoco.view.camera import RenderedCamera
from hal.types import NS
from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.config import load
from rbtrg_robot.log.read import CONFIG
from rbtrg_robot.log.write import LogWriter
from rbtrg_robot.process.runfiles import console_address
from rbtrg_robot.wire.convert import MAP, ODOM, odometry_msg, patch_msg, transform_msg
from rbtrg_robot.wire.messages import encode, header
from tools.bench.console.stack import Robot, ground
from tools.bench.report import Report

CPU_PER_PAGE = 5.0
"""[% of a core] a page may cost."""
STOP_LIMIT = 0.3
"""[s] until the robot's answer to a stop is on the page, 99 of 100 times: the robot tells its state ten times a
second."""
VIDEO_CPU = 15.0
"""[% of a core] that video may cost: pictures drawn, and handed to one page. The page's own share is not measured."""
VIDEO_STOP = 0.15
"""[s] as STOP_LIMIT, beside video and a replay."""
FRAME_COUNT = 10
"""Pictures that are drawn for their cost."""
STALE_LIMIT = 1.0
"""[s]"""
REPLAYED = "20260101-000000_yard_1"
NAME = "go2w"
"""Robots of other names have keys of their own, and the made-up one has none."""
CHILD = "import json, sys; from rbtrg_robot.process.child import run; sys.exit(run(json.loads(sys.stdin.readline())))"


class Client:
    """A page that draws nothing."""

    def __init__(self, address: str) -> None:
        self.host = address.split("/")[2]
        web = http.client.HTTPConnection(self.host, timeout=10)
        web.request("GET", address.partition(self.host)[2])
        answer = web.getresponse()
        self.headers = {
            "Cookie": answer.headers["set-cookie"].partition(";")[0],
            "Origin": f"http://{self.host}",
        }
        answer.read()
        self._web = web
        self._socket = connect(
            f"ws://{self.host}/live",
            origin=self.headers["Origin"],  # type: ignore[arg-type]
            additional_headers={"Cookie": self.headers["Cookie"]},
            compression=None,
            max_size=None,
        )
        self.bytes = 0
        self.confirmed, self.replays = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()
        self.send(do="see", cloud=True)

    def send(self, **wish: Any) -> None:
        """A wish."""
        self._socket.send(json.dumps(wish))

    def _read(self) -> None:
        for frame in self._socket:
            self.bytes += len(frame)
            for kind, word, event in (
                (b"stop", b"confirmed", self.confirmed),
                (b"replay", b"playing", self.replays),
            ):
                if (
                    isinstance(frame, bytes)
                    and frame[0] == 1
                    and b'"kind":"%s"' % kind in frame
                    and word in frame
                ):
                    event.set()

    def stop(self) -> float:
        """Seconds until the robot's answer is on the page."""
        self.confirmed.clear()
        self._web.close()  # the server ends connections that idle: the request opens its own
        began = time.perf_counter()
        self._web.request("POST", "/stop", headers=self.headers)
        self._web.getresponse().read()
        if not self.confirmed.wait(10.0):
            raise RuntimeError("the stop was not confirmed")
        return time.perf_counter() - began

    def close(self) -> None:
        """Leave."""
        self._socket.close()
        self._thread.join(5.0)


@contextmanager
def process(robot: Robot, folder: Path) -> Iterator[psutil.Process]:
    """The console as `up` runs it, in a process of its own."""
    config = load(None, ["console.port=0"], robot=NAME, scene="yard", port=robot.port, log_dir=str(folder))
    spec = {
        "process": "console",
        "config": config.model_dump(mode="json"),
        "clock": 0,
        "stack": "",
        "restored": {},
    }
    child = subprocess.Popen(
        [sys.executable, "-c", CHILD], stdin=subprocess.PIPE, text=True, stderr=subprocess.DEVNULL
    )
    try:
        assert child.stdin is not None
        child.stdin.write(json.dumps(spec) + "\n")
        child.stdin.flush()
        end = time.monotonic() + 60.0
        while not console_address(NAME):
            if child.poll() is not None or time.monotonic() > end:
                raise RuntimeError("the console did not start")
            time.sleep(0.05)
        yield psutil.Process(child.pid)
    finally:
        child.terminate()
        child.wait(10.0)


def run(args: list[str]) -> Report:
    """Run this bench with the arguments of its command line; returns its rows."""
    parser = argparse.ArgumentParser(prog="python -m tools.bench console", description=__doc__)
    parser.add_argument("--seconds", type=float, default=10.0, help="of each measurement of CPU")
    parser.add_argument("--stops", type=int, default=100)
    options = parser.parse_args(args)
    report = Report("console")
    with tempfile.TemporaryDirectory() as folder:
        os.environ["XDG_RUNTIME_DIR"] = folder
        robot = Robot(busy=True)
        try:
            logs = Path(folder) / "logs"
            _write_run(logs / REPLAYED)
            with process(robot, logs / "now") as console:
                _measure(report, robot, console, options.seconds, options.stops)
        finally:
            robot.close()
    return report


def _measure(report: Report, robot: Robot, console: psutil.Process, seconds: float, stops: int) -> None:
    clients: list[Client] = []
    used: dict[int, float] = {}
    for count in (0, 1, 3):
        while len(clients) < count:
            clients.append(Client(console_address(NAME)))
        time.sleep(2.0)  # the whole map comes first
        sent, began = sum(c.bytes for c in clients), time.monotonic()
        used[count] = _cpu(console, seconds)
        took = time.monotonic() - began
        report.add(f"console.cpu.pages_{count}", used[count], "% of a core")
        if count:
            rate = (sum(c.bytes for c in clients) - sent) / took / count / 1000
            report.add(f"console.bytes.pages_{count}", rate, "kB/s a page")
    report.add("console.cpu.a_page", (used[3] - used[0]) / 3, "% of a core", CPU_PER_PAGE)
    _stops(report, robot, clients[0], stops, "console.stop", STOP_LIMIT)
    clients[0].send(do="see", cloud=True, video=True)
    time.sleep(2.0)
    video = _cpu(console, seconds) - used[3]
    drawn = _drawn()
    report.add("console.video.handed_out", video, "% of a core")
    report.add("console.video.drawn", drawn, "% of a core")
    report.add("console.video.cpu", video + drawn, "% of a core", VIDEO_CPU)
    clients[1].send(do="replay", run=REPLAYED, rate=1, start="0")
    if not clients[1].replays.wait(60.0):
        raise RuntimeError("the replay did not begin")
    _stops(report, robot, clients[0], stops, "console.stop.beside_video_and_replay", VIDEO_STOP)
    for client in clients:
        client.close()
    report.add("console.stale_shown", _stale(robot), "s", STALE_LIMIT)


def _stops(report: Report, robot: Robot, client: Client, count: int, key: str, limit: float) -> None:
    """Rows `key`.p50 and .p99."""
    times = []
    for _ in range(count):
        times.append(client.stop())
        robot.reset()
        robot.filmed = 1  # pictures go on
        time.sleep(0.12)  # its state is said again
    report.add(f"{key}.p50", statistics.median(times), "s")
    report.add(f"{key}.p99", float(np.percentile(times, 99)), "s", limit)


def _cpu(console: psutil.Process, seconds: float) -> float:
    """[% of a core] of the console's process over so long."""
    before, began = console.cpu_times(), time.monotonic()
    time.sleep(seconds)
    after, took = console.cpu_times(), time.monotonic() - began
    return 100.0 * (after.user + after.system - before.user - before.system) / took


def _drawn() -> float:
    """[% of a core] that the simulated camera takes at its rate."""
    config = load(None, [], robot=NAME, scene="yard")
    camera = config.camera.mounted()
    assert camera is not None
    source = RenderedCamera(camera, config.load_scene())
    source.open()
    try:
        for k in range(FRAME_COUNT + 1):
            if k == 1:  # the first one loads what it needs
                began = time.process_time()
            source.follow(k + 1, np.array([-4.5 + 0.1 * k, -4.5, 0.4]), np.array([0.0, 0.0, 0.0, 1.0]))
            source.frame(k + 1)
        return 100.0 * camera.rate * (time.process_time() - began) / FRAME_COUNT
    finally:
        source.close()


def _write_run(folder: Path) -> None:
    """Ten minutes of a robot that stands, with its map once a second."""
    folder.mkdir(parents=True)
    config = load(None, [], robot=NAME, scene="yard").to_yaml()
    (folder / "config.yaml").write_text(config)
    still = (0.0, 0.0, 0.0, 1.0)
    frames = msg.TFMessage(transforms=[transform_msg(1, MAP, ODOM, np.zeros(3), still)])
    patch = encode(patch_msg(ground()))
    with LogWriter(folder / "log_0.mcap", {}, {CONFIG: config.encode()}) as log:
        log.write(t.TF_STATIC, encode(frames), 1, 1, 1)
        for k in range(6000):
            now = (k + 1) * NS // 10
            said: list[tuple[t.Topic, bytes]] = [
                (t.CLOCK, encode(msg.Clock(clock=header(now, "").stamp))),
                (t.ODOM, encode(odometry_msg(now, (3.3, 0.4, 0.45), still, (0.0,) * 3, np.zeros(3)))),
            ]
            if k % 10 == 0:
                said.append((t.MAP_UPDATE, patch))
            for topic, payload in said:
                log.write(topic, payload, now, now, k + 1)


def _stale(robot: Robot) -> float:
    """Seconds from the robot's last word to a grey page, as the page's own clock saw it."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as play:
        browser = play.chromium.launch(
            executable_path="/usr/bin/chromium",
            args=["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"],
        )
        page = browser.new_page(viewport={"width": 800, "height": 600})
        page.goto(console_address(NAME))
        _until(page, "document.body.dataset.fresh === 'live'")
        page.evaluate(
            "() => new MutationObserver(() => { if (document.body.dataset.fresh === 'stale') window.staleAt "
            "??= Date.now(); })"
            ".observe(document.body, { attributes: true })"
        )
        with robot.lock:
            robot.frozen = True
            last = robot.said
        shown = _until(page, "window.staleAt ?? 0") / 1000.0
        browser.close()
    return float(shown - last)


def _until(page: Any, expression: str) -> Any:
    end = time.monotonic() + 30.0
    while not (value := page.evaluate(expression)):
        if time.monotonic() > end:
            raise RuntimeError(f"{expression} never came true")
        page.wait_for_timeout(20)
    return value
