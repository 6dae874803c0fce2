"""What the robot touches and no sensor foretold, felt from joints and IMU: something holds the body, or one wheel.

Newton's law does the work: what the wheels get from the ground, by the leg torques, is all that moves the robot. What
the accelerometer tells beyond that pushes at the body. A slope is in both. What throws the legs about on a climb pushes
back and forth, so that little is left of its mean. A wheel that leads is held where it alone is pushed back, while the
others drive.

The map explains a push at the body where its ground comes up to the trunk or to a shank (`near_body`): a shank that
hangs on a kerb pulls as hard as a pane of glass pushes. It explains a held wheel where it is `uneven` at the wheels.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hal.limbs import SIGN_X, SIGN_Y, Limbs, wheel_centres
from hal.raster import cell_of
from hal.safety import monitors
from hal.safety.swept import TOUCHED, Body, Surroundings
from hal.types import GRAVITY, NS, Array, ImuSample, JointSample
from hal.wheel_force import is_rigid, wheel_loads, wheel_pushes

MOST_PAYLOAD, WEIGH_TIME = 26.0, 1.0
"""[kg] at most, and time constant [s] of weighing it: by the wheels' loads, so that a payload on a slope pushes
nothing."""
UP = np.array([0.0, 0.0, 1.0])
SHORT_SHARE = 0.85
"""A robot that drives no slower than this share of its command is not held: it brakes, or its wheels strain against
each other in a bend."""
DRIVE_SPEED = 0.03
"""[m/s] A robot that is commanded slower than this drives nowhere."""
LEAST_PUSH = 12.0
"""[N] A wheel that is pushed back less than this is not held."""
STRAIN_SHARE = 0.3
"""Share of a wheel's push that the wheel behind or before it feels as well when the robot turns: it is no obstacle
then."""
TURN_PUSH = 60.0
"""[N s/rad] A turn pushes wheels back as well: what more it takes then."""
FACE_HEIGHT = 0.04
"""[m] Ground that lies this far off the plane that the robot stands on is a face to climb."""
EDGE_HEIGHT = 0.025
"""[m] The map explains a held wheel from here on: an edge of this height takes as much push as a wheel carries (its
radius is 0.086 m), and the map tells no lower one from its noise."""
PUSH_TIME = 0.3
"""[s] Time constant of the mean of what pushes at the body: decision 26. What the map explained it explains for as
long: on a face a shank comes and goes."""
WHEEL_TIME = 0.09
"""[s] that a wheel is held. One that jumps over a pebble is held for less."""
NEAR_LEVEL, NEAR_BELOW = 0.06, 0.04
"""[m] Ground of the map no farther from a part of the robot on the level, and no more below it, touches it: a cell and
a half, and the half of a wheel's radius."""
SHANK_SHARES = (0.0, 0.25, 0.5, 0.75)
"""Places on a shank, shares of the way from the knee to the axle; what its end meets, the wheel meets as well."""
UNDERSIDE_DEPTH = 0.05
"""[m] of the trunk below base_link."""
REACH_AHEAD = 0.2
"""[m] beyond the end of the body: what lies farther away holds no wheel."""
REACH_BESIDE = 0.05
"""[m] beside the body: a wall there holds a wheel that scrapes it."""
LEAST_CELLS = 3
"""Cells that must lie off the plane: one may be noise."""
LONGEST_STEP = 0.05
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
        self._joints_tell = not is_rigid(limbs)
        """What pushes a wheel back goes through its axle. The motor of a wheel that sits on the body feels none of it,
        and brakes in a bend: there the sum at the body tells alone."""
        self._accel: Array = np.array([0.0, 0.0, GRAVITY])
        """[m/s^2] mean specific force since the joint sample before."""
        self._sum, self._count = np.zeros(3), 0
        self._mass = sprung_mass
        self._stamp = 0
        self._body = 0.0
        """[N] mean push at the body."""
        self._explained = -math.inf
        """Stamp at which the map explained it last [ns]."""
        self._wheel = np.zeros(4)
        """[s] for how long each wheel was held."""

    def imu(self, sample: ImuSample) -> None:
        """Between joint samples."""
        self._sum += sample.accel
        self._count += 1

    def joints(
        self,
        sample: JointSample,
        vx: float,
        wz: float,
        uneven: float,
        speed: float | None = None,
        *,
        near_body: bool = False,
    ) -> Touch | None:
        """What is touched just now, by a robot that is commanded to drive at `vx` [m/s], `wz` [rad/s] where the map is
        `uneven` [m] ahead of the wheels and under them, and comes up to its body or not. `speed`: measured, forward
        [m/s]; None: not known."""
        elapsed = min(max((sample.stamp - self._stamp) / NS, 0.0), LONGEST_STEP)
        self._stamp = sample.stamp
        if self._count:
            self._accel = self._sum / self._count
            self._sum, self._count = np.zeros(3), 0
        load = float(wheel_loads(self._limbs, sample.position, sample.effort, UP).sum())
        if math.isfinite(load):
            weighed = load / max(float(self._accel[2]), 0.5 * GRAVITY) - self._sprung
            self._mass += (
                elapsed / WEIGH_TIME * (self._sprung + min(max(weighed, 0.0), MOST_PAYLOAD) - self._mass)
            )
        if abs(vx) < DRIVE_SPEED:
            self._body, self._wheel = 0.0, np.zeros(4)
            return None
        way = math.copysign(1.0, vx)
        back = -way * wheel_pushes(self._limbs, sample.position, sample.effort)
        slow = speed is None or way * speed < SHORT_SHARE * abs(vx)
        push = -way * self._mass * self._accel[0] - back.sum() if slow else 0.0
        if near_body or sample.stamp < self._explained:  # the clock was set back
            self._explained = sample.stamp
        mean = max(self._body + elapsed / PUSH_TIME * (push - self._body), 0.0)
        self._body = 0.0 if sample.stamp - self._explained < PUSH_TIME * NS else mean
        others = (back.sum() - back) / 3.0
        beside = back[[2, 3, 0, 1]]
        alone = (
            (way * SIGN_X > 0.0) & (back > LEAST_PUSH) & (beside < STRAIN_SHARE * back)
        )  # a wheel behind rolls where one rolled
        worst = np.where(alone & self._joints_tell, back - others - TURN_PUSH * abs(wz), 0.0)
        for leg in range(4):
            more = slow and uneven < EDGE_HEIGHT and monitors.TOUCHED.outside(float(worst[leg]))
            self._wheel[leg] = max(self._wheel[leg] + (elapsed if more else -elapsed), 0.0)
        if monitors.TOUCHED.outside(self._body, high=self._force):
            return self._tell(Touch(way, 0.0))
        if self._wheel.max() >= WHEEL_TIME:
            leg = int(self._wheel.argmax())
            return self._tell(Touch(way, float(SIGN_Y[leg]) * self._limbs.tread))
        return None

    def _tell(self, touch: Touch) -> Touch:
        self._body, self._wheel = 0.0, np.zeros(4)
        return touch


