"""`rbtrg-robot teleop` in a real terminal, against a made-up robot: it drives while a key is held, and lets go."""

from __future__ import annotations

import os
import pty
import select
import subprocess
import sys
import time
from pathlib import Path

import pytest

from rbtrg_robot.orders.keys import FIRST_HOLD, REPEATED_HOLD, HeldKeys
from rbtrg_robot.process.runfiles import RunLock
from tools.bench.console.stack import Robot

LIMIT = 60.0
"""[s]"""


def test_a_key_counts_until_its_repeats_end() -> None:
    keys = HeldKeys()
    assert keys.want(0.0) is None
    keys.press("w", 1.0)
    assert keys.want(1.0 + 0.9 * FIRST_HOLD) == (1.0, 0.0)
    keys.press("w", 1.5)
    keys.press("w", 1.53)
    keys.press("a", 1.53)
    assert keys.want(1.6) == (1.0, 1.0)
    assert keys.want(1.53 + 1.1 * REPEATED_HOLD) == (0.0, 1.0)
    assert keys.want(1.53 + 1.1 * FIRST_HOLD) is None
    keys.press("s", 3.0)
    keys.press("\x1b[A", 3.0)
    assert keys.want(3.1) == (0.0, 0.0)
    keys.clear()
    assert keys.want(3.1) is None


def test_it_drives_while_a_key_is_held_and_stops(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    robot = Robot()
    lock = RunLock("go2w")
    lock.write_state(
        endpoint=f"tcp/127.0.0.1:{robot.port}", domain=0, ready=True, backend="sim", scene="yard"
    )
    ours, theirs = pty.openpty()
    child = subprocess.Popen(
        [sys.executable, "-m", "rbtrg_robot.cli", "teleop", "--speed", "0.5"],
        stdin=theirs,
        stdout=theirs,
        stderr=theirs,
        env=dict(os.environ),
    )
    end = time.monotonic() + LIMIT
    seen = b""

    def until(what: object) -> None:
        nonlocal seen
        while not (what in seen if isinstance(what, bytes) else what()):  # type: ignore[operator]
            assert time.monotonic() < end, seen
            if select.select([ours], [], [], 0.05)[0]:  # it tells its state ten times a second
                seen += os.read(ours, 4096)

    try:
        until(b"ready")
        assert robot.driven == []
        os.write(ours, b"w")
        until(lambda: bool(robot.driven) and robot.driven[-1][1:] == (0.0, 0.0))
        assert {(v, w) for _, v, w in robot.driven} == {(0.5, 0.0), (0.0, 0.0)}
        os.write(ours, b"\x1b[D")
        until(lambda: robot.driven[-1][1:] == (0.0, 1.0))
        os.write(ours, b" ")
        until(b"stopped: operator")
        until(lambda: robot.driven[-1][1:] == (0.0, 0.0))
        os.write(ours, b"r")
        until(b"resumed")
        seen = b""
        os.write(ours, b" q")  # an order that is under way is carried out before it leaves
        until(b"stopped: operator")
        until(lambda: child.poll() is not None)
        assert child.returncode == 0
    finally:
        child.kill()
        child.wait()
        lock.release()
        robot.close()
        os.close(ours)
        os.close(theirs)
