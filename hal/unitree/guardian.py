"""A second process that stops the robot when the first one dies or hangs.

The robot holds the last Move for a second. A driver that is killed, or stuck, at 1 m/s would leave it rolling for a
metre. This process watches the driver's heartbeat on its standard input and sends StopMove itself, over its own DDS
participant, so that the emergency path shares nothing with the normal one. It imports little, does one thing and
ends with its parent.

Input, one byte each: `m` alive and moving, `i` alive and at rest, `s` stop now, `d` damp now; end of file: the driver is
gone. Output: `r` once the robot's sport service is in reach, then `.` ten times a second.
"""

from __future__ import annotations

import contextlib
import os
import select
import signal
import subprocess
import sys
import time

from hal.contract import BackendError
from hal.unitree import api
from hal.unitree.api import Request
from hal.unitree.link import DdsLink, Link

SILENCE = 0.15
"""[s] without a heartbeat while moving: stop."""
INSIST = 1.0
"""[s] an order is repeated until the robot confirms it."""
REPEAT = 0.05
"""[s] between repetitions."""
LOST = 1.0
"""[s] without a sign from the guardian: it counts as lost."""
START = 10.0
"""[s] from its start to its first sign, and to the robot's sport service: longer counts as lost."""


class Guardian:
    """The driver's end of the guardian process."""

    def __init__(self, interface: str, domain: int, avoid: bool) -> None:
        """Start the process; `wait_ready` before moving."""
        command = [
            sys.executable,
            "-m",
            "hal.unitree.guardian",
            interface,
            str(domain),
            "1" if avoid else "0",
        ]
        # A session of its own: a Ctrl-C in the terminal must not take the guardian before its parent.
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True
        )
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._in, self._out = self._process.stdin.fileno(), self._process.stdout.fileno()
        os.set_blocking(self._in, False)
        os.set_blocking(self._out, False)
        self._started = time.monotonic()
        self._heard: float | None = None
        self.ready = False
        """Whether it has the robot's sport service in reach: from then on it can stop the robot. See `alive`."""

    @property
    def pid(self) -> int:
        """Process id."""
        return self._process.pid

    def beat(self, moving: bool) -> None:
        """Tell the guardian that the driver lives. Never blocks."""
        self._tell(b"m" if moving else b"i")
        self._listen()

    def stop(self) -> None:
        """Have the guardian send StopMove until the robot confirms."""
        self._tell(b"s")

    def damp(self) -> None:
        """Have the guardian send Damp until the robot confirms."""
        self._tell(b"d")

    def _tell(self, byte: bytes) -> None:
        # A full or broken pipe shows as silence of the guardian, see `alive`.
        with contextlib.suppress(BlockingIOError, BrokenPipeError):
            os.write(self._in, byte)

    def _listen(self) -> None:
        with contextlib.suppress(BlockingIOError):
            data = os.read(self._out, 4096)
            if data:
                self.ready = self.ready or b"r" in data
                self._heard = time.monotonic()

    def alive(self) -> bool:
        """Whether the process runs and has shown a sign within `LOST`; at its start it has `START` to get ready. Never blocks."""
        self._listen()
        now = time.monotonic()
        if self._process.poll() is not None or (not self.ready and now - self._started > START):
            return False
        return self._heard is None or now - self._heard < LOST

    def wait_ready(self, timeout: float) -> None:
        """Block until the guardian reaches the robot. Raises BackendError."""
        deadline = time.monotonic() + timeout
        while not self.ready:
            self._listen()
            if self._process.poll() is not None:
                raise BackendError("the guardian process ended at start; its reason is in the log above")
            if time.monotonic() > deadline:
                raise BackendError(
                    f"the guardian process did not find the robot's sport service within {timeout:.0f} s"
                )
            select.select([self._out], [], [], 0.05)

    def kill(self) -> None:
        """End a process that counts as lost. Does not wait for it to agree."""
        self._process.kill()
        self.close()

    def close(self) -> None:
        """End the process, after its last order is through. Idempotent."""
        if self._process.stdin is not None and not self._process.stdin.closed:
            self._process.stdin.close()
        try:
            self._process.wait(INSIST + 1.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        if self._process.stdout is not None:
            self._process.stdout.close()


class Order:
    """One emergency request that is repeated until it is confirmed."""

    def __init__(self, link: Link, avoid: bool) -> None:
        self._link = link
        self.avoid = avoid
        """Whether the robot drives through its obstacle avoidance, which then must rest too."""
        self._api: int | None = None
        self._until = self._next = 0.0
        self._ids: set[int] = set()

    def give(self, number: int) -> None:
        """Start insisting on this sport request. Damp is not replaced by a stop."""
        if self._api == api.Sport.DAMP and number != api.Sport.DAMP:
            return
        self._api, self._until, self._next = number, time.monotonic() + INSIST, 0.0
        self._ids.clear()

    def pump(self) -> bool:
        """Send and collect; False when there is nothing left to insist on."""
        for response in self._link.responses(api.SPORT):
            if response.id in self._ids and response.code == 0:
                self._api = None
        now = time.monotonic()
        if self._api is not None and now >= self._until:
            self._api = None
        if self._api is not None and now >= self._next:
            identity = time.monotonic_ns()
            self._ids.add(identity)
            self._link.send(api.SPORT, Request(identity, int(self._api)))
            if self.avoid:
                zero = api.compact({"x": 0.0, "y": 0.0, "yaw": 0.0, "mode": 0})
                self._link.send(
                    api.OBSTACLES_AVOID, Request(identity + 1, api.ObstaclesAvoid.MOVE, zero, True)
                )
            self._next = now + REPEAT
        return self._api is not None


def main(interface: str, domain: int, avoid: bool) -> int:
    """Watch standard input until it ends and the last order is through."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)  # the end of the parent is the only signal that counts
    try:
        link = DdsLink(interface, domain, [], (api.SPORT, api.OBSTACLES_AVOID) if avoid else (api.SPORT,))
    except BackendError as error:
        _say(str(error))
        return 1
    try:
        watch(link, avoid, 0, 1)
    finally:
        link.close()
    return 0


def watch(link: Link, avoid: bool, orders: int, signs: int) -> None:
    """Read `orders` and write to `signs` (descriptors) as told above, until either is at its end and the last order is through."""
    order = Order(link, avoid)
    moving, ended, ready = False, False, False
    heard = sign = time.monotonic()
    while True:
        busy = order.pump()
        if ended and not busy:
            return
        readable, _, _ = select.select([] if ended else [orders], [], [], 0.01 if busy else 0.02)
        now = time.monotonic()
        gone = False
        if readable:
            data = os.read(orders, 4096)
            if b"d" in data:
                order.give(api.Sport.DAMP)
            elif b"s" in data:
                order.give(api.Sport.STOP_MOVE)
            if data:
                moving, heard = data.rstrip(b"sd")[-1:] == b"m" if data.rstrip(b"sd") else moving, now
            else:
                gone = True
        elif moving and not ended and now - heard > SILENCE:
            moving = False
            order.give(api.Sport.STOP_MOVE)
            order.pump()
            _say(f"no heartbeat for {now - heard:.2f} s, stopping the robot")
        if not (ended or gone) and now - sign >= 0.1:
            sign = now
            ready = ready or link.reachable(api.SPORT)
            try:
                os.write(signs, b"r" if ready else b".")
            except BrokenPipeError:
                gone = True  # it died since `select`
        if gone:
            ended = True
            if moving:
                order.give(api.Sport.STOP_MOVE)
                order.pump()
                _say("the driver is gone, stopping the robot")


def _say(words: str) -> None:
    """After what matters, and on a full disk or a closed terminal not at all."""
    with contextlib.suppress(OSError):
        print(f"guardian: {words}", file=sys.stderr, flush=True)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1], int(sys.argv[2]), sys.argv[3] == "1"))
