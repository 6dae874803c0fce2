"""The process of the motor loop: 500 commands a second over its own DDS participant, orders on standard input, reports
on standard output.

The loop waits for nothing: pipes do not block, Python's collector runs once a second over the youngest objects alone,
and where the kernel permits it the process has a real-time priority (`LimitRTPRIO=` of the service, or `ulimit -r`).
"""

from __future__ import annotations

import gc
import json
import logging
import os
import signal
import subprocess
import sys
import time
from typing import Any

from hal.contract import BackendError
from hal.robots.go2w.locomotion.controllers import controller_of
from hal.robots.go2w.locomotion.torchfile import PolicyError
from hal.unitree import idl
from hal.unitree.api import WireError
from hal.unitree.link import LOW_STATE, DdsLink
from hal.unitree.low.loop import COMMAND_PERIOD, TOLD_SHARES, MotorLoop, Order
from hal.unitree.low.pipe import Lines, write
from hal.unitree.low.wire import LOW_CMD

log = logging.getLogger(__name__)

REPORT_EVERY = 10
"""Ticks between two reports: 50 a second."""
COLLECT_EVERY = 500
"""Ticks between two runs of Python's collector."""
LOOP_PRIORITY = 50
"""Of the real-time scheduler, where it is permitted."""
CLASS_WIDTH, CLASS_COUNT = 5e-5, 400
"""Width [s] and number of the classes that times between commands are counted in; the last takes all longer ones."""
LISTEN_TIME, OTHERS_TIME = 0.3, 10.0
"""[s] to discover who else sends to the motors, and for the watchdog of a loop that died to end."""


def main(settings: dict[str, Any]) -> int:
    """Run until standard input ends and the robot lies soft.

    settings: interface, domain, controller, policy, and the keywords of `MotorLoop`.
    """
    logging.basicConfig(level=logging.INFO, format="motor loop: %(message)s", stream=sys.stderr)
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)  # the end of standard input is the only order to end
    interface, domain = settings.pop("interface"), settings.pop("domain")
    watch: subprocess.Popen[bytes] | None = None
    link: DdsLink | None = None
    try:
        controller = controller_of(settings.pop("controller"), settings.pop("policy"))
        link = DdsLink(
            interface, domain, [(LOW_STATE, idl.LowState, 8)], services=(), commands=[(LOW_CMD, idl.LowCmd)]
        )
        _alone(link)
        watch = _start_watch(interface, domain)
        run(MotorLoop(controller, **settings), link, watch)
    except (BackendError, PolicyError) as error:
        log.error("%s", error)
        return 1
    finally:
        if watch is not None and watch.stdin is not None:
            watch.stdin.close()
            watch.wait()
        if link is not None:
            link.close()
    return 0


def run(loop: MotorLoop, link: DdsLink, watch: subprocess.Popen[bytes]) -> None:
    """Tick until the loop is finished."""
    assert watch.stdin is not None
    orders, beats = Lines(0), watch.stdin.fileno()
    for descriptor in (1, beats):
        os.set_blocking(descriptor, False)
    _hurry()
    ticks = late = 0
    gaps = Gaps()
    due = last = time.monotonic()
    while not loop.finished:
        now = time.monotonic()
        _listen(loop, link, orders, now)
        if watch.poll() is not None:
            loop.soften("the watchdog process of the motors is gone: recover starts it again")
            loop.leave(now)
        message = loop.tick(now)
        if message is not None:
            link.publish(LOW_CMD, message)
            gap = now - last
            gaps.add(gap)
            late += gap > 2 * COMMAND_PERIOD
        last = now
        write(beats, b"t")
        ticks += 1
        if ticks % REPORT_EVERY == 0:
            report = loop.report()
            report.late, report.worst = late, round(gaps.worst, 5)
            report.shares = gaps.shares()
            write(1, report.pack())
        if ticks % COLLECT_EVERY == 0:
            gc.collect(0)
        due = max(due + COMMAND_PERIOD, now)  # what a busy machine made late is not made up for
        time.sleep(max(0.0, due - time.monotonic()))
    write(beats, b"e")


class Gaps:
    """Times between two commands, counted."""

    def __init__(self) -> None:
        self._counts = [0] * CLASS_COUNT
        self._number = 0
        self.worst = 0.0
        """[s]"""

    def add(self, gap: float) -> None:
        """One of so many seconds."""
        self._counts[min(int(gap / CLASS_WIDTH), CLASS_COUNT - 1)] += 1
        self._number += 1
        self.worst = max(self.worst, gap)

    def shares(self) -> tuple[float, float, float]:
        """What `TOLD_SHARES` of them do not exceed [s], to `CLASS_WIDTH`, and at most the longest."""
        found: list[float] = []
        seen = 0
        for k, count in enumerate(self._counts):
            seen += count
            while len(found) < len(TOLD_SHARES) and seen >= TOLD_SHARES[len(found)] * self._number:
                found.append(
                    round(min((k + 1) * CLASS_WIDTH, self.worst) if k < CLASS_COUNT - 1 else self.worst, 5)
                )
        return found[0], found[1], found[2]


def _listen(loop: MotorLoop, link: DdsLink, orders: Lines, now: float) -> None:
    for data, speaker in zip(link.take(LOW_STATE), link.speakers(LOW_STATE), strict=True):
        try:
            loop.hear(data, now, speaker)
        except WireError as error:
            loop.unreadable(str(error))
    for line in orders.read():
        try:
            loop.order(Order.unpack(line), now)
        except WireError as error:
            log.warning("%s", error)
    if orders.ended:
        loop.leave(now)


def _alone(link: DdsLink) -> None:
    """Until nobody else sends to the motors, such as the watchdog of a loop that died. Raises BackendError."""
    listened, until = time.monotonic() + LISTEN_TIME, time.monotonic() + OTHERS_TIME
    while (others := link.publishers(LOW_CMD) - 1) > 0 or time.monotonic() < listened:
        if time.monotonic() > until:
            raise BackendError(f"{others} other programs send {LOW_CMD}: end them, then recover")
        time.sleep(0.05)


def _start_watch(interface: str, domain: int) -> subprocess.Popen[bytes]:
    """The watchdog, ready. Raises BackendError."""
    command = [sys.executable, "-m", "hal.unitree.low.watch", interface, str(domain), str(os.getpid())]
    watch = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True)
    assert watch.stdout is not None
    if watch.stdout.read(1) != b"r":
        watch.wait()
        raise BackendError(
            "the watchdog process of the motors ended at its start; its reason is in the log above"
        )
    return watch


def _hurry() -> None:
    """Keep Python's collector out of the way, and take a real-time priority where it is permitted."""
    gc.collect()
    gc.freeze()
    gc.disable()
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(LOOP_PRIORITY))
    except PermissionError:
        log.info(
            "no real-time priority: commands come late on a busy machine (LimitRTPRIO=%d permits it)",
            LOOP_PRIORITY,
        )


if __name__ == "__main__":
    sys.exit(main(json.loads(sys.argv[1])))
