"""Sensor errors and delivery delays. Random numbers come in blocks: one draw per sample costs more than the physics
step."""

from __future__ import annotations

from collections import deque

import numpy as np

from hal.lowlevel import LowState
from hal.mujoco.attitude import AttitudeFilter
from hal.types import Array, ImuSample, JointSample, Sample

GYRO_SIGMA, GYRO_BIAS = 0.003, 0.002
"""White noise per sample and constant offset drawn per seed [rad/s]."""
ACCEL_SIGMA, ACCEL_BIAS = 0.06, 0.03
"""[m/s^2]"""
POSITION_SIGMA, VELOCITY_SIGMA, EFFORT_SIGMA = 0.0005, 0.02, 0.1
"""Joint encoders and torque estimate: [rad], [rad/s], [Nm]."""
NOISE_SIGMA = np.repeat(
    [GYRO_SIGMA, ACCEL_SIGMA, POSITION_SIGMA, VELOCITY_SIGMA, EFFORT_SIGMA], [3, 3, 16, 16, 16]
)

_BLOCK_LENGTH = 1024


class Gaussian:
    """Rows of normal numbers with standard deviations `sigma` (width,), drawn in blocks."""

    def __init__(self, random: np.random.Generator, sigma: Array) -> None:
        self._random, self._sigma = random, sigma
        self._next = _BLOCK_LENGTH

    def row(self) -> Array:
        """(width,)"""
        if self._next == _BLOCK_LENGTH:
            self._rows = self._random.standard_normal((_BLOCK_LENGTH, len(self._sigma))) * self._sigma
            self._next = 0
        self._next += 1
        return self._rows[self._next - 1]


class Sensors:
    """Turns the exact joint-level state into what the robot's own sensors say."""

    def __init__(self, seed: int, noise: bool) -> None:
        self._noise = noise
        streams = np.random.SeedSequence([seed, 0x1A7]).spawn(2)
        constant = np.random.default_rng(streams[0]).standard_normal(6)
        self._gyro_bias = GYRO_BIAS * constant[:3]
        self._accel_bias = ACCEL_BIAS * constant[3:6]
        self._attitude = AttitudeFilter(self._gyro_bias, self._accel_bias)
        self._gaussian = Gaussian(np.random.default_rng(streams[1]), NOISE_SIGMA)

    def measure(self, state: LowState) -> LowState:
        """One control tick's LowState with errors, in place."""
        if not self._noise:
            return state
        row = self._gaussian.row()
        state.gyro += row[:3]
        state.gyro += self._gyro_bias
        state.accel += row[3:6]
        state.accel += self._accel_bias
        state.q += row[6:22]
        state.dq += row[22:38]
        state.tau += row[38:]
        self._attitude.measure(state)
        return state

    def placed(self) -> None:
        """The robot was put elsewhere: the attitude filter settles there."""
        self._attitude.restart()


def imu_sample(stamp: int, state: LowState) -> ImuSample:
    """From a measured state, which keeps no reference to the sample."""
    return ImuSample(stamp, state.gyro.copy(), state.accel.copy())


def joint_sample(stamp: int, state: LowState) -> JointSample:
    """From a measured state, which keeps no reference to the sample."""
    return JointSample(stamp, state.q.copy(), state.dq.copy(), state.tau.copy())


class DelayLine:
    """Holds samples back: what goes in with a due time comes out when the clock has reached it, earliest due first."""

    def __init__(self) -> None:
        self._queues: dict[type, deque[tuple[int, Sample]]] = {}

    def put(self, due: int, sample: Sample) -> None:
        """`due` [ns] must not fall within one kind of sample."""
        self._queues.setdefault(type(sample), deque()).append((due, sample))

    def take(self, now: int) -> list[Sample]:
        """All samples due by `now` [ns]."""
        ready: list[tuple[int, Sample]] = []
        for queue in self._queues.values():
            while queue and queue[0][0] <= now:
                ready.append(queue.popleft())
        ready.sort(key=lambda item: item[0])
        return [sample for _, sample in ready]
