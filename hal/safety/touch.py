"""What the robot touches and no sensor foretold, felt from joints and IMU: something holds the body, or one wheel.

Newton's law does the work: what the wheels get from the ground, by the leg torques, is all that moves the robot. What
the accelerometer tells beyond that pushes at the body. A slope is in both. A wheel that leads is held where it alone is
pushed back, while the others drive. Whether the map explains it is not decided here: `joints` is told how uneven the
map is at the wheels.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hal.limbs import SX, SY, Limbs
from hal.safety import monitors
from hal.safety.swept import TOUCHED, Body, Surroundings
from hal.types import GRAVITY, NS, Array, ImuSample, JointSample
from hal.wheel_force import wheel_loads, wheel_pushes

PAYLOAD, WEIGH_TIME = 26.0, 1.0
"""[kg] at most, and time constant [s] of weighing it: by the wheels' loads, so that a payload on a slope pushes
nothing."""
UP = np.array([0.0, 0.0, 1.0])
SHORT = 0.85
"""A robot that drives no slower than this share of its command is not held: it brakes, or its wheels strain against
each other in a bend."""
DRIVES = 0.03
"""[m/s] A robot that is commanded slower than this drives nowhere."""
PUSHED = 12.0
"""[N] A wheel that is pushed back less than this is not held."""
STRAIN = 0.3
"""Share of a wheel's push that the wheel behind or before it feels as well when the robot turns: it is no obstacle
then."""
TURN = 60.0
"""[N s/rad] A turn pushes wheels back as well: what more it takes then."""
FACE = 0.04
"""[m] Ground that lies this far off the plane that the robot stands on throws legs about, and is a face to climb."""
EDGE = 0.025
"""[m] The map explains a held wheel from here on: an edge of this height takes as much push as a wheel carries (its
radius is 0.086 m), and the map tells no lower one from its noise."""
TALL = 0.20
"""[m] The same of the body, whose belly is higher."""
ROUGH = 3.0
"""On uneven ground legs are thrown about: so many times the force tells a touch of the body there."""
AFTER_FACE = 1.0
"""[s] after a face was under the body or ahead of it, legs are thrown about: the rear wheels come onto it when the map
under the body is even again."""
BODY_TIME, CLIMB_TIME, WHEEL_TIME = 0.05, 0.25, 0.09
"""[s] that it lasts: on even ground, on uneven ground, and of a wheel. While the hybrid controller climbs kerbs of 19
cm that force lasts up to 0.16 s. What stands in the way pushes on. A wheel that jumps over a pebble is held for less.
"""
AHEAD = 0.2
"""[m] beyond the end of the body: what lies farther away holds no wheel."""
BESIDE = 0.05
"""[m] beside the body: a wall there holds a wheel that scrapes it. It explains no touch of the body."""
CELLS = 3
"""Cells that must lie off the plane: one may be noise."""
LONGEST = 0.05
"""[s] between joint samples that count: after a gap the first one counts no longer than this."""


class Touch(NamedTuple):
    """Something was touched at an end of the body."""

    way: float
    """1.0 ahead, -1.0 behind."""
    left: float
    """[m] of the wheel that is held, left of the middle; 0 of the body."""


class TouchWatch:
    """Feeds on IMU and joint samples as they come."""

    def __init__(self, limbs: Limbs, sprung_mass: float, force: float) -> None:
        """sprung_mass: [kg] that the wheels push without payload; wheels and shanks get their share from the ground
        itself. force: [N] on the body that tells a touch."""
        self._limbs, self._sprung, self._force = limbs, sprung_mass, force
        self._accel: Array = np.array([0.0, 0.0, GRAVITY])
        """[m/s^2] mean specific force since the joint sample before."""
        self._sum, self._count = np.zeros(3), 0
        self._mass = sprung_mass
        self._stamp = 0
        self._face = -math.inf
        """Stamp at which the ground was uneven last [ns]."""
        self._body = 0.0
        """For how long the body was pushed back [s]; `_wheel`: one of the wheels."""
        self._wheel = np.zeros(4)

    def imu(self, sample: ImuSample) -> None:
        """Between joint samples."""
        self._sum += sample.accel
        self._count += 1

    def joints(
        self, sample: JointSample, vx: float, wz: float, uneven: float, speed: float | None = None
    ) -> Touch | None:
        """What is touched just now, by a robot that is commanded to drive at `vx` [m/s], `wz` [rad/s] where the map is
        `uneven` [m] ahead of the wheels and under them. `speed`: measured, forward [m/s]; None: not known."""
        elapsed = min(max((sample.stamp - self._stamp) / NS, 0.0), LONGEST)
        self._stamp = sample.stamp
        if self._count:
            self._accel = self._sum / self._count
            self._sum, self._count = np.zeros(3), 0
        load = float(wheel_loads(self._limbs, sample.position, sample.effort, UP).sum())
        if math.isfinite(load):
            weighed = load / max(float(self._accel[2]), 0.5 * GRAVITY) - self._sprung
            self._mass += elapsed / WEIGH_TIME * (self._sprung + min(max(weighed, 0.0), PAYLOAD) - self._mass)
        if abs(vx) < DRIVES:
            self._body, self._wheel = 0.0, np.zeros(4)
            return None
        way = math.copysign(1.0, vx)
        back = -way * wheel_pushes(self._limbs, sample.position, sample.effort)
        held = -way * self._mass * self._accel[0] - back.sum()
        if uneven > FACE or sample.stamp < self._face:  # the clock was set back
            self._face = sample.stamp
        rough = sample.stamp - self._face <= AFTER_FACE * NS
        slow = speed is None or way * speed < SHORT * abs(vx)
        pushed = (
            slow
            and uneven < TALL
            and monitors.TOUCHED.outside(held / (ROUGH if rough else 1.0), high=self._force)
        )
        self._body = max(self._body + (elapsed if pushed else -elapsed), 0.0)
        others = (back.sum() - back) / 3.0
        beside = back[[2, 3, 0, 1]]
        alone = (
            (way * SX > 0.0) & (back > PUSHED) & (beside < STRAIN * back)
        )  # a wheel behind rolls where one rolled
        worst = np.where(alone, back - others - TURN * abs(wz), 0.0)
        for leg in range(4):
            more = slow and uneven < EDGE and monitors.TOUCHED.outside(float(worst[leg]))
            self._wheel[leg] = max(self._wheel[leg] + (elapsed if more else -elapsed), 0.0)
        if self._body >= (CLIMB_TIME if rough else BODY_TIME):
            return self._tell(Touch(way, 0.0))
        if self._wheel.max() >= WHEEL_TIME:
            leg = int(self._wheel.argmax())
            return self._tell(Touch(way, float(SY[leg]) * self._limbs.tread))
        return None

    def _tell(self, touch: Touch) -> Touch:
        self._body, self._wheel = 0.0, np.zeros(4)
        return touch


def uneven(around: Surroundings, pose: tuple[float, float, float], body: Body) -> tuple[float, float]:
    """How far [m] the ground under the `body` and AHEAD of it, and that under it and as far behind it, lies off the
    plane under the body.

    `pose`: x, y [m], yaw [rad]. By what was measured: what was touched explains no touch. The plane is fitted, because
    the trunk is level on a slope, too. Where it stands on faces there is none, and what is told is how far the ground
    lies off the lowest and the highest of them: all stairs under it push at a robot that climbs."""
    x, y, yaw = (float(v) for v in pose)
    front, side, resolution = body.front, body.left, around.resolution
    reach = math.ceil(math.hypot(front + AHEAD, side + BESIDE) / resolution)
    row, col = round((y - around.origin[1]) / resolution), round((x - around.origin[0]) / resolution)
    rows, cols = slice(max(row - reach, 0), row + reach + 1), slice(max(col - reach, 0), col + reach + 1)
    height = around.height[rows, cols]
    known = np.isfinite(height) & (around.source[rows, cols] != TOUCHED)
    r, k = np.nonzero(known)
    dx, dy = (
        around.origin[0] + (k + cols.start) * resolution - x,
        around.origin[1] + (r + rows.start) * resolution - y,
    )
    c, s = math.cos(yaw), math.sin(yaw)
    along, across = c * dx + s * dy, c * dy - s * dx
    near = (np.abs(along) <= front + AHEAD) & (np.abs(across) <= side + BESIDE)
    terms = np.column_stack([np.ones_like(along), along, across])[near]
    ground = height[r, k][near].astype(float)
    beside = np.abs(terms[:, 2]) > side
    under = (np.abs(terms[:, 1]) <= front) & ~beside
    if np.count_nonzero(under) < CELLS:
        return 0.0, 0.0
    plane = np.linalg.lstsq(terms[under], ground[under], rcond=1e-3)[0]
    off = np.abs(ground - terms @ plane)
    if np.sort(off[under])[-CELLS] > FACE:
        low, high = np.sort(ground[under])[[CELLS - 1, -CELLS]]
        off = np.maximum(ground - low, high - ground)
    off = np.where(beside, np.minimum(off, 0.5 * TALL), off)
    ahead, behind = (np.sort(off[way * terms[:, 1] >= -front]) for way in (1.0, -1.0))
    return float(ahead[-CELLS]), float(behind[-CELLS])
