"""Streams that localisation lives on lie: they repeat, tell what cannot be, or the floor moves below a robot that stands."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from hal.mujoco.backend import MujocoBackend
from hal.safety.monitors import IMPOSSIBLE_SPEED, IMU_REPEATS, LIDAR_REPEATS, MOVED_WHILE_STILL
from hal.types import NS, ImuSample, LidarScan, Sample
from rbtrg_robot import topics as t
from rbtrg_robot.config import load
from rbtrg_robot.hosts.lockstep import Lockstep
from tools.bench.faults.fault import Fault, Outcome
from tools.bench.faults.watch import Watch, tap

WAY = 4.0
"""Of the goal [m], straight ahead."""
DRIVEN = 1.0
"""Seconds of motion before the fault."""
WATCHED = 3.0
"""Seconds after it."""
Change = Callable[[list[Sample]], list[Sample]]


def _driving(speed: float, seed: int) -> Lockstep:
    overrides = ["sim.lidar_step=8", f"seed={seed}", f"tracker.max_speed={speed}"]
    stack = Lockstep(load(None, overrides, scene="flat"))
    stack.wait_ready()
    x, y, _ = stack.config.start_pose()
    stack.send_goal(x + WAY, y)
    stack.run_until(lambda: stack.newest[t.TRUTH].twist.twist.linear.x > 0.8 * speed, 20.0, "motion")
    stack.run(DRIVEN)
    return stack


def _while_driving(change: Callable[[], Change]) -> Callable[[float, int], Outcome]:
    def inject(size: float, seed: int) -> Outcome:
        stack = _driving(size, seed)
        with Watch(stack) as watch:
            tap(stack, change())
            stack.run(WATCHED)
            return watch.outcome()

    return inject


def _frozen(kind: type[Sample]) -> Callable[[], Change]:
    """From the next sample on, each source of this kind repeats itself with new stamps."""

    def start() -> Change:
        held: dict[str, Sample] = {}

        def change(samples: list[Sample]) -> list[Sample]:
            out = []
            for sample in samples:
                if isinstance(sample, kind):
                    first = held.setdefault(str(getattr(sample, "name", "")), sample)
                    sample = replace(first, stamp=sample.stamp)
                out.append(sample)
            return out

        return change

    return start


def _shoved() -> Change:
    """For a fifth of a second the accelerometer says 100 m/s^2 ahead."""
    until: list[int] = []

    def change(samples: list[Sample]) -> list[Sample]:
        out = []
        for sample in samples:
            if isinstance(sample, ImuSample):
                until[:] = until or [sample.stamp + NS // 5]
                if sample.stamp < until[0]:
                    sample = replace(sample, accel=sample.accel + np.array([100.0, 0.0, 0.0]))
            out.append(sample)
        return out

    return change


def _moving_floor(speed: float, seed: int) -> Outcome:
    """The robot stands, and what it stands on moves with `speed` [m/s]."""
    stack = Lockstep(load(None, ["sim.lidar_step=4", f"seed={seed}"], scene="flat"))
    stack.wait_ready()
    stack.run(2.0)
    with Watch(stack) as watch:
        backend = stack.robot.backend
        assert isinstance(backend, MujocoBackend)
        simulation = backend.simulation

        def carry(samples: list[Sample]) -> list[Sample]:
            simulation.data.qpos[0] += 0.005 * speed
            return samples

        tap(stack, carry)
        stack.run(4.0)
        return watch.outcome()


FAULTS = (
    Fault(
        "frozen_lidar", (LIDAR_REPEATS,), (0.3, 0.5), _while_driving(_frozen(LidarScan)), rest=0.7, error=0.25,
        says=("repeats its sweep",),
    ),
    Fault(
        "frozen_imu", (IMU_REPEATS,), (0.3, 0.5), _while_driving(_frozen(ImuSample)), rest=0.5, error=0.25,
        says=("IMU repeats",),
    ),
    Fault(
        "impossible_speed", (IMPOSSIBLE_SPEED,), (0.3, 0.5), _while_driving(_shoved), error=0.25,
        says=("as no robot can",),
    ),
    Fault(
        "moving_floor", (MOVED_WHILE_STILL,), (0.1, 0.3), _moving_floor, error=0.35, says=("is the robot carried",),
    ),
)  # fmt: skip
