"""A second process that stops the robot when the first one dies or hangs.

The robot holds the last Move for a second. A driver that is killed, or stuck, at 1 m/s would leave it rolling for a
metre. This process watches the driver's heartbeat on its standard input and sends StopMove itself, over its own DDS
participant, so that the emergency path shares nothing with the normal one. It imports little, does one thing and
ends with its parent.

It hears the robot's own motion: what counts is rest, not the answer (`hal.unitree.motion`).

Input, one byte each: `m` alive and moving, `i` alive and at rest, `s` stop now, `d` damp now, `e` the robot is told
something else, leave off; end of file: the driver is gone. Output: `r` once the robot's sport service is in reach,
then `.` ten times a second."""

from __future__ import annotations

import contextlib
import os
import select
import signal
import subprocess
import sys
import time
from typing import Any

from hal.contract import BackendError
from hal.unitree import api
from hal.unitree.api import Request, Sport, WireError
from hal.unitree.layout import LOW_STATE_CDR, SPORT_MODE_STATE_CDR, view
from hal.unitree.link import LOW_STATE, SPORT_STATE, DdsLink, Link
from hal.unitree.motion import Halt, Motion, Wheels

LONGEST_SILENCE = 0.15
"""[s] without a heartbeat while moving: stop."""
LOST_AFTER = 1.0
"""[s] without a sign from the guardian: it counts as lost."""
CLOSING_TIME = 5.0
"""[s] for its last order: to a robot that does not follow it, longer than until Damp."""
START_TIME = 10.0
"""[s] from its start to its first sign, and to the robot's sport service: longer counts as lost."""


