"""`foxglove` as a command: it says where it listens and what it takes, and Ctrl-C ends it."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from websockets.sync.client import connect

from rbtrg_robot import topics as t
from rbtrg_robot.process.runfiles import RunLock
from rbtrg_robot.wire.bus import Bus
from tools.bench.ports import free_endpoint

LIMIT = 30.0


@pytest.fixture
def stack(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A router where the command finds it."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    endpoint = free_endpoint()
    lock = RunLock("go2w")
    try:
        with Bus(endpoint, "stack", router=True):
            lock.write_state(endpoint=endpoint, domain=0, ready=True, backend="sim", scene="flat")
            yield
    finally:
        lock.release()


@pytest.mark.parametrize(
    ("words", "takes"),
    [
        ([], "goals and the stop"),
        (["--view-only"], "only the stop"),
        (
            ["--host", "127.0.0.2"],
            "only the stop",
        ),  # not the address of this computer alone, as far as is known
    ],
)
def test_it_serves_until_ctrl_c(stack: None, words: list[str], takes: str) -> None:
    child = subprocess.Popen(
        [sys.executable, "-m", "rbtrg_robot.cli", "foxglove", "--port", "0", *words],
        env=dict(os.environ),
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    try:
        assert child.stdout is not None
        line = child.stdout.readline()
        assert takes in line
        with connect(line.split(",")[0], subprotocols=["foxglove.sdk.v1"]) as client:  # type: ignore[list-item]
            assert json.loads(client.recv(LIMIT))["name"] == "rbtrg-robot"
            assert len(json.loads(client.recv(LIMIT))["channels"]) == len(t.TOPICS)
            child.send_signal(signal.SIGINT)
            assert child.wait(LIMIT) == 0
    finally:
        child.kill()
        child.wait()
