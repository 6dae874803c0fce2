"""Our controllers at the motors of the real robot (`unitree.level: low`): how regular their commands are, and how soon
the motors are soft after each fault, with the words that the operator reads.

    python -m tools.bench low [--only BEGINNING_OF_KEY] [--seconds 20] [--controller vmc] [--json]

Faults in lockstep are exact: MuJoCo stands behind LowCmd and LowState, one clock drives it, the motor loop and the
host. Commands are timed, and processes killed, on loopback DDS beside a simulated robot, which takes a core of its
own. A limit on the commands binds where the machine was idle before (`low.load_before`): another process's time slice
is no property of the loop.
"""

from __future__ import annotations

import argparse
import math
import os
import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import psutil

from hal.contract import BackendError
from hal.lowlevel import LowCommand
from hal.types import ModeRequest, Phase, VelocityCommand
from hal.unitree.link import LOW_STATE
from hal.unitree.low.wire import L2, B
from tests.hal.unitree.low.robot import LOW, LowWorld
from tools.bench.report import Report

SOFT_LIMIT, REST_LIMIT = 0.1, 0.5
"""[s] until the motors must be soft, and until a robot that balances on must stand."""
GAP_LIMIT = 0.004
"""[s] that 99.9 % of the times between two commands keep on a quiet machine."""
IDLE_LOAD = 0.3
"""Load per core before the bench, up to which a machine counts as quiet."""
FAULT_SPEED = 0.4
"""[m/s] at which faults happen."""


def run(args: list[str]) -> Report:
    """Run this bench; returns its rows."""
    parser = argparse.ArgumentParser(prog="python -m tools.bench low", description=__doc__)
    parser.add_argument(
        "--only", default="", help="beginning of the keys wanted: low.soft_s.cut, low.gap, ..."
    )
    parser.add_argument("--seconds", type=float, default=20.0, help="of commands that are timed")
    parser.add_argument("--controller", default="vmc")
    options = parser.parse_args(args)
    report = Report("low")
    load = os.getloadavg()[0] / (os.cpu_count() or 1)
    for name, fault in FAULTS.items():
        if f"low.soft_s.{name}".startswith(options.only):
            seconds, words = fault(standing(options.controller))
            tell(report, f"low.soft_s.{name}", seconds, SOFT_LIMIT, words)
    for name, other in OTHERS.items():
        if f"low.{name}".startswith(options.only):
            value, limit, words = other(standing(options.controller))
            tell(report, f"low.{name}", value, limit, words)
    wanted = [name for name in DEATHS if f"low.live_soft_s.{name}".startswith(options.only)]
    timed = "low.gap".startswith(options.only) or options.only.startswith("low.gap")
    if wanted or timed:
        with _live(options.controller) as host:
            if timed:
                _commands(report, host, options.seconds, load)
            for name in wanted:
                tell(report, f"low.live_soft_s.{name}", *_dies(host, name))
    if not report.rows:
        parser.error(f"no row begins with {options.only!r}")
    return report


def tell(report: Report, key: str, seconds: float, limit: float, words: str) -> None:
    """A row, and what the operator reads."""
    report.add(key, seconds, "s", limit)
    print(f"{key}: {words}", file=sys.stderr)


# --- in lockstep -------------------------------------------------------------------------------------------------


def standing(controller: str) -> LowWorld:
    """A robot that drives by our commands."""
    world = LowWorld(controller=controller)
    world.backend.connect()
    world.backend.request(ModeRequest.STAND)
    world.until(Phase.READY)
    world.run(1.0, vx=FAULT_SPEED)
    return world


def passed(world: LowWorld, until: Callable[[], bool], longest: float = 2.0, host: bool = True) -> float:
    """[s] of the robot's clock until something is so, to 2 ms; NaN where it never is. `host`: it goes on driving."""
    began = world.elapsed
    for tick in range(round(longest / 0.002)):
        if until():
            return (world.elapsed - began) / 1e9
        world.advance(0.002)
        if host and tick % 5 == 0:
            world.backend.read(world.elapsed)
            world.backend.drive(VelocityCommand(world.elapsed, vx=FAULT_SPEED))
    return math.nan


