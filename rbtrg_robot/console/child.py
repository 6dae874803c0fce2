"""A process of the console that ends with it: plays a run under another domain, or runs stages on it again.

    python -m rbtrg_robot.console.child replay ENDPOINT DOMAIN RUN RATE START
    python -m rbtrg_robot.console.child rerun RUN OUT STAGES [a.b=c ...]

A replay reads PAUSE and GO_ON from its stdin. Each line on its stdout is JSON: `seconds` of the log that are done,
`paused`, `words` at the end, `wrong` if it did not work."""

from __future__ import annotations

import json
import math
import os
import select
import shutil
import signal
import sys
import time
from pathlib import Path
from typing import Any

from hal.errors import OperatorError
from rbtrg_robot import topics as t
from rbtrg_robot.console.replays import GO_ON, PAUSE
from rbtrg_robot.hosts.offline import rerun
from rbtrg_robot.log.read import CONFIG, first_of, read_run
from rbtrg_robot.log.replay import Controls, alone, play
from rbtrg_robot.log.summary import overview
from rbtrg_robot.process.zygote import PR_SET_PDEATHSIG, prctl
from rbtrg_robot.scope import Scope
from rbtrg_robot.wire.bus import Bus
from rbtrg_robot.wire.messages import decode

TELL_PERIOD = 0.5
"""[s] between two lines of how far it is."""


def tell(**content: Any) -> None:
    """One line."""
    sys.stdout.write(f"{json.dumps(content)}\n")
    sys.stdout.flush()


class Progress:
    """Tells the seconds that are done, now and then."""

    def __init__(self) -> None:
        self._due = 0.0
        self.seconds = 0.0

    def __call__(self, seconds: float, *_: Any) -> None:
        """So much of the log is done [s]."""
        self.seconds = seconds
        if time.monotonic() >= self._due:
            self._due = time.monotonic() + TELL_PERIOD
            tell(seconds=seconds)


class Wishes:
    """What the console wants of a replay, as a key of `play`: space where it must begin or end a pause."""

    def __init__(self, controls: Controls, progress: Progress) -> None:
        self._controls, self._progress = controls, progress

    def __call__(self) -> str:
        """A key, or nothing."""
        if not select.select([0], [], [], 0.0)[0]:
            return ""
        byte = os.read(0, 1)
        if byte not in (PAUSE, GO_ON) or (byte == PAUSE) == self._controls.paused:
            return ""
        tell(seconds=self._progress.seconds, paused=byte == PAUSE)
        return " "


def play_run(endpoint: str, domain: str, run: str, rate: str, start: str) -> None:
    """Raises LogError, BusError, ReplayError."""
    controls, progress = Controls(rate=float(rate)), Progress()
    with Bus(endpoint, "replay", Scope(int(domain))) as bus:
        check = alone(bus)  # another robot on this router may have that domain
        report = play(
            *(bus, Path(run)),
            controls=controls,
            check=check,
            start_offset=float(start),
            patterns=["*"],
            key=Wishes(controls, progress),
            progress=progress,
        )
    tell(seconds=report.seconds, words=f"{report.messages} messages")


def run_again(run: str, out: str, stages: str, *sets: str) -> None:
    """The new log in a folder that is listed as a run. Raises ConfigError, LogError."""
    folder = Path(out)
    folder.mkdir(mode=0o700)
    log = folder / "log_0.mcap"
    began = time.monotonic()
    try:
        counts = rerun(Path(run), stages.split(","), log, sets=sets, progress=Progress())
        (folder / "config.yaml").write_bytes(first_of(log).attachments[CONFIG])
    except BaseException:
        shutil.rmtree(folder)
        raise
    wall = time.monotonic() - began
    words = [f"{sum(counts.values())} messages in {wall:.0f} s"]
    before, after = _track(Path(run)), _track(folder)
    common = sorted(before.keys() & after.keys())
    if common:
        apart = [math.dist(before[stamp], after[stamp]) for stamp in common]
        words.append(f"poses at most {max(apart):.3f} m apart, {apart[-1]:.3f} m at the end")
    gone = {name: s.count for name, s in overview(Path(run)).topics.items()}
    changed = [f"{name} {gone[name]} -> {n}" for name, n in sorted(counts.items()) if gone.get(name, n) != n]
    words += [f"other counts: {', '.join(changed)}"] if changed else []
    tell(words="; ".join(words))


def _track(run: Path) -> dict[int, tuple[float, float, float]]:
    """Place of the robot in `odom` [m] by the stamp of the scan [ns]."""
    found = {}
    for entry in read_run(run):
        if entry.topic == t.ODOM.name:
            message: Any = decode(entry.data, t.ODOM.kind)
            place, stamp = message.pose.pose.position, message.header.stamp
            found[stamp.sec * 10**9 + stamp.nanosec] = (place.x, place.y, place.z)
    return found


def main(what: str, *arguments: str) -> int:
    """Exit status."""
    prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    os.nice(10)
    try:
        if what == "replay":
            play_run(*arguments)
        else:
            run_again(*arguments)
    except OperatorError as error:
        tell(wrong=str(error))
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
