"""A real `up` on a robot behind DDS: its process dies while the robot is out of reach, and comes back with it."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from rbtrg_robot.processes import PROCESSES
from tests.hal.unitree.peer_process import PeerProcess
from tools.bench.ports import free_port

pytest.importorskip("cyclonedds")
pytestmark = pytest.mark.timeout(300)
DOMAIN = 100 + os.getpid() % 100


def test_a_robot_process_that_dies_while_the_cable_is_out_comes_back_with_the_robot(tmp_path: Path) -> None:
    port = free_port()

    def command(*arguments: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [sys.executable, "-m", "rbtrg_robot.cli", *arguments],
            capture_output=True,
            text=True,
            env={**os.environ, "XDG_RUNTIME_DIR": str(tmp_path)},
            timeout=120.0,
            check=False,
        )

    def until(condition: Callable[[dict[str, Any]], bool], limit: float = 60.0) -> dict[str, Any]:
        end = time.monotonic() + limit
        while True:
            row: dict[str, Any] = json.loads(command("status", "--json").stdout)["processes"][0]
            if condition(row):
                return row
            assert time.monotonic() < end, row

    peer = PeerProcess(DOMAIN)
    try:
        up = command(
            *("up", "--detach", "--backend", "unitree", "--interface", "lo"),
            *("--no-record", "--port", str(port)),
            *("--set", f"unitree.domain={DOMAIN}", "--set", "unitree.connect_timeout=5.0"),
            *("--log-dir", str(tmp_path / "logs")),
            *(f"--without={p.name}" for p in PROCESSES if p.name != "robot"),
        )
        assert up.returncode == 0, up.stderr
        peer.end()
        os.kill(until(lambda row: row["state"] == "ready")["pid"], signal.SIGKILL)
        away = until(lambda row: row["restarts"] >= 3)
        assert "no LowState from the robot" in away["state"]
        peer = PeerProcess(DOMAIN)
        back = until(lambda row: row["state"] == "ready")
        assert back["restarts"] >= 3
    finally:
        peer.end()
        down = command("down")
    assert down.returncode == 0, down.stderr
