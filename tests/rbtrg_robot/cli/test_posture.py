"""`rbtrg-robot posture` against a robot that answers as it is told to."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from rbtrg_robot import topics as t
from rbtrg_robot.process.runfiles import RunLock
from rbtrg_robot.wire.bus import Bus
from rbtrg_robot.wire.messages import header
from tools.bench.ports import free_endpoint


@pytest.mark.parametrize(
    ("what", "answer", "status", "told"),
    [
        ("sit", ("sitting", "seated", False), 0, "sitting: seated"),
        (
            "sit",
            ("ready", "dry run, nothing is sent: balance stand", False),
            0,
            "ready: dry run, nothing is sent",
        ),
        ("recover", ("fault", "fallen: it could not turn itself over", False), 1, "fault: fallen"),
        ("stand", ("sitting", "seated; stand refused: stop is latched", True), 1, "refused: stop is latched"),
        ("recover", ("stopped", "standing", True), 0, "`rbtrg-robot resume` lets it drive"),
        ("sit", ("moving", "driving", False), 1, "no `sit` within 2 s (moving: driving)"),
    ],
)
def test_posture_orders_shows_the_progress_and_ends(
    what: str,
    answer: tuple[str, str, bool],
    status: int,
    told: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    endpoint = free_endpoint()
    phase, cause, estop = answer
    ordered = set()
    lock = RunLock("go2w")
    try:
        with Bus(endpoint, "robot", router=True) as bus:
            bus.subscribe([t.ROBOT_COMMAND])
            lock.write_state(endpoint=endpoint, domain=0, ready=True)
            child = subprocess.Popen(
                [sys.executable, "-m", "rbtrg_robot.cli", "posture", what, "--timeout", "2"],
                env=dict(os.environ),
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
            )
            while child.poll() is None:
                ordered |= {received.decode().mode for received in bus.take(0.05)}
                if ordered:
                    state = t.ROBOT_STATE.kind(
                        header=header(0, "base_link"),
                        phase=phase,
                        cause=cause,
                        estop=estop,
                    )
                    bus.publish(t.ROBOT_STATE, state, 0)
            output, _ = child.communicate()
    finally:
        lock.release()
    assert ordered == {what}
    assert child.returncode == status, output
    assert told in output
    assert "Traceback" not in output