def soft(world: LowWorld) -> tuple[float, str]:
    """When the motors are soft, and what the operator reads then."""
    seconds = passed(world, lambda: not world.body.stiff)
    world.run(0.1, vx=FAULT_SPEED)
    state = world.backend.state()
    return seconds, f"{state.phase.value}: {state.cause}"


def low_state(world: LowWorld, change: Callable[[Any], None]) -> None:
    """From now on each LowState tells something else."""
    write = world.robot._write_low

    def changed() -> None:
        write()
        change(world.robot._low[0])

    world.robot._write_low = changed  # type: ignore[method-assign]


def cut(world: LowWorld) -> tuple[float, str]:
    """No LowState comes any more."""
    world.cut = True
    return soft(world)


def late(world: LowWorld) -> tuple[float, str]:
    """LowState is held up for 0.15 s, then comes all at once."""
    put, held = world.robot._put, []
    free_at = world.elapsed + 150_000_000

    def hold(topic: str, data: bytes) -> None:
        if topic != LOW_STATE:
            put(topic, data)
            return
        held.append(data)
        while held and world.elapsed >= free_at:
            put(LOW_STATE, held.pop(0))

    world.robot._put = hold  # type: ignore[method-assign]
    return soft(world)


def motor(field: str, value: float, index: int = 5) -> Callable[[LowWorld], tuple[float, str]]:
    """A motor that tells this."""

    def fault(world: LowWorld) -> tuple[float, str]:
        def change(low: Any) -> None:
            low["motor_state"][field][index] = value

        low_state(world, change)
        return soft(world)

    return fault


def deaf(world: LowWorld) -> tuple[float, str]:
    """A motor that loses messages."""
    count = iter(range(10**6))

    def change(low: Any) -> None:
        low["motor_state"]["lost"][5], low["motor_state"]["reserve"][5, 0] = 5000 + 50 * next(count), 4

    low_state(world, change)
    return soft(world)


def no_number(world: LowWorld) -> tuple[float, str]:
    """The IMU tells what is not a number."""

    def change(low: Any) -> None:
        low["imu_state"]["gyroscope"][1] = math.nan

    low_state(world, change)
    return soft(world)


def exception(world: LowWorld) -> tuple[float, str]:
    """The controller fails."""

    def fails(*_: object) -> LowCommand:
        raise ZeroDivisionError("float division by zero")

    controller: Any = world.loop.loop._controller
    controller.step = fails
    return soft(world)


def asks_nan(world: LowWorld) -> tuple[float, str]:
    """The controller asks for what is not a number."""
    controller: Any = world.loop.loop._controller
    step = controller.step

    def asks(*args: Any) -> LowCommand:
        command = step(*args)
        command.tau[3] = math.nan
        return command

    controller.step = asks
    return soft(world)


def remote(world: LowWorld) -> tuple[float, str]:
    """L2 + B on the robot's own remote."""
    world.robot._low[0]["wireless_remote"][2:4] = ((L2 | B) & 0xFF, (L2 | B) >> 8)
    return soft(world)


FAULTS: dict[str, Callable[[LowWorld], tuple[float, str]]] = {
    "cut": cut,
    "late": late,
    "hot": motor("temperature", 91),
    "fast": motor("dq", 60.0, 13),
    "range": motor("q", -3.2, 2),
    "deaf": deaf,
    "imu": no_number,
    "exception": exception,
    "nan": asks_nan,
    "remote": remote,
}


def lossy(world: LowWorld) -> tuple[float, float, str]:
    """A tenth of both messages is lost, the rest 4 ms late: speed that is missing [m/s]."""
    rng = np.random.default_rng(0)
    put, follow = world.robot._put, world.robot.low_cmd
    way: list[bytes] = []

    def heard(topic: str, data: bytes) -> None:
        if topic != LOW_STATE or rng.random() > 0.1:
            put(topic, data)

    def low_cmd(data: bytes) -> None:
        if rng.random() > 0.1:
            way.append(data)
        if len(way) > 2:
            follow(way.pop(0))

    world.robot._put, world.robot.low_cmd = heard, low_cmd  # type: ignore[method-assign]
    x = world.body.x
    world.run(3.0, vx=FAULT_SPEED)
    state = world.backend.state()
    return FAULT_SPEED - (world.body.x - x) / 3.0, 0.2 * FAULT_SPEED, f"{state.phase.value}: {state.cause}"


