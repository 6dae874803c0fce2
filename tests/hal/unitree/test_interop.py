"""The robot's DDS version survives ours. Needs a Python with `cyclonedds==0.10.2`, named by CYCLONEDDS_0_10_PYTHON."""

from __future__ import annotations

import os
import subprocess
import time
from pathlib import Path

import pytest

pytest.importorskip("cyclonedds", reason="the unitree extra is not installed")
from hal.lidar.config import only
from hal.types import ImuSample, Phase, VelocityCommand
from hal.unitree.backend import UnitreeBackend
from hal.unitree.config import UnitreeConfig
from hal.unitree.layout import LOW_STATE_CDR, SPORT_MODE_STATE_CDR

PYTHON = os.environ.get("CYCLONEDDS_0_10_PYTHON", "")
SCRIPT = Path(__file__).parent / "old_peer.py"
DOMAIN = 180 + os.getpid() % 50


def offset(dtype, name: str) -> str:
    return str(dtype.fields[name][1])


@pytest.mark.skipif(not PYTHON, reason="CYCLONEDDS_0_10_PYTHON does not name a Python with cyclonedds 0.10.2")
def test_a_peer_on_cyclone_0_10_serves_us_and_lives():
    offsets = (
        offset(LOW_STATE_CDR, "tick"),
        offset(SPORT_MODE_STATE_CDR, "mode"),
        offset(SPORT_MODE_STATE_CDR, "body_height"),
    )
    peer = subprocess.Popen(
        [PYTHON, str(SCRIPT), str(DOMAIN), *offsets], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    try:
        assert peer.stdout is not None
        assert peer.stdin is not None
        assert peer.stdout.readline() == "old peer up\n"
        # All topics we ever announce, the cloud and the L1 included.
        backend = UnitreeBackend("lo", DOMAIN, UnitreeConfig(lidars=only("l1"), sit_on_close=False))
        backend.connect()
        samples = []
        deadline = time.monotonic() + 3.0
        while time.monotonic() < deadline:
            now = time.time_ns()
            samples += backend.read(now)
            backend.drive(VelocityCommand(now, vx=0.3))
            time.sleep(0.01)
        assert backend.state().phase is Phase.READY
        assert len([s for s in samples if isinstance(s, ImuSample)]) > 50
        backend.close()
        assert peer.poll() is None, "the older DDS died when it discovered our types"
        out, _ = peer.communicate("\n", timeout=20.0)
        lines = out.splitlines()
        assert lines[0].startswith("motion_switcher 1001")
        assert 'sport 1008 {"x": 0.3, "y": 0.0, "z": 0.0}' in lines
        assert peer.returncode == 0
    finally:
        peer.kill()
