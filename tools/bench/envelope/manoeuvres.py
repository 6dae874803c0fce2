"""One trial of one manoeuvre: the ground it needs, the line the robot is to follow there, and how the attempt ended.

Locomotion alone: no perception, no map, the true pose steers. The face, post or gap has the size of the cell of the
envelope's table;
friction, payload, start, speed and what else a robot meets differently each time are drawn at random (`DRAWN`).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from hal.envelope import FAILURES
from hal.limbs import LEGS
from hal.lowlevel import Locomotion
from hal.mujoco.driver import Driver
from hal.mujoco.robot import Simulated
from hal.mujoco.sim import Simulation
from hal.rotation import wrap
from tools.bench.envelope.terrain import CELL_SIDE, posts
from tools.bench.envelope.trial import TIME_STEP, steering

Field = NDArray[np.float64]

DRAWN: dict[str, tuple[str, float, float]] = {
    "friction": ("-", 0.5, 1.0),
    "payload": ("kg", 0.0, 3.0),
    "speed": ("m/s", 0.4, 0.6),
    "speed_bend": ("m/s", 0.3, 0.5),
    "yaw_rate": ("rad/s", 0.5, 0.8),
    "aside": ("m", -0.03, 0.03),
    "yaw": ("rad", -0.05, 0.05),
    "run_up": ("m", 0.15, 0.45),
}
"""What is drawn uniformly in each trial: unit, least, most. It stands in the file."""

MAX_TILT = math.cos(math.radians(40.0))
"""Cosine of the tilt, to the vertical and to the ground's normal, beyond which the robot fell."""
MAX_ASIDE, MAX_OFF = 0.10, math.radians(20.0)
"""Off its line [m, rad] beyond which the robot slid or was turned."""
ROUGH_ASIDE, ROUGH_OFF = 0.25, math.radians(45.0)
"""The same among posts and in turns, off the arc or off where a radian of a turn on the spot began: posts turn the
robot aside and wheels
roll on while it turns, and the tracker drives back."""
MAX_CRAB, CRAB_TIME = 0.5, 0.7
"""Largest drift off the heading that is steered against [rad], and over which time it is told [s]."""
STUCK_AFTER = 5.0
"""Time without progress [s]."""
LEAST_PROGRESS = 0.02
"""[m or rad]"""
LONGEST_TRIAL = 30.0
"""[s]; who needs longer is stuck."""
TRUNK_FORCE, TOUCH_TIME = 20.0, 0.3
"""Normal force on the trunk [N], and for how long on end [s]: it lies on what it touches. A belly that hits the nose of
a stair on the
way up does so for less, and all such drives came up."""
JUDGE_EVERY = 4
"""Physics steps between two looks of the judge."""
HALF_LENGTH, HALF_WIDTH = 0.29, 0.23
"""Of the wheels' footprint of the largest robot [m]: axle to centre and wheel radius; track and half a wheel."""
GROUND_MARGIN = 0.6
"""Ground beyond start and finish [m]."""
BAR_WIDTH = 0.10
"""Width [m]."""

Way = Literal["ahead", "back", "turn"]


@dataclass(frozen=True, slots=True, eq=False)
class Trial:
    """One attempt. The robot drives along the x axis, or turns to the left or right about a point."""

    height: NDArray[np.float32]
    """(rows, cols) ground [m]."""
    corner: tuple[float, float]
    """Of cell [0, 0] [m]."""
    normal: tuple[float, float, float]
    """Of the ground without its faces."""
    way: Way
    speed: float
    """[m/s]"""
    rate: float
    """Yaw rate [rad/s], left positive; 0 unless it turns."""
    start: tuple[float, float, float]
    """[m, m, rad]"""
    marks: tuple[float, ...]
    """Progress [m or rad] at which each unit of the manoeuvre (crossing, riser, metre, radian) begins."""
    finish: float
    """Progress at which it ended well [m or rad]."""
    friction: float
    payload: float
    rough: bool = False
    """It need not keep to its line so closely."""


@dataclass(frozen=True, slots=True)
class Attempt:
    """How a trial ended."""

    units: int
    """Units of the manoeuvre that were begun."""
    failure: str
    """One of `FAILURES`, or nothing."""
    seconds: float


