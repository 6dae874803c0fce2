"""Trials on worker processes: deaths on either side. The workers import this file, so it imports little."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from dask import config

from tools.bench.ports import free_port
from tools.bench.spread import SchedulerLost, TrialsFailed, spread


def square_or_die(folder: str, n: int) -> dict[str, int]:
    """The first time it meets 3, the worker is killed."""
    marker = Path(folder) / "died"
    if n == 3 and not marker.exists():
        marker.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    if n == 5:
        raise ValueError("five")
    return {"n": n, "square": n * n}


def test_a_dead_worker_costs_no_trial_an_error_is_told_at_the_end_and_two_workers_tell_what_one_tells(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tools.bench.spread.TRIALS_AHEAD", 3)  # more trials than are handed over at once
    got = []
    records = spread(square_or_die, [(str(tmp_path), n) for n in range(7)], 2)
    with pytest.raises(TrialsFailed, match="1 of 7 trials failed, the first with ValueError: five"):
        got.extend(record["square"] for record in records)
    assert (tmp_path / "died").exists()
    alone = [r["square"] for r in spread(square_or_die, [(str(tmp_path), n) for n in (0, 1, 2, 3, 4, 6)], 0)]
    assert sorted(got) == alone == [0, 1, 4, 9, 16, 36]


def pause_or_square(n: int) -> dict[str, int]:
    """The first trial is quick; the others outlast the scheduler."""
    time.sleep(60.0 if n else 0.0)
    return {"n": n}


def test_a_dead_scheduler_is_told_in_one_line_and_what_is_done_is_kept() -> None:
    port = free_port()
    address = f"tcp://127.0.0.1:{port}"
    dask = [sys.executable, "-m"]
    scheduler = subprocess.Popen(
        [
            *dask,
            "distributed.cli.dask_scheduler",
            "--host",
            "127.0.0.1",
            "--port",
            str(port),
            "--no-dashboard",
        ],
        stderr=subprocess.PIPE,
        text=True,
    )
    assert scheduler.stderr is not None
    assert any("Scheduler at" in line for line in scheduler.stderr), "it listens"
    worker = subprocess.Popen(
        # All five trials at once: which one a single thread takes first is not told.
        [*dask, "distributed.cli.dask_worker", address, "--nthreads", "5", "--no-nanny", "--no-dashboard"],
        stderr=subprocess.DEVNULL,
    )
    got: list[int] = []

    def spread_and_kill() -> None:
        for record in spread(pause_or_square, [(n,) for n in range(5)], 0, address):
            got.append(record["n"])
            scheduler.kill()

    waits = config.set({"distributed.comm.timeouts.connect": "1s"})  # for one that comes back
    try:
        with waits, pytest.raises(SchedulerLost, match="its workers, then give the same command again"):
            spread_and_kill()
    finally:
        for process in (scheduler, worker):
            process.kill()
            process.wait()
    assert got == [0]
