"""Two real `up` on one router: what one is told does not reach the other, both are seen from one place, a third of
their name is refused."""

from __future__ import annotations

import http.client
import json
import os
import socket
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from rbtrg_robot.process.runfiles import console_address
from tools.bench.ports import free_port

pytestmark = [pytest.mark.timeout(300), pytest.mark.campaign]
START_LIMIT, LIMIT = 200.0, 60.0
JOIN = ("--set", "network.join=true")
ABSENT = ("recorder", "mission", "odometry", "elevation", "planner", "navigator", "tracker", "guard")
"""Robot and console are enough to see whom a command reaches."""


def command(*words: str) -> list[str]:
    return [sys.executable, "-m", "rbtrg_robot.cli", *words]


def listening(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


def statuses() -> dict[str, Any]:
    done = subprocess.run(
        command("status", "--all", "--json"), capture_output=True, timeout=LIMIT, check=True
    )
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def test_two_robots_live_side_by_side(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    few = ["--no-record", "--console-port", "0"]
    for process in ABSENT:
        few += ["--without", process]
    starts = []
    port = free_port()

    def up(name: str, *more: str) -> list[str]:
        words = ("up", "--robot", name, "--scene", "flat", "--port", str(port), *few, *more)
        return command(*words, "--log-dir", str(tmp_path / name))

    try:
        starts.append(subprocess.Popen(up("a", "--detach"), env=dict(os.environ)))
        until = time.monotonic() + LIMIT
        while not listening(port) and time.monotonic() < until:
            time.sleep(0.05)
        starts.append(subprocess.Popen(up("b", "--detach", *JOIN), env=dict(os.environ)))
        assert [start.wait(START_LIMIT) for start in starts] == [0, 0]
        # Somebody else on this computer, whose run folder knows of no `b`.
        other = {**os.environ, "XDG_RUNTIME_DIR": str(tmp_path / "other")}
        refused = subprocess.run(up("b", *JOIN), env=other, capture_output=True, text=True, timeout=LIMIT)
        assert refused.returncode == 1
        assert "a stack of robot 'b' is on the router" in refused.stderr.splitlines()[-1]
        before = statuses()
        assert sorted(before) == ["a", "b"]
        assert all(row["state"] == "ready" for s in before.values() for row in s["processes"])
        subprocess.run(command("posture", "sit", "--robot", "b"), timeout=LIMIT, check=True)
        subprocess.run(command("stop", "--robot", "a"), timeout=LIMIT, check=True)
        after = statuses()
        assert after["b"]["robot"]["mode"] == "sitting"
        assert after["a"]["robot"]["mode"] == "stopped"
        assert [after[name]["robot"]["estop"] for name in "ab"] == [True, False]
        # The console of one shows both.
        address = console_address("a")
        host = address.split("/")[2]
        client = http.client.HTTPConnection(host, timeout=LIMIT)
        client.request("GET", "/enter" + address.partition("/enter")[2])
        answer = client.getresponse()
        answer.read()
        cookie = answer.headers["set-cookie"].partition(";")[0]
        client.request("GET", "/robots", headers={"Cookie": cookie})
        rows = json.loads(client.getresponse().read())
        assert [row["name"] for row in rows] == ["a", "b"]
        assert "E-STOP" in rows[0]["lines"][0]
        assert "E-STOP" not in rows[1]["lines"][0]
    finally:
        for start in starts:
            start.kill()
            start.wait()
        for name in "ba":
            subprocess.run(command("down", "--robot", name), timeout=LIMIT, check=False)
