"""Our controllers at the motors of the vendor's public simulator, over DDS, in the simulator's own time.

Needs a checkout of `unitree_mujoco`, named by UNITREE_MUJOCO, and a Python with its SDK (`unitree_sdk2py` with
cyclonedds 0.10.2), mujoco and pygame, named by CYCLONEDDS_0_10_PYTHON. It steps by its own 5 ms.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import threading
import time
import xml.etree.ElementTree as Xml
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import psutil
import pytest

pytest.importorskip("cyclonedds", reason="the unitree extra is not installed")
from hal.types import ModeRequest, Phase, VelocityCommand
from hal.unitree.config import UnitreeConfig
from hal.unitree.low.backend import LowLevelBackend
from hal.unitree.low.handle import MotorProcess
from tests.places import SHARED

CHECKOUT, PYTHON = os.environ.get("UNITREE_MUJOCO", ""), os.environ.get("CYCLONEDDS_0_10_PYTHON", "")
SCRIPT = Path(__file__).parent / "vendor_simulator.py"
DOMAIN = 20 + (os.getpid() + 31) % 200

pytestmark = [
    pytest.mark.skipif(
        not (CHECKOUT and PYTHON),
        reason="UNITREE_MUJOCO and CYCLONEDDS_0_10_PYTHON name no simulator of the vendor",
    ),
    pytest.mark.timeout(600),  # a busy machine is slower, and nothing else
]


def scene(folder: Path) -> Path:
    """The vendor's model on a floor with a step of 15 cm, 0.8 m before the robot. Meshes that are only looked at may be
    missing in the checkout."""
    source = SHARED / "data" / "robots" / "unitree_go2w"
    source = source if source.is_dir() else Path(CHECKOUT) / "unitree_robots" / "go2w"
    shutil.copytree(source, folder, dirs_exist_ok=True)
    tree = Xml.parse(folder / "go2w.xml")
    there, gone = {path.name for path in (folder / "assets").iterdir()}, set()
    for assets in tree.iter("asset"):
        for mesh in list(assets.findall("mesh")):
            if (file := mesh.get("file", "")) not in there:
                gone.add(mesh.get("name") or Path(file).stem)
                assets.remove(mesh)
    for body in tree.iter("body"):
        for geom in list(body.findall("geom")):
            if geom.get("mesh") in gone:
                body.remove(geom)
    tree.write(folder / "go2w.xml")
    root = Xml.Element("mujoco")
    Xml.SubElement(root, "include", file="go2w.xml")
    world = Xml.SubElement(root, "worldbody")
    Xml.SubElement(world, "geom", type="plane", size="0 0 0.05")
    Xml.SubElement(world, "geom", type="box", size="2 2 0.075", pos="2.8 0 0.075")
    Xml.ElementTree(root).write(folder / "scene.xml")
    return folder / "scene.xml"


class Vendor:
    """The simulator as a process, and our backend, read and driven at 100 Hz."""

    def __init__(self, folder: Path, controller: str) -> None:
        command = [PYTHON, str(SCRIPT), CHECKOUT, str(scene(folder)), str(DOMAIN)]
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        self.truth: dict[str, Any] = {}
        assert self.process.stdout is not None
        self.truth.update(json.loads(self.process.stdout.readline()))
        threading.Thread(target=self._collect, daemon=True).start()
        options = UnitreeConfig(level="low", tried=(controller,), lidars=(), domain=DOMAIN, law_age=0.012)
        self.backend = LowLevelBackend("lo", DOMAIN, options, controller)

    def _collect(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            self.truth.update(json.loads(line))

    def run(self, seconds: float, vx: float = 0.0, wz: float = 0.0) -> None:
        """For so many seconds of the simulation."""
        deadline = self.truth["t"] + seconds
        while self.truth["t"] < deadline:
            assert self.process.poll() is None, "the simulator ended"
            now = time.time_ns()
            self.backend.read(now)
            self.backend.drive(VelocityCommand(now, vx=vx, wz=wz))
            time.sleep(0.01)

    def until(self, phase: Phase, seconds: float) -> None:
        deadline = self.truth["t"] + seconds
        while self.backend.state().phase is not phase:
            assert self.truth["t"] < deadline, f"no {phase}: {self.backend.state()}"
            self.run(0.05)

    def stand(self) -> None:
        self.backend.request(ModeRequest.STAND)
        self.until(Phase.READY, 12.0)
        self.run(1.0)
        assert self.truth["z"] > 0.33

    def end(self) -> None:
        self.backend.close()
        assert self.process.stdin is not None
        self.process.stdin.close()
        self.process.wait(10.0)


@pytest.fixture
def vendor(tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[Vendor]:
    made = Vendor(tmp_path, request.param)
    try:
        made.backend.connect()
        yield made
    finally:
        made.end()


@pytest.mark.parametrize("vendor", ["vmc"], indirect=True)
def test_it_stands_drives_turns_stops_and_sits(vendor: Vendor) -> None:
    assert vendor.backend.state().phase is Phase.SITTING
    vendor.stand()
    before = vendor.truth["x"]
    vendor.run(2.0, vx=0.3)
    assert vendor.truth["x"] - before > 0.15
    vendor.backend.request(ModeRequest.STOP)
    vendor.run(1.0, vx=0.3)
    assert vendor.truth["v"] < 0.05, "a stop holds against a velocity"
    vendor.backend.request(ModeRequest.RESUME)
    vendor.run(2.0, vx=-0.3)
    yaw = vendor.truth["yaw_sine"]
    vendor.run(3.0, wz=0.5)
    assert vendor.truth["yaw_sine"] - yaw > 0.3
    vendor.run(1.0)
    vendor.backend.request(ModeRequest.SIT)
    vendor.until(Phase.SITTING, 10.0)
    vendor.run(4.0)  # it folds its legs
    assert vendor.truth["z"] < 0.25
    assert vendor.truth["up"] > 0.98


@pytest.mark.parametrize("vendor", ["hybrid"], indirect=True)
def test_it_climbs_a_step_of_15_cm(vendor: Vendor) -> None:
    vendor.stand()
    deadline = vendor.truth["t"] + 25.0
    while vendor.truth["x"] < 1.4 and vendor.truth["t"] < deadline:
        vendor.run(0.2, vx=0.4)
        assert vendor.truth["up"] > 0.7
    assert vendor.truth["x"] >= 1.4
    vendor.run(1.5)
    assert vendor.truth["z"] > 0.47, "up by the height of the step"


@pytest.mark.parametrize("vendor", ["vmc"], indirect=True)
def test_the_motors_go_soft_when_the_loop_is_killed(vendor: Vendor) -> None:
    vendor.stand()
    assert isinstance(vendor.backend._motors, MotorProcess)
    psutil.Process(vendor.backend._motors.pid).kill()
    vendor.until(Phase.FAULT, 2.0)
    vendor.run(3.0)
    assert vendor.truth["z"] < 0.25, "it sinks"
    assert vendor.truth["up"] > 0.7, "it lies, and has not fallen over"