def uneven(around: Surroundings, pose: tuple[float, float, float], body: Body) -> tuple[float, float]:
    """How far [m] the ground under the `body` and REACH_AHEAD of it, and that under it and as far behind it, lies off
    the plane under the body.

    `pose`: x, y [m], yaw [rad]. By what was measured: what was touched explains no touch. The plane is fitted, because
    the trunk is level on a slope, too."""
    x, y, yaw = (float(v) for v in pose)
    front, side = body.front, body.left
    dx, dy, ground = _measured(around, x, y, math.hypot(front + REACH_AHEAD, side + REACH_BESIDE))
    c, s = math.cos(yaw), math.sin(yaw)
    along, across = c * dx + s * dy, c * dy - s * dx
    near = (np.abs(along) <= front + REACH_AHEAD) & (np.abs(across) <= side + REACH_BESIDE)
    terms, ground = np.column_stack([np.ones_like(along), along, across])[near], ground[near]
    under = (np.abs(terms[:, 1]) <= front) & (np.abs(terms[:, 2]) <= side)
    if np.count_nonzero(under) < LEAST_CELLS:
        return 0.0, 0.0
    plane = np.linalg.lstsq(terms[under], ground[under], rcond=1e-3)[0]
    off = np.abs(ground - terms @ plane)
    ahead, behind = (np.sort(off[way * terms[:, 1] >= -front]) for way in (1.0, -1.0))
    return float(ahead[-LEAST_CELLS]), float(behind[-LEAST_CELLS])


def near_body(
    around: Surroundings,
    place: tuple[float, float, float],
    rotation: Array,
    limbs: Limbs,
    q: Array,
    body: Body,
) -> bool:
    """Whether ground that was measured comes up to the trunk or to a shank, so that it may be what pushes at them.

    `place`: x, y, z [m] of base_link; `rotation`: (3, 3) from base_link to `map`; `q`: (16,) joint angles [rad]."""
    # A limb of a shorter calf without a tread ends on the shank.
    shanks = [
        wheel_centres(limbs._replace(calf=share * limbs.calf, tread_y=0.0), q) for share in SHANK_SHARES
    ]
    along, across = np.linspace(-body.back, body.front, 2 * len(SHANK_SHARES)), (-limbs.hip_y, limbs.hip_y)
    trunk = np.array([(x, y, -UNDERSIDE_DEPTH) for x in along for y in across])
    parts = np.concatenate([*shanks, trunk]) @ rotation.T
    dx, dy, ground = _measured(
        around, place[0], place[1], float(np.hypot(parts[:, 0], parts[:, 1]).max()) + NEAR_LEVEL
    )
    level = np.hypot(dx - parts[:, :1], dy - parts[:, 1:2]) <= NEAR_LEVEL
    return bool((level & (ground - place[2] >= parts[:, 2:] - NEAR_BELOW)).any())


def _measured(around: Surroundings, x: float, y: float, reach: float) -> tuple[Array, Array, Array]:
    """Measured cells about as far as `reach` [m] from x, y [m]: how far each lies off it, and its height [m]."""
    resolution, cells = around.resolution, math.ceil(reach / around.resolution)
    row, col = cell_of(y, around.origin[1], resolution), cell_of(x, around.origin[0], resolution)
    rows, cols = slice(max(row - cells, 0), row + cells + 1), slice(max(col - cells, 0), col + cells + 1)
    height = around.height[rows, cols]
    r, k = np.nonzero(np.isfinite(height) & (around.source[rows, cols] != TOUCHED))
    dx, dy = (
        around.origin[0] + (k + cols.start) * resolution - x,
        around.origin[1] + (r + rows.start) * resolution - y,
    )
    return dx, dy, height[r, k].astype(float)