@dataclass(slots=True)
class _Line:
    """Where the robot is on the line it is to follow."""

    trial: Trial
    yaw: float = 0.0
    progress: float = 0.0
    unit: int = 0
    place: tuple[float, float] = (0.0, 0.0)
    """At the beginning of this unit of a turn on the spot."""
    before: tuple[float, float] = (0.0, 0.0)
    crab: float = 0.0
    """Angle from the heading to the way it takes [rad], smoothed: on a side slope wheels creep downhill."""

    def begin(self, x: float, y: float, yaw: float) -> None:
        """It sets off here."""
        self.place = self.before = x, y
        self.yaw = yaw

    def _drifts(self, x: float, y: float, yaw: float) -> float:
        """`crab` after the step to here."""
        dx, dy = x - self.before[0], y - self.before[1]
        self.before = x, y
        if math.hypot(dx, dy) > 0.2 * self.trial.speed * JUDGE_EVERY * TIME_STEP:
            heading = yaw + math.pi if self.trial.way == "back" else yaw
            seen = float(np.clip(wrap(math.atan2(dy, dx) - heading), -MAX_CRAB, MAX_CRAB))
            self.crab += JUDGE_EVERY * TIME_STEP / CRAB_TIME * (seen - self.crab)
        return self.crab

    def follow(self, x: float, y: float, yaw: float) -> tuple[float, float, float]:
        """Yaw rate that keeps it on the line [rad/s], how far it is aside [m] and off its heading [rad]."""
        t = self.trial
        if t.way != "turn":
            sign = 1.0 if t.way == "ahead" else -1.0
            self.progress = sign * (x - t.start[0])
            course = yaw + self._drifts(x, y, yaw)
            return float(steering(sign * y, course)), y, course
        side = math.copysign(1.0, t.rate)
        self.progress += side * wrap(yaw - self.yaw)
        self.yaw = yaw
        unit = int(self.progress)
        if unit > self.unit:
            self.unit, self.place = unit, (x, y)
        if t.speed == 0.0:
            return t.rate, math.hypot(x - self.place[0], y - self.place[1]), 0.0
        radius = t.speed / abs(t.rate)
        x0, y0, yaw0 = t.start
        dx, dy = x - (x0 - side * radius * math.sin(yaw0)), y - (y0 + side * radius * math.cos(yaw0))
        outside = math.hypot(dx, dy) - radius
        off = wrap(yaw - (math.atan2(dy, dx) + side * 0.5 * math.pi))
        return t.rate + float(steering(-side * outside, off)), outside, off


def attempt(controller: Locomotion, trial: Trial, robot: Simulated | None = None) -> Attempt:
    """Drive a trial to its end, with a robot or the default one."""
    t = trial
    most_aside, most_off = (ROUGH_ASIDE, ROUGH_OFF) if t.rough else (MAX_ASIDE, MAX_OFF)
    sim = Simulation(
        t.height, CELL_SIDE, t.corner, t.friction, timestep=TIME_STEP, payload=t.payload, robot=robot
    )
    sim.reset(*t.start, settle=0.3)
    driver = Driver(sim, controller)
    driver.settle(0.4)
    line = _Line(t)
    # The middle of its wheels: the trunk sways by 0.1 m where a controller shifts its weight to lift a wheel.
    wheels = [sim.model.geom(f"{leg}_wheel").id for leg in LEGS]
    x, y, _ = sim.data.geom_xpos[wheels].mean(0).tolist()
    line.begin(x, y, sim.yaw)
    best, moved = 0.0, sim.time
    clear = sim.time
    normal = np.array(t.normal)
    speed = -t.speed if t.way == "back" else t.speed
    while True:
        x, y, _ = sim.data.geom_xpos[wheels].mean(0).tolist()
        wz, aside, off = line.follow(x, y, sim.yaw)
        units = max(sum(mark <= line.progress for mark in t.marks), 1)
        up = sim.rotation[:, 2]
        if sim.part_forces()[0] <= TRUNK_FORCE:
            clear = sim.time
        failure = ""
        if max(up[2], float(up @ normal)) < MAX_TILT or sim.diverged:
            failure = "fell"
        elif line.progress >= t.finish:
            return Attempt(len(t.marks), "", sim.time)
        elif sim.time - clear > TOUCH_TIME:
            failure = "touched"
        elif abs(aside) > most_aside or abs(off) > most_off:
            failure = "slid"
        elif sim.time - moved > STUCK_AFTER or sim.time > LONGEST_TRIAL:
            failure = "stuck"
        if failure:
            assert failure in FAILURES
            return Attempt(units, failure, sim.time)
        if line.progress > best + LEAST_PROGRESS:
            best, moved = line.progress, sim.time
        for _ in range(JUDGE_EVERY):
            driver.step(speed, wz)


