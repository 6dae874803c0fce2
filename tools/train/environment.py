"""Many robots that are told velocities: what they see, what they are paid, when they begin anew and on which ground."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hal.mujoco.attitude import FILTER_GAIN
from hal.robots.go2w import facts as go2w
from hal.robots.go2w.locomotion.hybrid import ONWARD_SPEED, TURN_MOST
from hal.robots.go2w.locomotion.layout import Layout
from hal.robots.go2w.locomotion.rlsar import FRAME_LENGTH
from hal.types import GRAVITY, Array
from tools.bench.envelope.trial import TIPPED_COSINE, steering
from tools.train.physics import QPOS, QVEL, Robots
from tools.train.settings import DESCRIPTION, PARAMS, PERIOD, Reward, Settings
from tools.train.terrain import DEALT_KINDS, KINDS, LANE_LENGTH, LEVEL_BEFORE, LEVEL_COUNT, OPEN

AGES = PARAMS.ages
SEEN = FRAME_LENGTH * len(AGES)
"""Numbers that the policy sees."""
SCAN_PLACES = np.stack(np.meshgrid(np.linspace(-0.5, 0.9, 11), np.linspace(-0.4, 0.4, 5)), axis=-1).reshape(
    -1, 2
)
"""(55, 2) places in the heading frame [m] whose heights the critic sees."""
KNOWN_COUNT = SEEN + 3 + len(SCAN_PLACES) + 2
"""Numbers that the critic sees: the same, the body's velocity, heights, which way the ground is its own (kind,
level)."""
TRUNK_HEIGHT = 0.38
"""Height of the trunk over the ground from which the critic's heights are counted [m]."""
BACKWARD_EVERY = 7
"""One of so many robots in the lanes drives backward, as a robot that backs out of what it cannot pass."""
DETOUR_TIME = (0.4, 1.5)
"""[s] for which a robot in a lane is told to drive slower, to turn aside, or to stand, as the hybrid controller asks of
a policy amid rubble..."""
DETOUR_EVERY = 3.0
"""... and the mean time [s] between two commands of this kind, and on open ground between any two."""
LOW_HEIGHTS = (0.25, 0.13)
"""Of the trunk over the ground [m]: from where it costs, and where it counts as a fall."""


@dataclass(frozen=True, slots=True)
class Body:
    """What the reward looks at, (n,) or (n, k) each; velocities in the heading frame."""

    yaw: Array
    velocity: Array
    """(n, 3) [m/s]"""
    spin: Array
    """(n, 3) [rad/s], base_link"""
    up: Array
    """(n, 3) world z in base_link."""
    q: Array
    dq: Array
    torque: Array
    """(n, 16) [Nm]"""
    above: Array
    """Height of the trunk over the ground [m]."""


def rewards(
    body: Body, command: Array, action: NDArray[np.float32], before: NDArray[np.float32], layout: Layout
) -> dict[str, Array]:
    """Terms of the reward (n,) without their weights. `command` (n, 3): vx, vy [m/s], wz [rad/s]; two outputs in a
    row."""
    v, wheels = body.velocity, body.dq[:, 12:]
    vx = command[:, 0]
    share = np.clip(v[:, 0] * np.sign(vx) / np.maximum(np.abs(vx), 0.1), -1.0, 1.0)
    still = (np.abs(vx) < 0.05) & (np.abs(command[:, 2]) < 0.05)
    off = body.q[:, :12] - layout.default[:12]
    return {
        "velocity": np.exp(-((v[:, 0] - vx) ** 2 + v[:, 1] ** 2) / 0.1),
        "progress": np.where(np.abs(vx) > 0.1, share, 0.0),
        "turning": np.exp(-((body.spin[:, 2] - command[:, 2]) ** 2) / 0.15),
        "alive": np.ones(len(vx)),
        "bounce": v[:, 2] ** 2,
        "sway": (body.spin[:, :2] ** 2).sum(axis=1),
        "tilt": (body.up[:, :2] ** 2).sum(axis=1),
        "torque": (body.torque[:, :12] ** 2).sum(axis=1),
        "power": np.abs(body.torque * body.dq).sum(axis=1),
        "jerk": ((action - before) ** 2).sum(axis=1).astype(float),
        "posture": (off**2).sum(axis=1),
        "hips": (off[:, ::3] ** 2).sum(axis=1),
        "low": np.clip(LOW_HEIGHTS[0] - body.above, 0.0, 0.2),
        "creep": np.where(still, (wheels**2).mean(axis=1), 0.0),
    }