def app(world: LowWorld) -> tuple[float, float, str]:
    """The app selects the motion service: until the last of our commands [s]."""
    world.robot.motion = "ai-w"
    began, last, seen = world.elapsed, world.elapsed, world.robot.fought
    for _ in range(100):
        world.run(0.01, vx=FAULT_SPEED)
        if world.robot.fought != seen:
            last, seen = world.elapsed, world.robot.fought
    state = world.backend.state()
    return (last - began) / 1e9, SOFT_LIMIT, f"{state.phase.value}: {state.cause}"


def silent(world: LowWorld) -> tuple[float, float, str]:
    """The host tells nothing: the robot balances on and stands [s]."""
    seconds = passed(world, lambda: abs(world.body.v) < 0.05, host=False)
    return seconds, REST_LIMIT, f"{world.loop.loop.report().phase.value}: {world.loop.loop.report().cause}"


OTHERS: dict[str, Callable[[LowWorld], tuple[float, float, str]]] = {
    "slower_by.lossy": lossy,
    "quiet_s.app": app,
    "rest_s.silent_host": silent,
}

# --- with processes ----------------------------------------------------------------------------------------------


class Host:
    """A backend on loopback DDS that is read and driven at 100 Hz."""

    def __init__(self, controller: str) -> None:
        from hal.unitree.low.backend import LowLevelBackend
        from tests.hal.unitree.peer_process import PeerProcess

        domain = 20 + os.getpid() % 180
        self.peer = PeerProcess(domain, "--body", "motors", "--lying", "--lidar-step", "40")
        self.backend = LowLevelBackend("lo", domain, LOW.model_copy(update={"domain": domain}), controller)

    def run(self, seconds: float, vx: float = 0.0) -> None:
        """Go on for so long."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            now = time.time_ns()
            self.backend.read(now)
            self.backend.drive(VelocityCommand(now, vx=vx))
            time.sleep(0.01)

    def up(self) -> None:
        """Get it up, whatever it does."""
        lies = self.backend.state().phase is not Phase.FAULT
        self.backend.request(ModeRequest.STAND if lies else ModeRequest.RECOVER)
        end = time.monotonic() + 60.0
        while self.backend.state().phase not in (Phase.READY, Phase.MOVING):
            if time.monotonic() > end:
                raise BackendError(f"the robot does not get up: {self.backend.state().cause}")
            self.run(0.05)

    @property
    def loop(self) -> psutil.Process:
        """The motor loop's process."""
        motors: Any = self.backend._motors
        return psutil.Process(motors.pid)


@contextmanager
def _live(controller: str) -> Iterator[Host]:
    host = Host(controller)
    try:
        host.backend.connect()
        yield host
    finally:
        host.backend.close()
        host.peer.end()


def _commands(report: Report, host: Host, seconds: float, load: float) -> None:
    """Times between commands while the robot stands up, drives and stands."""
    host.up()
    host.run(seconds / 2, vx=FAULT_SPEED)
    host.run(seconds / 2)
    motors: Any = host.backend._motors
    told = motors.report()
    quiet = load <= IDLE_LOAD
    for name, value in zip(("p50", "p99", "p999"), told.shares, strict=True):
        report.add(
            f"low.gap.{name}", 1e3 * value, "ms", 1e3 * GAP_LIMIT if name == "p999" and quiet else None
        )
    report.add("low.gap.worst", 1e3 * told.worst, "ms")
    report.add("low.gap.late", told.late, "commands after more than 4 ms")
    report.add("low.load_before", load, "of each core")
    report.add("low.load_during", os.getloadavg()[0] / (os.cpu_count() or 1), "of each core")


DEATHS = ("killed", "hung")


def _dies(host: Host, name: str) -> tuple[float, float, str]:
    """Seconds until the motors are soft after the loop is killed, or stopped."""
    if host.backend.state().phase not in (Phase.READY, Phase.MOVING):
        host.up()
    host.peer.until(lambda: host.peer.last["stiff"])
    moment = time.monotonic()
    host.loop.send_signal(signal.SIGKILL if name == "killed" else signal.SIGSTOP)
    host.peer.until(lambda: host.peer.last["soft_at"] > moment, 5.0)
    seconds = host.peer.last["soft_at"] - moment
    host.run(0.8)
    state = host.backend.state()
    return seconds, SOFT_LIMIT, f"{state.phase.value}: {state.cause}"