Values = tuple[float, ...]
Draw = dict[str, float]


def _ground(x0: float, x1: float, half: float) -> tuple[Field, Field]:
    """x, y [m] of the cells from x0 to x1 and `half` to both sides."""
    return np.meshgrid(np.arange(x0, x1, CELL_SIDE), np.arange(-half, half + 1e-9, CELL_SIDE))


def _tilted(x: Field, y: Field, slope: float, azimuth: float) -> tuple[Field, tuple[float, float, float]]:
    """Plane that rises by `slope` [rad] towards `azimuth` [rad], and its normal."""
    a, b = math.tan(slope) * math.cos(azimuth), math.tan(slope) * math.sin(azimuth)
    length = math.sqrt(1.0 + a * a + b * b)
    return a * x + b * y, (-a / length, -b / length, 1.0 / length)


def _draw(rng: np.random.Generator) -> Draw:
    return {name: float(rng.uniform(low, high)) for name, (_, low, high) in DRAWN.items()}


def _straight(
    x: Field,
    y: Field,
    z: Field,
    normal: tuple[float, float, float],
    way: Way,
    begin: float,
    marks: tuple[float, ...],
    finish: float,
    d: Draw,
    rough: bool = False,
) -> Trial:
    """Along the x axis from `begin`; `marks` and `finish` are x of the trunk's centre where it drives ahead [m].
    Backward all is mirrored."""
    height, corner = z, (float(x[0, 0]), float(y[0, 0]))
    sign = -1.0 if way == "back" else 1.0
    if way == "back":
        height, corner = z[:, ::-1], (-float(x[0, -1]), corner[1])
        normal = (-normal[0], normal[1], normal[2])
    return Trial(
        height.astype(np.float32),
        corner,
        normal,
        way,
        d["speed"],
        0.0,
        (sign * begin, d["aside"], d["yaw"]),
        tuple(mark - begin for mark in marks),
        finish - begin,
        d["friction"],
        d["payload"],
        rough,
    )


def _crossing(values: Values, rng: np.random.Generator, up: bool, way: Way) -> Trial:
    """One face, `height` [m], at `angle` [rad] to the way, on ground of `slope` [rad]. It crosses the x axis at 0."""
    height, angle, slope = values
    d = _draw(rng)
    angle *= rng.choice((-1.0, 1.0))
    azimuth = float(rng.uniform(-math.pi, math.pi))
    reach = HALF_LENGTH + (HALF_WIDTH + 0.05) * abs(math.tan(angle))
    begin, finish = -reach - d["run_up"], reach + 0.15
    x, y = _ground(begin - GROUND_MARGIN, finish + GROUND_MARGIN, 1.0)
    plane, normal = _tilted(x, y, slope, azimuth)
    beyond = x * math.cos(angle) + y * math.sin(angle) > 0.0
    z = plane + np.where(beyond == up, height, 0.0)
    return _straight(x, y, z, normal, way, begin, (begin,), finish, d)


def _stairs(values: Values, rng: np.random.Generator, up: bool) -> Trial:
    """Four steps."""
    riser, tread, angle = values
    d = _draw(rng)
    angle *= rng.choice((-1.0, 1.0))
    steps, along = 4, tread / math.cos(angle)
    reach = HALF_LENGTH + (HALF_WIDTH + 0.05) * abs(math.tan(angle))
    begin, finish = -reach - d["run_up"], (steps - 1) * along + reach + 0.15
    x, y = _ground(begin - GROUND_MARGIN, finish + GROUND_MARGIN, 1.0)
    beyond = x * math.cos(angle) + y * math.sin(angle)
    climbed = np.clip(np.floor(beyond / tread) + 1.0, 0.0, steps)
    z = riser * (climbed if up else steps - climbed)
    marks = tuple(k * along - HALF_LENGTH - 0.1 for k in range(steps))
    return _straight(x, y, z, (0.0, 0.0, 1.0), "ahead", begin, (begin, *marks[1:]), finish, d)


def _slope(values: Values, rng: np.random.Generator) -> Trial:
    """Two metres on a plane, at `direction` [rad] to the way up; level ground twists into it within 0.8 m."""
    steepness, direction = values
    d = _draw(rng)
    twist = 0.8
    begin, on = -HALF_LENGTH - 0.1, twist + HALF_LENGTH
    x, y = _ground(begin - GROUND_MARGIN, on + 2.0 + GROUND_MARGIN, 1.0)
    direction *= rng.choice((-1.0, 1.0))
    _, normal = _tilted(x, y, steepness, direction)
    share = np.clip(x / twist, 0.0, 1.0)
    along = np.where(x < twist, 0.5 * twist * share**2, x - 0.5 * twist)
    z = math.tan(steepness) * (math.cos(direction) * along + math.sin(direction) * y * share)
    return _straight(x, y, z, normal, "ahead", begin, (begin, on + 1.0), on + 2.0, d)


