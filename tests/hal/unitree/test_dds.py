"""The Unitree backend and the peer as processes on loopback DDS: driving, deaths on either side, no orphans."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator

import numpy as np
import psutil
import pytest

pytest.importorskip("cyclonedds", reason="the unitree extra is not installed")
from hal.contract import BackendError
from hal.types import NS, ImuSample, LidarScan, ModeRequest, Phase, VelocityCommand
from hal.unitree.backend import UnitreeBackend
from hal.unitree.config import UnitreeConfig
from hal.unitree.factory import make_backend
from tests.hal.unitree.peer_process import PeerProcess
from tests.places import ROOT

DRIVER = """
import signal, sys, time
# A KeyboardInterrupt may land in a callback of the DDS library, where Python drops it.
signal.signal(signal.SIGINT, signal.SIG_DFL)
from hal.types import VelocityCommand
from hal.unitree.factory import make_backend
from hal.unitree.config import UnitreeConfig
backend = make_backend("lo", options=UnitreeConfig(domain=int(sys.argv[1])))
backend.connect()
print("up", flush=True)
while True:
    now = time.time_ns()
    backend.read(now)
    backend.drive(VelocityCommand(now, vx=0.5))
    time.sleep(0.02)
"""
"""A host that drives forward for ever, to be killed."""


def run(backend: UnitreeBackend, seconds: float, vx: float = 0.0) -> list:
    samples: list = []
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        now = time.time_ns()
        samples += backend.read(now)
        backend.drive(VelocityCommand(now, vx=vx))
        time.sleep(0.01)
    return samples


def until(backend: UnitreeBackend, phase: Phase, seconds: float = 15.0, vx: float = 0.0) -> None:
    deadline = time.monotonic() + seconds
    while backend.state().phase is not phase:
        assert time.monotonic() < deadline, f"no {phase}: {backend.state()}"
        run(backend, 0.02, vx)


@pytest.fixture(scope="module")
def domain() -> int:
    """A DDS domain that no other test run on this machine is likely to use; 50, 100, 150 and 160 further on are ours
    too."""
    return 20 + os.getpid() % 50


@pytest.fixture(scope="module")
def peer(domain: int) -> Iterator[PeerProcess]:
    """One robot for the module: starting it is what takes the time."""
    peer = PeerProcess(domain)
    yield peer
    peer.end()


@pytest.fixture
def backend(domain: int, peer: PeerProcess) -> Iterator[UnitreeBackend]:
    backend = make_backend("lo", options=UnitreeConfig(domain=domain, sit_on_close=False))
    backend.connect()
    yield backend
    backend.close()


def test_drives_the_peer_and_reads_its_sensors(backend: UnitreeBackend, peer: PeerProcess):
    until(backend, Phase.READY)
    x, began = peer.last["x"], time.time_ns()
    samples: list = []
    while peer.last["x"] < x + 0.5 or sum(isinstance(s, ImuSample) for s in samples) < 300:
        samples += run(backend, 0.1, vx=0.5)
        assert time.time_ns() - began < 60 * NS
    assert backend.state().phase is Phase.MOVING
    imu = np.array([s.stamp for s in samples if isinstance(s, ImuSample)])
    assert (np.diff(imu) > 0).all()
    assert began < imu[-1] < time.time_ns() + NS
    scans = [s for s in samples if isinstance(s, LidarScan)]
    assert len(scans) >= 7
    assert len(scans[-1].points) > 1500
    backend.drive(VelocityCommand(time.time_ns()))
    peer.until(lambda: peer.at_rest)


def test_close_leaves_no_process_and_lets_the_domain_be_opened_again(
    backend: UnitreeBackend, peer: PeerProcess, domain: int
):
    guardian = backend.guardian_pid
    assert isinstance(guardian, int)
    assert psutil.pid_exists(guardian)
    start = time.monotonic()
    backend.close()
    assert time.monotonic() - start < 10.0, "it hangs"
    assert not psutil.pid_exists(guardian)
    assert backend.read(time.time_ns()) == []
    again = make_backend("lo", options=UnitreeConfig(domain=domain, sit_on_close=False))
    again.connect()
    until(again, Phase.READY)
    again.close()


@pytest.mark.parametrize(
    "number", [signal.SIGKILL, signal.SIGSTOP, pytest.param(signal.SIGINT, marks=pytest.mark.campaign)]
)
def test_the_robot_of_a_host_that_dies_or_hangs_is_stopped_before_its_own_hold_runs_out(
    peer: PeerProcess, domain: int, number: signal.Signals
):
    host = subprocess.Popen(
        [sys.executable, "-c", DRIVER, str(domain)],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        text=True,
        stderr=subprocess.PIPE,
    )
    try:
        assert host.stdout is not None
        assert host.stdout.readline() == "up\n"
        peer.until(lambda: bool(peer.reports) and peer.last["v"] > 0.4)
        children = psutil.Process(host.pid).children()
        assert len(children) == 1
        moment = time.monotonic()
        os.kill(host.pid, number)
        peer.until(lambda: peer.last["t"] > moment and peer.at_rest)
        assert peer.last["ended"] == "stop"
    finally:
        host.kill()
        host.communicate()
    _gone, alive = psutil.wait_procs(children, timeout=30.0)
    assert not alive


def test_a_cut_cable_is_noticed_by_the_sentry_on_the_robots_side(peer: PeerProcess, domain: int):
    """Host and guardian stop at once: nothing more arrives, and the robot alone would roll on for a second."""
    sentry = subprocess.Popen(
        [sys.executable, "-m", "hal.unitree.sentry", "lo", "--domain", str(domain)],
        cwd=ROOT,
        stderr=subprocess.PIPE,
        text=True,
    )
    host = subprocess.Popen(
        [sys.executable, "-c", DRIVER, str(domain)], cwd=ROOT, stdout=subprocess.PIPE, text=True
    )
    family = [psutil.Process(host.pid)]
    try:
        assert host.stdout is not None
        assert host.stdout.readline() == "up\n"
        family += family[0].children()
        peer.until(lambda: peer.last["v"] > 0.4)
        for process in reversed(family):
            process.suspend()
        moment = time.monotonic()
        peer.until(lambda: peer.last["t"] > moment and peer.at_rest)
        assert peer.last["ended"] == "stop"
    finally:
        for process in family:
            process.kill()
        host.communicate()
        sentry.terminate()
        _, said = sentry.communicate(timeout=30.0)
    assert "Moves ceased" in said
    assert sentry.returncode == 0


def test_a_killed_guardian_stops_the_robot_and_recover_starts_another(
    backend: UnitreeBackend, peer: PeerProcess
):
    until(backend, Phase.MOVING, vx=0.5)
    run(backend, 1.0, vx=0.5)
    guardian = backend.guardian_pid
    assert isinstance(guardian, int)
    os.kill(guardian, signal.SIGKILL)
    until(backend, Phase.FAULT, vx=0.5)
    assert "guardian" in backend.state().cause
    run(backend, 1.0, vx=0.5)
    assert peer.at_rest
    assert peer.last["ended"] == "stop"
    backend.request(ModeRequest.RECOVER)
    until(backend, Phase.READY)
    assert backend.guardian_pid != guardian


def test_a_peer_killed_in_motion_is_disconnected_and_its_return_is_taken_up(domain: int):
    gone = PeerProcess(domain + 50)
    backend = make_backend("lo", options=UnitreeConfig(domain=domain + 50, sit_on_close=False))
    backend.connect()
    until(backend, Phase.MOVING, vx=0.5)
    gone.end()
    until(backend, Phase.DISCONNECTED, vx=0.5)
    assert "no LowState" in backend.state().cause
    run(backend, 0.5, vx=0.5)
    back = PeerProcess(domain + 50)
    try:
        until(backend, Phase.READY)
        until(backend, Phase.MOVING, vx=0.5)
        back.until(lambda: bool(back.reports))
        while back.last["v"] < 0.3:
            until(backend, Phase.MOVING, vx=0.5)
            run(backend, 0.1, vx=0.5)
    finally:
        backend.close()
        back.end()


@pytest.mark.campaign
def test_two_robots_on_one_domain_are_both_named_and_neither_is_driven(domain: int):
    peers = [PeerProcess(domain + 150, "--fault", f"serial={serial}") for serial in (11, 22)]
    backend = make_backend("lo", options=UnitreeConfig(domain=domain + 150, sit_on_close=False))
    try:
        with pytest.raises(BackendError, match="serial numbers 11-0 and 22-0"):
            backend.connect()
    finally:
        backend.close()
        for peer in peers:
            peer.end()


@pytest.mark.campaign
def test_a_robot_that_says_yes_and_rolls_on_is_made_soft_by_the_guardian_alone(domain: int):
    peer = PeerProcess(domain + 160, "--fault", "rolls=1")
    host = subprocess.Popen(
        [sys.executable, "-c", DRIVER, str(domain + 160)], cwd=ROOT, stdout=subprocess.PIPE, text=True
    )
    try:
        assert host.stdout is not None
        assert host.stdout.readline() == "up\n"
        peer.until(lambda: bool(peer.reports) and peer.last["v"] > 0.4)
        children = psutil.Process(host.pid).children()
        host.kill()
        peer.until(lambda: peer.last["phase"] == "damped" and peer.at_rest)
    finally:
        host.kill()
        host.communicate()
        peer.end()
    _gone, alive = psutil.wait_procs(children, timeout=30.0)
    assert not alive


@pytest.mark.campaign
def test_a_stop_is_a_stop_move(backend: UnitreeBackend, peer: PeerProcess):
    until(backend, Phase.MOVING, vx=0.5)
    run(backend, 1.0, vx=0.5)
    backend.request(ModeRequest.STOP)
    run(backend, 1.2, vx=0.5)
    assert backend.state().phase is Phase.STOPPED
    assert peer.at_rest
    assert peer.last["ended"] == "stop"


def test_dry_run_listens_and_sends_nothing(peer: PeerProcess, domain: int):
    backend = make_backend("lo", dry_run=True, options=UnitreeConfig(domain=domain))
    x = peer.last["x"]
    backend.connect()
    until(backend, Phase.READY)
    samples = run(backend, 1.0, vx=0.5)
    assert [s for s in samples if isinstance(s, LidarScan)]
    backend.close()
    assert peer.last["x"] == pytest.approx(x, abs=1e-3)
    assert peer.last["phase"] == "ready"


def test_without_a_robot_the_error_comes_in_time_and_says_what_to_check(domain: int):
    backend = make_backend("lo", options=UnitreeConfig(domain=domain + 100, connect_timeout=1.0))
    start = time.monotonic()
    with pytest.raises(BackendError, match="is it switched on"):
        backend.connect()
    assert time.monotonic() - start < 10.0, "it hangs"
    living = [c for c in psutil.Process().children() if c.status() != psutil.STATUS_ZOMBIE]
    assert not [c for c in living if "guardian" in " ".join(c.cmdline())]


def test_an_interface_that_does_not_exist_is_refused_with_the_choices():
    with pytest.raises(BackendError, match=r"'nope0' does not exist; choose one of .*lo"):
        make_backend("nope0")


def test_without_the_extra_the_error_says_how_to_install(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(sys.modules, "cyclonedds.core", None)
    with pytest.raises(BackendError, match=r"pip install 'rbtrg-robot\[unitree\]'"):
        make_backend("lo")
