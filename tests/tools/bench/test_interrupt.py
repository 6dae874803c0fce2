"""Ctrl-C on a bench: one line, no traceback, no worker left."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time

import psutil

PATIENCE = 60.0
"""[s]"""


def workers_of(bench: psutil.Process) -> list[psutil.Process]:
    """Its worker processes."""
    return [p for p in bench.children(recursive=True) if any("spawn_main" in word for word in p.cmdline())]


def test_ctrl_c_ends_a_bench_and_its_workers_with_one_line() -> None:
    command = [sys.executable, "-m", "tools.bench", "lanes", "--seeds", "0-3", "--workers", "1"]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, start_new_session=True
    ) as bench:
        end = time.monotonic() + PATIENCE
        while not (workers := workers_of(psutil.Process(bench.pid))):
            assert bench.poll() is None
            assert time.monotonic() < end
            time.sleep(0.05)
        os.killpg(bench.pid, signal.SIGINT)  # as a terminal does: everybody in the foreground gets it
        told, _ = bench.communicate(timeout=PATIENCE)
    assert bench.returncode == 130
    assert told == "error: lanes was interrupted before its rows were known\n"
    assert not psutil.wait_procs(workers, timeout=PATIENCE)[1]