class Guardian:
    """The driver's end of the guardian process."""

    def __init__(self, interface: str, domain: int, avoid: bool, wheels: Wheels | None) -> None:
        """Start the process; `wait_ready` before moving. `wheels`: see `hal.unitree.motion.Motion`."""
        command = [
            sys.executable,
            "-m",
            "hal.unitree.guardian",
            interface,
            str(domain),
            "1" if avoid else "0",
            *map(str, wheels or ()),
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
        """Have the guardian send StopMove until the robot rests, and Damp where it does not."""
        self._tell(b"s")

    def leave_off(self) -> None:
        """The robot is told something else than to stop."""
        self._tell(b"e")

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
        """Whether the process runs and has shown a sign within `LOST_AFTER`; at its start it has `START_TIME` to get
        ready. Never blocks."""
        self._listen()
        now = time.monotonic()
        if self._process.poll() is not None or (not self.ready and now - self._started > START_TIME):
            return False
        return self._heard is None or now - self._heard < LOST_AFTER

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
            self._process.wait(CLOSING_TIME)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        if self._process.stdout is not None:
            self._process.stdout.close()


class Order:
    """One emergency request, insisted on until the robot rests."""

    def __init__(self, link: Link, avoid: bool, wheels: Wheels | None) -> None:
        self._link = link
        self.avoid = avoid
        """Whether the robot drives through its obstacle avoidance, which then must rest too."""
        self.halt = Halt()
        self._motion = Motion(wheels)
        self._tick = -1
        self._stamp = b""
        self._ids: set[int] = set()

    @property
    def reachable(self) -> bool:
        """Whether the robot's sport service is in reach."""
        return self._link.reachable(api.SPORT)

    def give(self, number: Sport, now: float) -> None:
        """Start insisting on this sport request, at `now` [s, monotonic]."""
        self.halt.begin(number, now)
        self._ids.clear()

    def sent(self, request: Request) -> bool:
        """Whether this request is one of ours."""
        return request.id in self._ids

    def pump(self, now: float) -> bool:
        """Listen and send; False when there is nothing left to insist on."""
        self._listen(now)
        for response in self._link.responses(api.SPORT):
            if response.id in self._ids and response.code == 0:
                self.halt.answered()
        soft = self.halt.damped
        number = self.halt.due(now, self._motion)
        if self.halt.damped and not soft:
            self._ids.clear()
        if number is not None:
            identity = time.monotonic_ns()
            self._ids.add(identity)
            self._link.send(api.SPORT, Request(identity, int(number)))
            if self.avoid:
                zero = api.compact({"x": 0.0, "y": 0.0, "yaw": 0.0, "mode": 0})
                self._link.send(
                    api.OBSTACLES_AVOID, Request(identity + 1, api.ObstaclesAvoid.MOVE, zero, True)
                )
        if self.halt.damped and not soft:
            _say(f"{self.halt.damped}: made soft (Damp)")
        return self.halt.order is not None

    def _listen(self, now: float) -> None:
        """The newest of what the robot tells of its motion; a publisher that repeats itself tells nothing."""
        for data in self._link.take(SPORT_STATE)[-1:]:
            with contextlib.suppress(WireError):
                sport = view(data, SPORT_MODE_STATE_CDR)
                stamp = sport["stamp"].tobytes()
                if stamp != self._stamp:
                    self._stamp = stamp
                    self._motion.hear_sport(sport, now)
        for data in self._link.take(LOW_STATE)[-1:]:
            with contextlib.suppress(WireError):
                low = view(data, LOW_STATE_CDR)
                if int(low["tick"]) != self._tick:
                    self._tick = int(low["tick"])
                    self._motion.hear_low(low, now)


def main(interface: str, domain: int, avoid: bool, wheels: Wheels | None) -> int:
    """Watch standard input until it ends and the last order is through."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)  # the end of the parent is the only signal that counts
    try:
        services = (api.SPORT, api.OBSTACLES_AVOID) if avoid else (api.SPORT,)
        link = DdsLink(interface, domain, motion_topics(), services)
    except BackendError as error:
        _say(str(error))
        return 1
    try:
        watch(Order(link, avoid, wheels), 0, 1)
    finally:
        link.close()
    return 0


def motion_topics() -> list[tuple[str, Any, int]]:
    """What `Order` listens to, the newest message alone."""
    from hal.unitree import idl

    return [(LOW_STATE, idl.LowState, 1), (SPORT_STATE, idl.SportModeState, 1)]


def watch(order: Order, orders: int, signs: int) -> None:
    """Read `orders` and write to `signs` (descriptors) as told above, until either ends and the last order is
    through."""
    moving, ended, ready = False, False, False
    own = False  # the order is ours, for a silent driver: not what it asked for
    heard = sign = time.monotonic()
    while True:
        busy = order.pump(time.monotonic())
        if ended and not busy:
            return
        readable, _, _ = select.select([] if ended else [orders], [], [], 0.01 if busy else 0.02)
        now = time.monotonic()
        gone = False
        if readable:
            data = os.read(orders, 4096)
            if data and own:  # the driver is back, and says itself whether the robot rests
                own = False
                if order.halt.order is Sport.STOP_MOVE:
                    order.halt.end()
            for byte in data:
                _obey(order, byte, now)
                moving = byte == ord("m") if byte in b"mi" else moving
            if data:
                heard = now
            else:
                gone = True
        elif moving and not ended and now - heard > LONGEST_SILENCE:
            moving, own = False, True
            order.give(Sport.STOP_MOVE, now)
            order.pump(now)
            _say(f"no heartbeat for {now - heard:.2f} s, stopping the robot")
        if not (ended or gone) and now - sign >= 0.1:
            sign = now
            ready = ready or order.reachable
            try:
                os.write(signs, b"r" if ready else b".")
            except BrokenPipeError:
                gone = True  # it died since `select`
        if gone:
            ended = True
            if moving:
                order.give(Sport.STOP_MOVE, now)
                order.pump(now)
                _say("the driver is gone, stopping the robot")


def _obey(order: Order, byte: int, now: float) -> None:
    """One byte of the driver that is no beat."""
    if byte == ord("d"):
        order.give(Sport.DAMP, now)
    elif byte == ord("s"):
        order.give(Sport.STOP_MOVE, now)
    elif byte == ord("e"):
        order.halt.end()


def _say(words: str) -> None:
    """After what matters, and on a full disk or a closed terminal not at all."""
    with contextlib.suppress(OSError):
        print(f"guardian: {words}", file=sys.stderr, flush=True)


if __name__ == "__main__":
    _, where, number, avoids, *sizes = sys.argv
    sys.exit(main(where, int(number), avoids == "1", Wheels(*map(float, sizes)) if sizes else None))