def _posts(values: Values, rng: np.random.Generator) -> Trial:
    """Two metres of a stepfield."""
    height, speed = values
    d = _draw(rng) | {"speed": speed}
    begin, length = -HALF_LENGTH - d["run_up"], 2.0
    x, y = _ground(begin - GROUND_MARGIN, length + HALF_LENGTH + GROUND_MARGIN, 1.0)
    thirds = posts(x, y, math.floor(x.max() / 0.12) + 1, rng)
    z = np.where(x < length, thirds * height / 3.0, 0.0)
    return _straight(
        x,
        y,
        z,
        (0.0, 0.0, 1.0),
        "ahead",
        begin,
        (begin, begin + 1.0),
        length + HALF_LENGTH + 0.1,
        d,
        rough=True,
    )


def _gap(values: Values, rng: np.random.Generator) -> Trial:
    """A gap half a metre deep, up to 0.2 rad askew."""
    (width,) = values
    d = _draw(rng)
    askew = float(rng.uniform(-0.2, 0.2))
    begin, finish = -HALF_LENGTH - 0.05 - d["run_up"], width + HALF_LENGTH + 0.25
    x, y = _ground(begin - GROUND_MARGIN, finish + GROUND_MARGIN, 1.0)
    beyond = x * math.cos(askew) + y * math.sin(askew)
    z = np.where((beyond > 0.0) & (beyond <= width - 0.5 * CELL_SIDE), -0.5, 0.0)
    return _straight(x, y, z, (0.0, 0.0, 1.0), "ahead", begin, (begin,), finish, d)


def _turn(values: Values, rng: np.random.Generator, moving: bool) -> Trial:
    """Turn on the spot or in a curve, astride a kerb or bar of `height` [m] or (`place` 0) with one just beside the
    wheels."""
    height, slope, place = values
    d = _draw(rng)
    half = 1.6 if moving else 1.0
    x, y = _ground(-half, half, half)
    plane, normal = _tilted(x, y, slope, float(rng.uniform(-math.pi, math.pi)))
    angle = float(rng.uniform(-math.pi, math.pi))
    c, s = math.cos(angle), math.sin(angle)
    if place > 0.5:
        at = float(rng.uniform(-0.15, 0.15))
    else:
        at = HALF_LENGTH * abs(c) + HALF_WIDTH * abs(s) + float(rng.uniform(0.02, 0.10))
    beyond = x * c + y * s - at
    kerb = bool(rng.random() < 0.5)
    raised = (
        beyond > 0.0 if kerb else np.abs(beyond - (0.0 if place > 0.5 else 0.5 * BAR_WIDTH)) < 0.5 * BAR_WIDTH
    )
    if kerb and rng.random() < 0.25:
        raised = ~raised
    z = plane + np.where(raised, height, 0.0)
    finish = 2.0 if moving else 3.0
    return Trial(
        z.astype(np.float32),
        (float(x[0, 0]), float(y[0, 0])),
        normal,
        "turn",
        d["speed_bend"] if moving else 0.0,
        d["yaw_rate"] * float(rng.choice((-1.0, 1.0))),
        (0.0, 0.0, 0.0),
        tuple(float(k) for k in range(int(finish))),
        finish,
        d["friction"],
        d["payload"],
        rough=True,
    )


MANOEUVRES: dict[str, Callable[[Values, np.random.Generator], Trial]] = {
    "up": lambda v, rng: _crossing(v, rng, up=True, way="ahead"),
    "down": lambda v, rng: _crossing(v, rng, up=False, way="ahead"),
    "back_up": lambda v, rng: _crossing(v, rng, up=True, way="back"),
    "back_down": lambda v, rng: _crossing(v, rng, up=False, way="back"),
    "stairs_up": lambda v, rng: _stairs(v, rng, up=True),
    "stairs_down": lambda v, rng: _stairs(v, rng, up=False),
    "bend": lambda v, rng: _turn(v, rng, moving=True),
    "spin": lambda v, rng: _turn(v, rng, moving=False),
    "slope": _slope,
    "posts": _posts,
    "gap": _gap,
}
"""The trial of a cell, its values in SI units."""