def felt(acceleration: Array) -> Array:
    """(n, 2) where an accelerometer sees the vertical, x and y of the world, under accelerations (n, 3) [m/s^2]; see
    `hal.mujoco.attitude`."""
    force = acceleration + np.array([0.0, 0.0, GRAVITY])
    return force[:, :2] / np.maximum(np.linalg.norm(force, axis=1, keepdims=True), 1e-6)


def in_body(quaternion: Array, level: Array) -> Array:
    """(n, 3) horizontal vectors of the world (n, 2) in the axes of bodies with attitudes (n, 4), w, x, y, z."""
    vector = np.pad(level, ((0, 0), (0, 1)))
    axis = -quaternion[:, 1:]
    turned = 2.0 * np.cross(axis, vector)
    return vector + quaternion[:, :1] * turned + np.cross(axis, turned)


def kinds(settings: Settings, n: int) -> NDArray[np.int64]:
    """(n,) kind of ground of each of so many robots."""
    turning = round(settings.turning * n)
    return np.concatenate([np.full(turning, OPEN), np.resize(DEALT_KINDS, n - turning)])


class Environment:
    """`n` robots. `observe` and `step` in turn."""

    def __init__(
        self, settings: Settings, n: int, rng: np.random.Generator, robots: type[Robots] = Robots
    ) -> None:
        self.settings, self._rng = settings, rng
        self.robots = robots(n, settings.physics, rng)
        self.layout = Layout(DESCRIPTION)
        self.kind = kinds(settings, n)
        self.back = (self.kind != OPEN) & (np.arange(n) % BACKWARD_EVERY == 0)
        """(n,) who drives the lane backward."""
        self.level = rng.integers(0, settings.first_level + 1, n)
        self.action = np.zeros((n, 16), np.float32)
        self.command = np.zeros((n, 3))
        self._cruise = np.zeros(n)
        """vx outside of detours [m/s]."""
        self._detour = np.zeros((n, 2))
        """Speed [m/s] and yaw rate beyond that of the lane [rad/s] of the detour, ..."""
        self._left = np.zeros(n)
        """... and what is left of it [s]."""
        self._asked = np.zeros(n)
        """Distance along the lane that was commanded [m]."""
        self._began = np.zeros(n)
        """x at the start [m]."""
        self._age = np.zeros(n, int)
        self._lean = np.zeros((n, 2))
        """Error of the attitude that the robot's IMU tells: its vertical less the true one, x and y of the world."""
        self._frames = np.zeros((AGES[-1] + 1, n, FRAME_LENGTH), np.float32)
        self._newest = 0
        self._fresh = np.ones(n, bool)
        self._last = round(settings.episode / PERIOD)
        self.passed: list[tuple[int, bool]] = []
        """Kind and success of the episodes that ended since this list was emptied."""
        self._begin(np.arange(n))
        self._age[:] = rng.integers(0, self._last, n)  # or all would end at once

    def resume(self, level: NDArray[np.int64]) -> None:
        """Begin anew at the levels (m,) of an earlier run; of another number of robots each draws from those of its
        kind."""
        n, before = len(self.kind), kinds(self.settings, len(level))
        if len(level) != n:
            level = np.array([self._rng.choice(level[before == kind]) for kind in self.kind])
        self.level[:] = level
        self._begin(np.arange(n))
        self._age[:] = self._rng.integers(0, self._last, n)

    # --- what they see ----------------------------------------------------------------------------------------------
    def body(self) -> Body:
        """Of all robots now."""
        s, r = self.robots.state, self.robots
        w, x, y, z = s[:, 4], s[:, 5], s[:, 6], s[:, 7]
        yaw = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
        up = np.stack([2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)], axis=1)
        c, sn = np.cos(yaw), np.sin(yaw)
        v = s[:, 24:27]
        velocity = np.stack([v[:, 0] * c + v[:, 1] * sn, v[:, 1] * c - v[:, 0] * sn, v[:, 2]], axis=1)
        q, dq = s[:, QPOS][:, r.qadr], s[:, QVEL][:, r.vadr]
        control = r.control(self.action)
        torque = np.clip(
            control - self.layout.kp * q - self.layout.kd * dq, -go2w.TORQUE_LIMIT, go2w.TORQUE_LIMIT
        )
        above = s[:, 3] - r.ground.at(s[:, 1], s[:, 2])
        return Body(yaw, velocity, s[:, 27:30], up, q, dq, torque, above)

    def observe(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """What the policy sees (n, SEEN) and what the critic sees (n, KNOWN_COUNT); commands in lanes follow the
        lane."""
        b, s = self.body(), self.robots.state
        told = b.up + in_body(s[:, 4:8], self._lean)
        lanes = self.kind != OPEN
        aside = s[:, 2] - self.robots.ground.middle(self.kind, self.level)
        ahead = np.where(self.back, np.arctan2(-np.sin(b.yaw), -np.cos(b.yaw)), b.yaw)
        turn = steering(aside, ahead) + self._detour[:, 1] * (self._left > 0.0)
        turn = np.clip(turn, -TURN_MOST, TURN_MOST)
        self.command[lanes, 2] = np.where(self.command[:, 0] == 0.0, 0.0, turn)[lanes]
        n, rng, noise = len(s), self._rng, self.settings.physics.noise
        self._newest = (self._newest + 1) % len(self._frames)
        frame = self._frames[self._newest]
        self.layout.frame(
            b.spin + rng.normal(0.0, noise["gyro"], (n, 3)),
            told + rng.normal(0.0, noise["up"], (n, 3)),
            self.command,
            b.q,
            b.dq + rng.normal(0.0, noise["dq"], (n, 16)),
            self.action,
            frame,
        )
        if self._fresh.any():
            self._frames[:, self._fresh] = frame[self._fresh]
            self._fresh[:] = False
        seen = np.concatenate(
            [self._frames[(self._newest - age) % len(self._frames)] for age in AGES], axis=1
        )
        c, sn = np.cos(b.yaw)[:, None], np.sin(b.yaw)[:, None]
        x = s[:, 1:2] + c * SCAN_PLACES[:, 0] - sn * SCAN_PLACES[:, 1]
        y = s[:, 2:3] + sn * SCAN_PLACES[:, 0] + c * SCAN_PLACES[:, 1]
        scan = np.clip(s[:, 3:4] - TRUNK_HEIGHT - self.robots.ground.at(x, y), -0.6, 0.6) * 5.0
        place = np.stack([self.kind / OPEN, self.level / LEVEL_COUNT], axis=1)
        return seen, np.concatenate([seen, b.velocity, scan, place], axis=1).astype(np.float32)

    # --- what they do -----------------------------------------------------------------------------------------------
    def step(self, output: NDArray[np.float32]) -> tuple[Array, NDArray[np.bool_], NDArray[np.bool_]]:
        """One step with the policy's outputs (n, 16) -> reward, ended by its own fault, ended by time; those begin
        anew, all (n,)."""
        reward: Reward = self.settings.reward
        before = self.action
        self.action = np.clip(output, self.layout.lower, self.layout.upper)
        speed = self.robots.state[:, 24:27].copy()
        broken = self.robots.step(self.action)
        self._lean += (
            FILTER_GAIN * PERIOD * (felt((self.robots.state[:, 24:27] - speed) / PERIOD) - self._lean)
        )
        self._age += 1
        b, s = self.body(), self.robots.state
        along = np.maximum(np.abs(np.cos(b.yaw)), 0.3)  # a detour does not lead along the lane
        self._asked += np.abs(self.command[:, 0]) * along * PERIOD
        terms = rewards(b, self.command, self.action, before, self.layout)
        total = reward.scale * sum(getattr(reward, name) * value for name, value in terms.items())
        lanes = self.kind != OPEN
        aside = np.abs(s[:, 2] - self.robots.ground.middle(self.kind, self.level))
        fell = broken | (b.up[:, 2] < TIPPED_COSINE) | (b.above < LOW_HEIGHTS[1])
        astray = lanes & (aside > 1.0)
        far = ~lanes & ((aside > 6.0) | (np.abs(s[:, 1] - 5.0) > 5.4))
        through = lanes & (s[:, 1] > LANE_LENGTH - LEVEL_BEFORE - 1.2)
        total = total + np.where(fell, reward.fall, 0.0) + np.where(astray & ~fell, reward.astray, 0.0)
        fault = fell | astray
        over = ~fault & ((self._age >= self._last) | through | far)
        ended = np.flatnonzero(fault | over)
        if len(ended):
            self._judge(ended, fault[ended])
            self._begin(ended)
        self._change_commands()
        kicked = np.flatnonzero(self._rng.random(len(s)) < PERIOD / self.settings.physics.push_every)
        self.robots.push(kicked)
        return total, fault, over

    def _judge(self, which: NDArray[np.int64], fault: NDArray[np.bool_]) -> None:
        """Up a level for three quarters of the commanded way, down for less than 0.45 of it or a fall."""
        lanes = self.kind[which] != OPEN
        way = self.robots.state[which, 1] - self._began[which]
        asked = self._asked[which]
        share = way / np.maximum(asked, 0.5)
        up = lanes & ~fault & (share > 0.75) & (asked > 1.8)
        down = lanes & ~up & (fault | ((share < 0.45) & (asked > 1.0)))
        judged = ~lanes | (asked > 1.8) | fault
        good = np.where(lanes, up, ~fault)
        self.passed += [
            (int(k), bool(g)) for k, g, j in zip(self.kind[which], good, judged, strict=True) if j
        ]
        level = self.level[which] + up - down
        # Who has mastered the last level goes anywhere: easy ground must not be forgotten.
        level = np.where(level >= LEVEL_COUNT, self._rng.integers(0, LEVEL_COUNT, len(which)), level)
        self.level[which] = np.clip(level, 0, LEVEL_COUNT - 1)

    def _begin(self, which: NDArray[np.int64]) -> None:
        n, rng = len(which), self._rng
        free = self.kind[which] == OPEN
        x = rng.uniform(-0.3, 0.3, n) + np.where(free, 5.0, 0.0)
        y = self.robots.ground.middle(self.kind[which], self.level[which]) + rng.uniform(-0.15, 0.15, n)
        yaw = np.where(free, rng.uniform(-np.pi, np.pi, n), rng.uniform(-0.2, 0.2, n))
        yaw = np.where(self.back[which], yaw + np.pi, yaw)
        self._draw(which)
        # The controller that hands over to this policy is driving already.
        wish = self._cruise[which]
        wish = np.where(self.back[which], wish, np.clip(wish, 0.0, None))
        rolling = wish * rng.uniform(0.0, 1.0, n) * (rng.random(n) < 0.5)
        self.robots.place(which, x, y, yaw, rolling)
        self.action[which] = 0.0
        self._lean[which] = 0.0
        self._age[which], self._asked[which], self._began[which] = 0, 0.0, x
        self._fresh[which] = True
        self._left[which] = 0.0

    def _draw(self, which: NDArray[np.int64]) -> None:
        """New commands: one direction in lanes; anything on open ground, turns on the spot and zero among it. Detours
        come later."""
        n, rng = len(which), self._rng
        free = self.kind[which] == OPEN
        spot = rng.random(n) < 0.3
        along = np.where(self.back[which], rng.uniform(-0.6, -0.2, n), rng.uniform(0.25, 0.8, n))
        vx = np.where(free, np.where(spot, 0.0, rng.uniform(-0.8, 1.0, n)), along)
        wz = np.where(free, rng.uniform(-1.0, 1.0, n) * (rng.random(n) < 0.8), 0.0)
        zero = free & (rng.random(n) < self.settings.still)
        self.command[which] = np.stack(
            [np.where(zero, 0.0, vx), np.zeros(n), np.where(zero, 0.0, wz)], axis=1
        )
        self._cruise[which] = self.command[which, 0]

    def _change_commands(self) -> None:
        n, rng = len(self.kind), self._rng
        lanes = self.kind != OPEN
        due = rng.random(n) < PERIOD / DETOUR_EVERY
        self._draw(np.flatnonzero(due & ~lanes))
        self._left = np.maximum(self._left - PERIOD, 0.0)
        begins = np.flatnonzero(due & lanes & (self._left == 0.0))
        k = len(begins)
        cruise = self._cruise[begins]
        slow = np.sign(cruise) * rng.uniform(ONWARD_SPEED, np.maximum(np.abs(cruise), ONWARD_SPEED))
        self._detour[begins, 0] = np.where(rng.random(k) < 0.2, 0.0, slow)
        self._detour[begins, 1] = rng.uniform(-TURN_MOST, TURN_MOST, k) * (rng.random(k) < 0.7)
        self._left[begins] = rng.uniform(*DETOUR_TIME, k)
        vx = np.where(self._left > 0.0, self._detour[:, 0], self._cruise)
        self.command[lanes, 0] = vx[lanes]

    def levels(self) -> dict[str, float]:
        """Mean level of each kind."""
        return {kind: float(self.level[self.kind == k].mean()) for k, kind in enumerate(KINDS)}
