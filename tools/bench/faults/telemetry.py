"""Late, stepped and impossible telemetry: the backend behind the gate on the simulated Unitree peer, and the whole stack in lockstep."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial

from hal.safety.gate import SafetyGate
from hal.safety.monitors import (
    ACCELERATION,
    ATTITUDE,
    BATTERY,
    CLOCK_DRIFT,
    CLOCK_STEP,
    GRAVITY_SIDE,
    GRAVITY_SIZE,
    JOINT_ANGLE,
    JOINT_SPEED,
    JOINT_TORQUE,
    LOW_RATE,
    MOTOR_LOST,
    POINT_TIMES,
    STAMP_AHEAD,
    SWEEP_CLOCK,
    SWEEP_LATE,
    TURN_RATE,
)
from hal.types import NS, ImuSample, JointSample, LidarScan, Sample
from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.config import load
from rbtrg_robot.hosts.lockstep import Lockstep
from rbtrg_robot.stages.robot import STEP_PERIOD, RobotStage
from rbtrg_robot.wire.convert import BASE
from rbtrg_robot.wire.messages import header
from tests.hal.unitree.robot import Faults
from tests.hal.unitree.world import EVERYTHING, World
from tools.bench.faults.fault import Fault, Outcome
from tools.bench.faults.watch import REST_SPEED, Watch, by_hand, tap

# -- against the peer ------------------------------------------------------------------------------------------------------


class Peer:
    """The Unitree backend behind the gate, driven by hand; no guard, no odometry."""

    def __init__(self, seed: int) -> None:
        self.world = World(Faults())
        gate = SafetyGate(self.world.backend.capabilities, guarded=False)
        self._stage = RobotStage(self.world.backend, gate, simulated=False, watched=frozenset())
        self._stage.warm_up()
        self._told: dict[str, None] = {}
        self._ticks = 0
        self.speed = 0.35 + 0.05 * seed
        self.moving_at = 0
        """Newest instant of motion [ns]."""
        self.run(2.0 + 0.013 * seed)
        self._told.clear()

    def run(self, seconds: float) -> None:
        """Drive on for some time."""
        for _ in range(round(seconds * NS / STEP_PERIOD)):
            self.world.advance(STEP_PERIOD / NS)
            if self._ticks % 8 == 0:
                command = msg.TwistStamped(header=header(self.world.now, BASE))
                command.twist.linear.x = self.speed
                self._stage.on(t.TELEOP, command, "hands")
            self._ticks += 1
            for _, message in self._stage.tick(self.world.now):
                if isinstance(message, msg.RobotState):
                    self._told |= dict.fromkeys((message.cause, message.hold, message.estop_cause))
            if abs(self.world.body.v) > REST_SPEED:
                self.moving_at = self.world.elapsed

    def outcome(self, since: int, start: float) -> Outcome:
        """What came of a fault at `since` [ns], where the robot was at `start` [m]."""
        moving = self.world.elapsed - self.moving_at < NS // 2
        rest = math.inf if moving else max(self.moving_at - since, 0) / NS
        return Outcome(abs(self.world.body.x - start), rest, "\n".join(self._told))


def _late(world: World, size: float) -> None:
    world.late = {EVERYTHING: size}


def _late_sweeps(world: World, size: float) -> None:
    world.late = {"rt/utlidar/cloud": size}


def _set(name: str, world: World, size: float) -> None:
    setattr(world.faults, name, type(getattr(world.faults, name))(size))


def _against_peer(change: Callable[[World, float], None], seconds: float, size: float, seed: int) -> Outcome:
    peer = Peer(seed)
    since, start = peer.world.elapsed, peer.world.body.x
    change(peer.world, size)
    peer.run(seconds)
    return peer.outcome(since, start)


# -- in lockstep -----------------------------------------------------------------------------------------------------------


def _in_lockstep(
    change: Callable[[float], Callable[[list[Sample]], list[Sample]]], seconds: float, size: float, seed: int
) -> Outcome:
    """A robot that is driven along a bend by hand."""
    stack = Lockstep(load(None, ["sim.lidar_step=8"], scene="yard", seed=seed))
    stack.wait_ready()
    by_hand(stack, 0.3, 0.25, 1.0)
    with Watch(stack) as watch:
        tap(stack, change(size))
        by_hand(stack, 0.3, 0.25, seconds)
        return watch.outcome()


def _each(edit: Callable[[Sample], Sample]) -> Callable[[list[Sample]], list[Sample]]:
    return lambda samples: [edit(sample) for sample in samples]


def _lidar_clock(step: float) -> Callable[[list[Sample]], list[Sample]]:
    return _each(lambda s: replace(s, stamp=s.stamp + round(step * NS)) if isinstance(s, LidarScan) else s)


def _imu_scale(scale: float) -> Callable[[list[Sample]], list[Sample]]:
    return _each(lambda s: replace(s, accel=scale * s.accel) if isinstance(s, ImuSample) else s)


def _imu_ahead(ahead: float) -> Callable[[list[Sample]], list[Sample]]:
    count = 0

    def change(samples: list[Sample]) -> list[Sample]:
        nonlocal count
        out: list[Sample] = []
        for sample in samples:
            count += isinstance(sample, ImuSample)
            wrong = isinstance(sample, ImuSample) and count == 100
            out.append(replace(sample, stamp=sample.stamp + round(ahead * NS)) if wrong else sample)
        return out

    return change


def _gyro(rate: float) -> Callable[[list[Sample]], list[Sample]]:
    """About every axis [rad/s]."""
    return _each(lambda s: replace(s, gyro=s.gyro + rate) if isinstance(s, ImuSample) else s)


def _one_joint(field: str, value: float) -> Callable[[list[Sample]], list[Sample]]:
    """What the first motor tells, in the unit of a `field` of its sample."""

    def edit(sample: Sample) -> Sample:
        if not isinstance(sample, JointSample):
            return sample
        values = getattr(sample, field).copy()
        values[0] = value
        return replace(sample, **{field: values})

    return _each(edit)


def _times_of_no_sweep(off: float) -> Callable[[list[Sample]], list[Sample]]:
    def edit(sample: Sample) -> Sample:
        if not isinstance(sample, LidarScan):
            return sample
        points = sample.points.copy()
        points["time"][::3] -= off
        return replace(sample, points=points)

    return _each(edit)


def _one_late_point(late: float) -> Callable[[list[Sample]], list[Sample]]:
    """The last point of the next sweep was measured `late` [s] after it, as one entry of the field says."""
    done: list[LidarScan] = []

    def change(samples: list[Sample]) -> list[Sample]:
        out: list[Sample] = []
        for sample in samples:
            if isinstance(sample, LidarScan) and not done and len(sample.points):
                points = sample.points.copy()
                points["time"][-1] += late
                done.append(sample)
                sample = replace(sample, points=points)
            out.append(sample)
        return out

    return change


WATCHED_TIME = 15.0
"""[s] that a late robot is watched: before, a delay was learnt within ten."""
FAULTS = (
    Fault("late telemetry", (CLOCK_DRIFT,), (0.6, 1.2), partial(_against_peer, _late, WATCHED_TIME), rest=0.5, says=("telemetry of the robot arrives",)),
    Fault("robot's clock set back", (CLOCK_STEP,), (-0.6, -3.0), partial(_against_peer, partial(_set, "tick_step"), 3.0), says=("the clock of the robot stepped",)),
    Fault("LiDAR's clock set", (CLOCK_STEP,), (-0.3, -0.08), partial(_against_peer, partial(_set, "lidar_step"), 3.0), says=("the clock of the main LiDAR stepped",)),
    Fault("late sweeps", (SWEEP_LATE,), (0.5, 0.8), partial(_against_peer, _late_sweeps, 3.0), says=("sweeps of the main LiDAR arrive",)),
    Fault("L1 accelerations", (ACCELERATION,), (1e28, 1e3), partial(_against_peer, partial(_set, "l1_accel"), 3.0), says=("IMU of the L1: an acceleration",)),
    Fault("lost motor messages", (MOTOR_LOST,), (9999, 2000), partial(_against_peer, partial(_set, "lost"), 2.0), says=("motor FL_calf has lost",)),
    Fault("LowState comes seldom", (LOW_RATE,), (10, 50), partial(_against_peer, partial(_set, "every"), 4.0), says=("LowState comes",)),
    Fault("battery tells what cannot be", (BATTERY,), (255, 101), partial(_against_peer, partial(_set, "charge"), 2.0), says=("the battery tells",)),
    Fault("attitude is none", (ATTITUDE,), (0.0, 10.0), partial(_against_peer, partial(_set, "attitude"), 2.0), says=("the robot's own attitude",)),
    Fault("IMU of the robot in g or reversed", (GRAVITY_SIZE, GRAVITY_SIDE), (1 / 9.81, -1.0), partial(_against_peer, partial(_set, "accel_scale"), 3.0), rest=1.0, says=("IMU",)),
    Fault("clock of the sweeps set", (SWEEP_CLOCK,), (-0.3, 0.25), partial(_in_lockstep, _lidar_clock, 2.5), error=0.05, says=("the clock of the main LiDAR is",)),
    Fault("IMU in g or reversed", (GRAVITY_SIZE, GRAVITY_SIDE), (1 / 9.81, -1.0), partial(_in_lockstep, _imu_scale, 2.5), rest=1.5, error=0.05, says=("IMU", "wrong")),
    Fault("impossible turn rate", (TURN_RATE,), (40.0, 1e20), partial(_in_lockstep, _gyro, 2.5), rest=1.5, error=0.05, says=("a turn rate of",)),
    Fault("impossible joint speed", (JOINT_SPEED,), (1e3, 1e20), partial(_in_lockstep, partial(_one_joint, "velocity"), 2.5), error=0.05, says=("joints:", "rad/s, possible")),
    Fault("impossible joint angle", (JOINT_ANGLE,), (50.0, 1e20), partial(_in_lockstep, partial(_one_joint, "position"), 2.5), error=0.05, says=("joints:", "tells an angle of")),
    Fault("impossible joint torque", (JOINT_TORQUE,), (1e3, 1e20), partial(_in_lockstep, partial(_one_joint, "effort"), 2.5), error=0.05, says=("joints:", "Nm, possible")),
    Fault("IMU stamp ahead", (STAMP_AHEAD,), (3.0, 0.3), partial(_in_lockstep, _imu_ahead, 2.0), error=0.05, says=("IMU: a stamp",)),
    Fault("one late point", (), (0.3, 20.0), partial(_in_lockstep, _one_late_point, 2.5), error=0.05),
    Fault("times of no sweep", (POINT_TIMES,), (3.0, 40.0), partial(_in_lockstep, _times_of_no_sweep, 2.0), error=0.05, says=("point field 'time' holds",)),
)  # fmt: skip
