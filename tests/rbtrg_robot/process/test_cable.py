"""A real `up` on a robot behind DDS: its process dies while the robot is out of reach, and comes back with it."""

from __future__ import annotations

import json
import os
import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from rbtrg_robot.processes import PROCESSES
from tests.hal.unitree.peer_process import PeerProcess
from tests.rbtrg_robot.process.command import command
from tools.bench.ports import free_port

pytest.importorskip("cyclonedds")
pytestmark = pytest.mark.timeout(300)
DOMAIN = 100 + os.getpid() % 100


@pytest.mark.campaign
def test_a_robot_process_that_dies_while_the_cable_is_out_comes_back_with_the_robot(tmp_path: Path) -> None:
    port = free_port()

    def until(condition: Callable[[dict[str, Any]], bool], limit: float = 60.0) -> dict[str, Any]:
        end = time.monotonic() + limit
        while True:
            row: dict[str, Any] = json.loads(command(tmp_path, "status", "--json").stdout)["processes"][0]
            if condition(row):
                return row
            assert time.monotonic() < end, row
            time.sleep(0.1)

    peer = PeerProcess(DOMAIN)
    try:
        up = command(
            tmp_path,
            *("up", "--detach", "--backend", "unitree", "--interface", "lo"),
            *("--no-record", "--port", str(port)),
            *("--set", f"unitree.domain={DOMAIN}", "--set", "unitree.connect_timeout=3.0"),
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
        down = command(tmp_path, "down")
    assert down.returncode == 0, down.stderr
