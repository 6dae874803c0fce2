"""Host, motor loop and watchdog as processes on loopback DDS: each of them dies, and the motors go soft."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Iterator

import psutil
import pytest

from hal.unitree.low.watch import silence

pytest.importorskip("cyclonedds", reason="the unitree extra is not installed")
from hal.lidar.config import only
from hal.types import ModeRequest, Phase, VelocityCommand
from hal.unitree.config import UnitreeConfig
from hal.unitree.low.backend import LowLevelBackend
from hal.unitree.low.handle import MotorProcess
from tests.hal.unitree.peer_process import PeerProcess

DOMAIN = 20 + (os.getpid() + 7) % 200
OPTIONS = UnitreeConfig(level="low", tried=("vmc",), lidars=only("xt16"), domain=DOMAIN)


@pytest.fixture
def pipe() -> Iterator[tuple[int, int]]:
    """Reading and writing end."""
    ends = os.pipe()
    yield ends
    for end in ends:
        try:
            os.close(end)
        except OSError:
            assert end == ends[1], "the test closes the writing end at most"


def test_the_watch_ends_with_the_word_of_the_loop(pipe: tuple[int, int]) -> None:
    os.write(pipe[1], b"tte")
    assert silence(pipe[0]) == ""


def test_the_watch_notices_a_loop_that_hangs_and_one_that_dies(pipe: tuple[int, int]) -> None:
    os.write(pipe[1], b"t")
    assert "no command for 0.09 s" in silence(pipe[0])
    os.write(pipe[1], b"t")
    os.close(pipe[1])
    assert silence(pipe[0]) == "the motor loop is gone"


class Host:
    """A backend that is read and driven at 100 Hz."""

    def __init__(self) -> None:
        self.peer = PeerProcess(DOMAIN, "--body", "motors", "--lying", "--lidar-step", "40")
        self.backend = LowLevelBackend("lo", DOMAIN, OPTIONS, "vmc")

    def run(self, seconds: float, vx: float = 0.0) -> None:
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline:
            now = time.time_ns()
            self.backend.read(now)
            self.backend.drive(VelocityCommand(now, vx=vx))
            time.sleep(0.01)

    def until(self, phase: Phase, seconds: float = 30.0) -> None:
        deadline = time.monotonic() + seconds
        while self.backend.state().phase is not phase:
            assert time.monotonic() < deadline, f"no {phase}: {self.backend.state()}"
            self.run(0.05)

    @property
    def loop(self) -> psutil.Process:
        assert isinstance(self.backend._motors, MotorProcess)
        return psutil.Process(self.backend._motors.pid)


@pytest.fixture
def host() -> Iterator[Host]:
    host = Host()
    try:
        yield host
    finally:
        host.backend.close()
        host.peer.end()


def test_the_processes_stand_the_robot_up_and_the_motors_go_soft_when_the_loop_is_killed(host: Host) -> None:
    host.backend.connect()
    assert host.backend.state().phase is Phase.SITTING
    loop = host.loop
    (watch,) = loop.children()
    host.backend.request(ModeRequest.STAND)
    host.until(Phase.STANDING)
    host.peer.until(lambda: host.peer.last["stiff"])
    loop.send_signal(signal.SIGKILL)
    host.peer.until(lambda: not host.peer.last["stiff"])
    host.until(Phase.FAULT)
    assert "motor loop" in host.backend.state().cause
    watch.wait(60.0)  # it ends by itself, once the robot lies


def test_no_process_is_left_when_the_host_is_killed() -> None:
    """It lies down first."""
    # The host is this very process: closing its end of the pipe is what its death does.
    host = Host()
    try:
        host.backend.connect()
        processes = [host.loop, *host.loop.children()]
        assert isinstance(host.backend._motors, MotorProcess)
        stdin = host.backend._motors._process.stdin
        assert stdin is not None
        stdin.close()
        gone, alive = psutil.wait_procs(processes, 60.0)
        assert not alive
        assert len(gone) == 2
        host.peer.until(lambda: not host.peer.last["stiff"])
    finally:
        host.backend.close()
        host.peer.end()
