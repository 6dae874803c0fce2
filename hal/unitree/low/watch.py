"""A process that makes the motors soft when the motor loop beside it dies or hangs.

Motors follow their last LowCmd; what they do when none comes any more is the robot's own affair, and not documented.
This process hears a beat from the loop with every command. After `LONGEST_SILENCE` without one, or where the pipe ends
without a word, it kills the loop, so that nobody else speaks to the motors, and sends damping commands of its own over
its own DDS participant.

Input: any byte is a beat; `e` says that the robot lies soft and the loop ends. Output: `r` once it can send.
"""

from __future__ import annotations

import contextlib
import os
import select
import signal
import sys
import time

from hal.contract import BackendError
from hal.postures.motion import damped
from hal.unitree import idl
from hal.unitree.link import DdsLink
from hal.unitree.low.loop import COMMAND_PERIOD
from hal.unitree.low.wire import LOW_CMD, Packer

LONGEST_SILENCE = 0.09
"""[s] without a beat: the loop hangs. Motors are soft within 0.1 s."""
DAMPING_TIME = 5.0
"""[s] for which damping is sent: a robot sinks onto its belly within two."""


def main(interface: str, domain: int, loop: int) -> int:
    """Watch standard input; loop: process id of the motor loop."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)  # the end of the loop is the only signal that counts
    try:
        link = DdsLink(interface, domain, [], services=(), commands=[(LOW_CMD, idl.LowCmd)])
    except BackendError as error:
        print(f"watchdog of the motors: {error}", file=sys.stderr, flush=True)
        return 1
    try:
        os.write(1, b"r")
        reason = silence(0)
        if reason:
            with contextlib.suppress(ProcessLookupError):
                os.kill(loop, signal.SIGKILL)
            soften(link)
            print(f"watchdog of the motors: {reason}, the motors were made soft", file=sys.stderr, flush=True)
    finally:
        link.close()
    return 0


def silence(beats: int) -> str:
    """Read `beats` (a descriptor) until the loop hangs, dies or ends. Why the motors must go soft, in words; empty at a
    proper end."""
    started = False
    while True:
        readable, _, _ = select.select([beats], [], [], LONGEST_SILENCE if started else None)
        if not readable:
            return f"no command for {LONGEST_SILENCE:.2f} s"
        data = os.read(beats, 4096)
        if not data:
            return "the motor loop is gone" if started else ""
        if b"e" in data:
            return ""
        started = True


def soften(link: DdsLink) -> None:
    """Send damping for `DAMPING_TIME`."""
    message = Packer().pack(damped())
    until = time.monotonic() + DAMPING_TIME
    while time.monotonic() < until:
        link.publish(LOW_CMD, message)
        time.sleep(COMMAND_PERIOD)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1], int(sys.argv[2]), int(sys.argv[3])))
