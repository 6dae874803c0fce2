"""A flood of connections to the doors of a robot: who needs how long to get in, and whether those who are in go on.

Router: new sessions of an operator over TLS and of a process inside, a stop over a session of before, and the gaps
between the messages of
two processes inside, while 300 connections say nothing (Zenoh gives them up after 10 s), while 300 say nothing after
TLS with a certificate
that was taken off the list, and while others break off.
Console: stops of fresh connections while others come, each with half a request.
"""

from __future__ import annotations

import argparse
import contextlib
import http.client
import itertools
import math
import os
import socket
import ssl
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from pathlib import Path

from rbtrg_robot import topics as t
from rbtrg_robot.access.identity import CA, CERTIFICATE, KEY
from rbtrg_robot.process.runfiles import console_address
from rbtrg_robot.wire.bus import Bus, BusError
from tools.bench.access import Site, site
from tools.bench.console.bench import NAME, Client, process
from tools.bench.console.stack import Robot
from tools.bench.report import Report

SILENT_CONNECTIONS = 300
HELD_CONNECTIONS = 5000
"""Connections that a flood keeps open; the oldest is closed."""
HOLDS = "holds"
LONGEST_WAIT = 60.0
"""[s] a new session is waited for."""
HANDSHAKE_TIMEOUT = 10.0
"""[s] after which Zenoh 1.10 gives up a TLS handshake."""


def run(args: list[str]) -> Report:
    """Run this bench with the arguments of its command line; returns its rows."""
    parser = argparse.ArgumentParser(prog="python -m tools.bench flood", description=__doc__)
    parser.add_argument(
        "--rates", type=float, nargs="*", default=[500.0, 2000.0, 4000.0], help="of the console [1/s]"
    )
    parser.add_argument("--seconds", type=float, default=10.0, help="of each")
    parser.add_argument(
        "--broken",
        type=float,
        nargs="*",
        default=[50.0, 200.0],
        help="connections that break off at the router [1/s]",
    )
    options = parser.parse_args(args)
    report = Report("flood")
    _router(report, options.seconds, options.broken)
    with tempfile.TemporaryDirectory() as folder:
        os.environ["XDG_RUNTIME_DIR"] = folder
        robot = Robot()
        try:
            with process(robot, Path(folder) / "logs" / "now"):
                page = Client(console_address(NAME))
                for rate in options.rates:
                    _console(report, page, rate, options.seconds)
                page.close()
        finally:
            robot.close()
    return report


def _router(report: Report, seconds: float, broken: list[float]) -> None:
    """Each flood at a router of its own: what is left of one slows the next."""
    with site() as place, Inside(place) as inside, place.enter("operator") as before:
        address = _address(place.endpoint)
        inside.measure(report, "router.calm", before, 2.0)
        with contextlib.ExitStack() as held:
            for _ in range(SILENT_CONNECTIONS):
                held.enter_context(socket.create_connection(address, timeout=5.0))
            full = time.monotonic()
            inside.measure(report, "router.silent", before, HANDSHAKE_TIMEOUT - 2.0)
            time.sleep(max(0.0, full + HANDSHAKE_TIMEOUT + 0.2 - time.monotonic()))
            inside.measure(report, "router.silent_timed_out", before, 1.0)
    with site() as place, Inside(place) as inside, place.enter("operator") as before:
        address = _address(place.endpoint)
        with contextlib.ExitStack() as held:
            tls = _context(place.folders["removed"])
            for _ in range(SILENT_CONNECTIONS):
                held.enter_context(tls.wrap_socket(socket.create_connection(address, timeout=5.0)))
            inside.measure(report, "router.removed", before, HANDSHAKE_TIMEOUT + 6.0)
    for rate in broken:
        kinds = {"junk": b"junk" * 20, "hello": client_hello(), HOLDS: client_hello()}
        for kind, says in kinds.items():
            with (
                site() as place,
                Inside(place) as inside,
                place.enter("operator") as before,
                breaking_off(_address(place.endpoint), rate, says, hold=kind == HOLDS),
            ):
                inside.measure(report, f"router.broken_{rate:.0f}.{kind}", before, seconds)


