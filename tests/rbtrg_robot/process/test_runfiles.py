"""One robot, one stack."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from rbtrg_robot.process.runfiles import RobotTaken, take_interface


def test_two_stacks_on_one_interface_are_refused_and_the_death_of_one_frees_it() -> None:
    interface = f"test{os.getpid()}"
    script = (
        "import sys; from rbtrg_robot.process.runfiles import take_interface;"
        f"held = take_interface({interface!r}, None); print('held', flush=True); sys.stdin.read()"
    )
    other = subprocess.Popen([sys.executable, "-c", script], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    try:
        assert other.stdout is not None
        assert other.stdout.readline() == b"held\n"
        with pytest.raises(RobotTaken, match=interface):
            take_interface(interface, None)
        take_interface(interface, 5).close()  # another DDS domain: another robot
        other.kill()
    finally:
        other.kill()
        other.communicate()
    take_interface(interface, None).close()
