"""A robot's computer has neither simulator nor open3d: everything it runs starts without them."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from tests.places import ROOT

HIDE = """
import importlib.metadata, sys
HIDDEN = ("mujoco", "open3d")
sys.modules.update(dict.fromkeys(HIDDEN))
version = importlib.metadata.version
def hidden(name):
    if name in HIDDEN:
        raise importlib.metadata.PackageNotFoundError(name)
    return version(name)
importlib.metadata.version = hidden
"""


def without_simulator(code: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", HIDE + code],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=150,
        check=False,
    )


COMMANDS = ("--help", "config show --set backend=unitree --set interface=eth0", "scene list")


def test_the_robots_commands_processes_and_doctor_need_no_simulator_and_up_says_what_to_install(
    tmp_path: Path,
) -> None:
    done = without_simulator(
        f"""
import rbtrg_robot.hosts.live, rbtrg_robot.hosts.robot, rbtrg_robot.process.child, rbtrg_robot.process.zygote
import rbtrg_robot.process.supervisor, rbtrg_robot.log.recorder, hal.unitree.backend
from rbtrg_robot.cli.main import main
from rbtrg_robot.config import load
from rbtrg_robot.hosts.lockstep import build_stages
from rbtrg_robot.process.doctor import REQUIRED, Level, _library, _simulator

for command in {COMMANDS}:
    sys.argv = ["rbtrg-robot", *command.split()]
    try:
        main()
    except SystemExit as ended:
        print("status", ended.code)

config = load(None, ["backend=unitree", "interface=eth0"])
assert config.metadata()["package.mujoco"] == "not installed"
print(sorted(build_stages(config, ["odometry", "elevation", "planner", "tracker"])))

assert all(_library(name).level is Level.OK for name in REQUIRED)
print(_simulator().level.name, _simulator().words)

sys.argv = ["rbtrg-robot", "up", "--log-dir", {str(tmp_path)!r}, "--robot", "bare", "--port", "7993"]
main()
"""
    )
    assert done.returncode == 1
    assert "rbtrg-robot[sim]" in done.stderr
    assert "Traceback" not in done.stderr
    assert list(tmp_path.iterdir()) == []
    help_, config, scenes, rest = done.stdout.split("status 0\n")
    assert "Usage" in help_
    assert "interface: eth0" in config
    assert "yard" in scenes
    stages, doctor = rest.splitlines()
    assert stages == "['elevation', 'odometry', 'planner', 'tracker']"
    assert doctor.startswith("NOTE no simulated robot"), "the missing simulator is no fault"
    assert "rbtrg-robot[sim]" in doctor