class Inside:
    """Two processes on the robot's own computer that talk to each other, and one that hears stops."""

    def __init__(self, place: Site) -> None:
        self._place = place
        self._end = threading.Event()
        self._gap = self._heard = 0.0
        self._threads = [threading.Thread(target=x) for x in (self._talk, self._listen)]

    def __enter__(self) -> Inside:
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._end.set()
        for thread in self._threads:
            thread.join()

    def _talk(self) -> None:
        with Bus(self._place.local, "odometry") as bus:
            while not self._end.is_set():
                bus.publish(t.POSE, t.POSE.kind(), 1)
                bus.take(0.02)

    def _listen(self) -> None:
        with Bus(self._place.local, "robot") as bus:
            bus.subscribe([t.POSE, t.ROBOT_STOP])
            last = math.nan
            while not self._end.is_set():
                for received in bus.take(0.05):
                    now = time.monotonic()
                    if received.topic is t.ROBOT_STOP:
                        self._heard = now
                    else:
                        self._gap, last = max(self._gap, now - last), now

    def measure(self, report: Report, key: str, before: Bus, seconds: float) -> None:
        """New sessions and stops for so long, at least one of each."""
        entered: list[float] = []
        started: list[float] = []
        stopped: list[float] = []
        self._gap, end = 0.0, time.monotonic() + seconds
        while not entered or time.monotonic() < end:
            entered.append(_entering(lambda: self._place.enter("operator")))
            started.append(_entering(lambda: Bus(self._place.local, "tracker")))
            began = time.monotonic()
            before.publish(t.ROBOT_STOP, t.ROBOT_STOP.kind(mode="stop"), 1)
            while self._heard < began and time.monotonic() < began + LONGEST_WAIT:
                time.sleep(0.001)
            stopped.append(time.monotonic() - began)
            time.sleep(0.2)
        report.add(f"{key}.new_session.worst", max(entered), "s")
        report.add(f"{key}.new_process.worst", max(started), "s")
        report.add(f"{key}.stop_over_old_session.worst", max(stopped), "s")
        report.add(f"{key}.gap_inside.worst", self._gap, "s")


def _entering(enter: Callable[[], Bus]) -> float:
    """[s] until it was let in, tried again and again."""
    began = time.monotonic()
    while time.monotonic() < began + LONGEST_WAIT:
        with contextlib.suppress(BusError):
            enter().close()
            return time.monotonic() - began
    return math.inf


def _context(folder: Path) -> ssl.SSLContext:
    tls = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    tls.check_hostname = False
    tls.load_verify_locations(folder / CA)
    tls.load_cert_chain(folder / CERTIFICATE, folder / KEY)
    return tls


def client_hello() -> bytes:
    """What every TLS handshake begins with."""
    ours, theirs = ssl.MemoryBIO(), ssl.MemoryBIO()
    tls = ssl.create_default_context().wrap_bio(ours, theirs, server_hostname="robot")
    with contextlib.suppress(ssl.SSLWantReadError):
        tls.do_handshake()
    return theirs.read()


@contextlib.contextmanager
def breaking_off(address: tuple[str, int], rate: float, says: bytes, *, hold: bool = False) -> Iterator[None]:
    """Connections that say this and go, so many a second. hold: that stay, and are closed by the other end."""
    end = threading.Event()
    held: deque[socket.socket] = deque()

    def go() -> None:
        due = time.monotonic()
        while not end.wait(max(0.0, due - time.monotonic())):
            due += 1.0 / rate
            with contextlib.suppress(OSError):
                one = socket.create_connection(address, timeout=5.0)
                held.append(one)
                one.sendall(says)
            while len(held) > (SILENT_CONNECTIONS if hold else 0):
                held.popleft().close()

    thread = threading.Thread(target=go)
    thread.start()
    try:
        yield
    finally:
        end.set()
        thread.join()
        for one in held:
            one.close()


def _address(endpoint: str) -> tuple[str, int]:
    host, port = endpoint.partition("/")[2].split(":")
    return host, int(port)


FLOOD = "import sys; from tools.bench.flood import flood; flood(sys.argv[1], int(sys.argv[2]), float(sys.argv[3]))"


def flood(host: str, port: int, rate: float) -> None:
    """In a process of its own, until it is ended: connections with half a request, so many a second."""
    held: deque[socket.socket] = deque()
    began = time.monotonic()
    for number in itertools.count():
        time.sleep(max(0.0, began + number / rate - time.monotonic()))
        one = socket.socket()
        one.setblocking(False)
        held.append(one)
        with contextlib.suppress(OSError):
            one.connect((host, port))
        with contextlib.suppress(OSError):
            one.send(b"GET / HTTP/1.1\r\nHost: x")
        while len(held) > HELD_CONNECTIONS:
            held.popleft().close()


def _console(report: Report, page: Client, rate: float, seconds: float) -> None:
    host, port = page.host.split(":")
    others = subprocess.Popen([sys.executable, "-c", FLOOD, host, port, str(rate)])
    try:
        time.sleep(2.0)
        took: list[float] = []
        tried, end = 0, time.monotonic() + seconds
        while time.monotonic() < end:
            tried += 1
            began = time.monotonic()
            client = http.client.HTTPConnection(page.host, timeout=5.0)
            with contextlib.suppress(OSError, http.client.HTTPException):
                client.request("POST", "/stop", headers=page.headers)
                if client.getresponse().status == 202:
                    took.append(time.monotonic() - began)
            client.close()
            time.sleep(0.05)
    finally:
        others.kill()
        others.wait()
    key = f"console.at_{rate:.0f}"
    report.rate(f"{key}.stops", len(took), tried)
    report.add(f"{key}.stop.median", statistics.median(took) if took else math.inf, "s")
    report.add(f"{key}.stop.worst", max(took, default=math.inf), "s")
