"""A stack of its own for the benchmarks that drive a running `up`."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from rbtrg_robot.wire.bus import Bus
from tools.bench.ports import free_port
from tools.bench.report import Report


@contextmanager
def running(
    report: Report, folder: Path, logs: Path, *arguments: str, ended: bool = False, cold: bool = False
) -> Iterator[Bus]:
    """`up --detach` with its runtime files in `folder`, and a bus beside it; adds `start_s` and `down_s`. `ended`: the
    caller ends it. `cold`: no kernel is kept, as at the first start of all."""
    environment = {**os.environ, "XDG_RUNTIME_DIR": str(folder)}
    if cold:
        environment["NUMBA_CACHE_DIR"] = str(folder / "kernels")
    port = free_port()
    began = time.monotonic()
    _command(["up", "--detach", "--port", str(port), "--log-dir", str(logs), *arguments], environment)
    report.add("start_s", time.monotonic() - began, "s", 60.0 if cold else 12.0)
    try:
        with Bus(f"tcp/127.0.0.1:{port}", "bench") as bus:
            yield bus
    finally:
        began = time.monotonic()
        _command(["down"], environment, fails=ended)
        report.add("down_s", time.monotonic() - began, "s", 3.0)


def _command(arguments: list[str], environment: dict[str, str], *, fails: bool = False) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "rbtrg_robot.cli", *arguments],
        env=environment,
        capture_output=True,
        text=True,
        timeout=900,
        check=False,
    )
    if done.returncode and not fails:
        raise SystemExit(f"{' '.join(arguments)} failed: {done.stderr.strip()}")
