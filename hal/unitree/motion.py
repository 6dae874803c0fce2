"""Whether the robot moves, and what brings it to rest: judged by what it does, whatever it answers.

The driver, the guardian and the sentry use the same two classes, each on what it hears itself. No compiler is imported
here: the guardian must be ready soon.
"""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

import numpy as np

from hal.safety.monitors import ATTITUDE, ROLLS_ON
from hal.safety.slope import CREEP_SLOPE, CREEP_SPEED
from hal.unitree.api import Sport

WHEEL_SLOTS = slice(12, 16)
"""Slots of the wheels among the motors, as in `hal.limbs`."""
MEAN_WINDOW = 0.3
"""[s] that is averaged: the sway of legs and trunk after a stop lasts as long in each direction, and is no motion."""
SAMPLE_PERIOD = 0.015
"""[s] between two samples; LowState comes at 500 Hz."""
OLD_AFTER = 0.3
"""[s] What was heard before says nothing."""
STICK_REST, STICK_MOST = 0.1, 1.5
"""A stick nearer to 0 than this is at rest; beyond the other the bytes are no stick."""
_STICK_SLOTS = [0, 1, 2, 4]
"""lx, rx, ry, ly among the five floats after head and keys of `wireless_remote`; the fourth is the L2 trigger."""

BRAKING_TIME = 0.5
"""[s] a robot needs to stand: from 0.8 m/s at 1.5 m/s^2."""
STOP_AGAIN = 0.1
"""[s] between two StopMoves to a robot that moves on."""
UNANSWERED_AGAIN = 0.05
"""[s] the same, before the first answer."""
DAMP_PATIENCE = 1.5
"""[s] before Damp: the robot may have lost the StopMove, holds its last Move for 1 s, then brakes."""
ROLLING_WAY = 0.3
"""[m] that a slow robot rolls before Damp."""
FASTEST_DAMP = 1.5
"""[m/s] Damp drops the trunk onto its belly. From here v^2 / 2g = 0.11 m, less than half of what it takes to lift the
centre of mass over the front edge (0.35 m ahead, 0.08 m high: 0.28 m). A faster robot could go head over heels."""
STEEPEST_DAMP = math.radians(15.0)
"""[rad] On its belly a robot slides where the slope is steeper than its friction: 0.4 holds up to 22 deg."""
INSIST_TIME = 1.0
"""[s] an order is repeated to a robot whose motion is not heard and that does not answer."""
LONGEST_ORDER = 60.0
"""[s] an order is repeated at most: a robot that was lifted turns its wheels as long as it likes."""


class Wheels(NamedTuple):
    """What a robot rolls on [m]."""

    radius: float
    half_track: float
    """From the middle to the wheels of a side."""


GO2W_WHEELS = Wheels(0.086, 0.193)
"""As in its folder, which a small process does not read."""


def remote(low: np.void) -> bool:
    """Whether somebody moves a stick of the robot's own remote; its sticks rest at 0 and read -1..1."""
    sticks = np.frombuffer(low["wireless_remote"].tobytes(), "<f4", 5, offset=4)[_STICK_SLOTS]
    return bool(((np.abs(sticks) > STICK_REST) & (np.abs(sticks) <= STICK_MOST)).any())


class Motion:
    """Speed and slope over the last moments, from LowState and sportmodestate. Times in s of any clock that goes on."""

    def __init__(self, wheels: Wheels | None = GO2W_WHEELS) -> None:
        """`wheels`: None of a robot on feet, which only its own estimate and its gyro tell of."""
        self._wheels = wheels
        self._kept: deque[tuple[float, float, float, float, float, float]] = deque()
        """When, speed of the wheels, x and y of the robot's estimate [m/s], yaw rate by gyro and by wheels [rad/s]."""
        self._sport: tuple[float, float, float] | None = None
        """When, and the robot's estimate x, y [m/s]."""
        self.slope = 0.0
        """[rad] between the trunk and level; 0 before it was heard."""
        self._nose = 0.0
        """Sine of the angle by which the nose is up."""
        self.remote = False
        """Somebody moves a stick of the robot's own remote."""

    def hear_sport(self, sport: np.void, now: float) -> None:
        """A sportmodestate with a new stamp."""
        x, y = (float(v) for v in sport["velocity"][:2])
        # A firmware that leaves the field empty says nothing by it.
        self._sport = (now, x, y) if math.isfinite(x + y) and (x, y) != (0.0, 0.0) else None

    def hear_low(self, low: np.void, now: float) -> None:
        """A LowState with a new tick."""
        if self._kept and 0.0 <= now - self._kept[-1][0] < SAMPLE_PERIOD:
            return
        turn = float(low["imu_state"]["gyroscope"][2])
        told = self._sport if self._sport is not None and 0.0 <= now - self._sport[0] < OLD_AFTER else None
        if self._wheels is not None:
            right, left = (
                float(low["motor_state"]["dq"][WHEEL_SLOTS][side::2].mean()) * self._wheels.radius
                for side in (0, 1)
            )
            wheels, spin = 0.5 * (right + left), 0.5 * (right - left) / self._wheels.half_track
            x, y = (wheels, 0.0) if told is None else told[1:]  # alone, the wheels are believed
        elif told is not None:
            x, y = told[1:]
            wheels, spin = math.hypot(x, y), turn
        else:
            wheels = x = y = spin = math.nan  # nothing tells whether it walks
        w, i, j, k = (float(v) for v in low["imu_state"]["quaternion"])
        if not ATTITUDE.outside(math.hypot(w, i, j, k)):
            self.slope = math.acos(max(-1.0, min(1.0, 1.0 - 2.0 * (i * i + j * j))))
            self._nose = 2.0 * (i * k - w * j)
        self.remote = remote(low)
        if not math.isfinite(wheels + turn):
            return
        if self._kept and now < self._kept[-1][0]:
            self._kept.clear()
        self._kept.append((now, wheels, x, y, turn, spin))
        while now - self._kept[0][0] > MEAN_WINDOW:
            self._kept.popleft()

    def speed(self, now: float) -> float | None:
        """Mean [m/s] of the last `MEAN_WINDOW`, or half the yaw rate if that is more; None if nothing is heard.

        Wheels and the robot's estimate must agree, and in a turn wheels and gyro. The slower counts: a spinning wheel,
        a drifting estimate or a gyro with a bias is no motion. A robot on feet has its estimate and its gyro alone."""
        if not self._kept or not 0.0 <= now - self._kept[-1][0] < OLD_AFTER:
            return None
        _, wheels, x, y, turn, spin = np.mean(self._kept, axis=0)
        return float(max(min(abs(wheels), math.hypot(x, y)), 0.5 * min(abs(turn), abs(spin))))

    @property
    def downhill(self) -> bool:
        """Whether it rolls down a slope, as gravity has it."""
        return self.slope > CREEP_SLOPE and bool(self._kept) and self._kept[-1][1] * self._nose <= 0.0


class Halt:
    """Which request brings the robot to rest: StopMove while it moves, then Damp where that is safer. Times in s."""

    def __init__(self) -> None:
        self.order: Sport | None = None
        """What is insisted on; None at rest."""
        self._since = self._sent = self._seen = 0.0
        self._answered = False
        self._way = 0.0
        self.damped = ""
        """Why it was made soft, in words; empty where it was not."""

    def begin(self, order: Sport, now: float) -> None:
        """From now on the robot shall rest. Damp is not replaced by a stop; a repeated order is the same one."""
        if self.order is not None and (self.order is Sport.DAMP or order is self.order):
            self._answered = False
            return
        self.order, self._since, self._seen = order, now, now
        self._sent, self._answered, self._way = -math.inf, False, 0.0
        self.damped = ""

    def end(self) -> None:
        """The robot is told something else."""
        self.order = None

    def answered(self) -> None:
        """The robot said yes. It counts where its motion is not heard."""
        self._answered = True

    def due(self, now: float, motion: Motion) -> Sport | None:
        """The request to send now, None where none is."""
        if self.order is None:
            return None
        speed, lasted = motion.speed(now), now - self._since
        rolls = speed if speed is not None and ROLLS_ON.outside(speed) else 0.0
        moves = rolls > 0.0
        self._way += rolls * max(0.0, now - self._seen)
        self._seen = now
        if lasted > LONGEST_ORDER or motion.remote or self._over(speed is not None, moves, lasted):
            self.order = None
            return None
        if moves and self.order is Sport.STOP_MOVE and self._soft(lasted, rolls, motion):
            self.damped = ROLLS_ON.tell(speed=f"{rolls:.2f} m/s", after=f"{lasted:.1f} s")
            self.order, self._answered, self._sent = Sport.DAMP, False, -math.inf
            self._since, lasted = now, 0.0
        if self._answered and not (moves and lasted > BRAKING_TIME):
            return None
        if now - self._sent < (STOP_AGAIN if self._answered else UNANSWERED_AGAIN):
            return None
        self._sent = now
        return self.order

    def _over(self, heard: bool, moves: bool, lasted: float) -> bool:
        """Whether the robot rests, or, where it is not heard, has said so."""
        return not moves and (
            lasted >= INSIST_TIME or (self._answered and (lasted >= MEAN_WINDOW or not heard))
        )

    def _soft(self, lasted: float, speed: float, motion: Motion) -> bool:
        """Whether Damp is safer than to go on asking."""
        creeps = motion.downhill and speed < CREEP_SPEED
        return (
            lasted >= DAMP_PATIENCE
            and self._way >= ROLLING_WAY
            and speed <= FASTEST_DAMP
            and motion.slope <= STEEPEST_DAMP
            and not creeps
        )
