"""Many robots on one ground, stepped together. Each has a body drawn from `Physics`: friction, mass, gains, delay.
`mujoco.rollout` steps them on the cores; `tools.train.warp` on an accelerator."""

from __future__ import annotations

import mujoco
import numpy as np
from mujoco import rollout
from numpy.typing import NDArray

from hal.mujoco.model import build
from hal.robots.go2w import facts as go2w
from hal.robots.go2w.locomotion.layout import Layout
from hal.robots.go2w.simulated import GO2W
from hal.types import Array
from tools.train.settings import DESCRIPTION, PERIOD, Physics
from tools.train.terrain import CELL_SIDE, Ground

QPOS, QVEL = slice(1, 24), slice(24, 46)
"""Columns of MuJoCo's full physics state; column 0 is the time."""
THREAD_COUNT = 2


def variant(ground: Ground, physics: Physics, rng: np.random.Generator) -> mujoco.MjModel:
    """A robot of its own."""
    model = build(
        ground.height,
        CELL_SIDE,
        ground.origin,
        GO2W,
        friction=float(rng.uniform(*physics.friction)),
        timestep=physics.timestep,
        looks=False,
    )
    # Pyramids, contacts without torsion and few iterations: a third of the exact model's cost.
    model.opt.cone = mujoco.mjtCone.mjCONE_PYRAMIDAL
    model.opt.impratio = 1.0
    model.opt.iterations = physics.iterations
    for leg in go2w.LEGS:
        model.geom_condim[model.geom(f"{leg}_wheel").id] = 3
    # The dry friction of the joints needs more iterations than that.
    model.dof_frictionloss[6:] *= 0.5
    trunk = model.body("base_link").id
    model.body_mass[trunk] += rng.uniform(*physics.mass)
    model.body_ipos[trunk] += rng.uniform(-physics.centre, physics.centre, 3)
    layout = Layout(DESCRIPTION)
    for column, gain in ((1, layout.kp), (2, layout.kd)):
        model.actuator_biasprm[:, column] = -gain * (1.0 + rng.uniform(-physics.gains, physics.gains))
    return model


class Robots:
    """`n` robots and their states, on the cores. A step is one policy step."""

    def __init__(self, n: int, physics: Physics, rng: np.random.Generator) -> None:
        self.ground = Ground.build()
        self.physics, self._rng = physics, rng
        self.layout = Layout(DESCRIPTION)
        self._models = [variant(self.ground, physics, rng) for _ in range(physics.models)]
        first = self._models[0]
        data = mujoco.MjData(first)
        self._rest = data.qpos.copy()
        joint = [first.joint(name) for name in go2w.MOTORS]
        self.qadr = np.array([j.qposadr[0] for j in joint])
        self.vadr = np.array([j.dofadr[0] for j in joint])
        size = mujoco.mj_stateSize(first, mujoco.mjtState.mjSTATE_FULLPHYSICS)
        if (first.nq, first.nv) != (23, 22) or size < QVEL.stop:
            raise RuntimeError("the state of the model is not time, 23 positions, 22 velocities")
        self.state = np.zeros((n, size))
        self.drawn = rng.integers(0, physics.models, n)
        """(n,) which of the models each robot is."""
        self.delay = rng.choice(physics.delays, n)
        self._warm = np.zeros((n, 22))
        self._steps = round(PERIOD / physics.timestep)
        self._control = np.zeros((n, 16))
        self._prepare(first)

    def _prepare(self, model: mujoco.MjModel) -> None:
        """What `_advance` needs; `model`: the first of all."""
        self._datas = [mujoco.MjData(model) for _ in range(THREAD_COUNT)]
        self._rollout = rollout.Rollout(nthread=THREAD_COUNT)

    def place(self, which: NDArray[np.int64], x: Array, y: Array, yaw: Array, speed: Array) -> None:
        """Put robots on the ground, rolling forward at `speed` [m/s], a little shaken, each with another body; all
        (n,)."""
        n, rng = len(which), self._rng
        q = self.layout.default + rng.normal(0.0, 0.04, (n, 16))
        state = np.zeros((n, self.state.shape[1]))
        state[:, QPOS] = self._rest
        state[:, 1], state[:, 2] = x, y
        state[:, 3] = self.ground.at(x, y) + go2w.stand_height(go2w.STAND) + 0.01
        state[:, 4], state[:, 5:7], state[:, 7] = np.cos(0.5 * yaw), 0.0, np.sin(0.5 * yaw)
        state[:, 1 + self.qadr] = q
        state[:, 24:30] = rng.normal(0.0, 0.15, (n, 6))
        state[:, 24] += speed * np.cos(yaw)
        state[:, 25] += speed * np.sin(yaw)
        state[:, 24 + self.vadr[12:]] += speed[:, None] / go2w.WHEEL_RADIUS
        self.state[which] = state
        self._warm[which] = 0.0
        self.drawn[which] = rng.integers(0, self.physics.models, n)
        self.delay[which] = rng.choice(self.physics.delays, n)
        self._control[which] = self.control(np.zeros((n, 16), np.float32))

    def control(self, action: NDArray[np.float32]) -> Array:
        """Input of the actuators (n, 16) for clipped outputs of the policy (n, 16)."""
        q, dq = self.layout.targets(action)
        return self.layout.kp * q + self.layout.kd * dq

    def push(self, which: NDArray[np.int64]) -> None:
        """Kick robots."""
        kick = self.physics.push * self._rng.uniform(-1.0, 1.0, (len(which), 2))
        self.state[which, 24:26] += kick

    def step(self, action: NDArray[np.float32]) -> NDArray[np.bool_]:
        """One policy step with clipped outputs (n, 16) -> (n,) True where the simulation broke down; such a robot stays
        where it was."""
        new = self.control(action)
        control = np.repeat(self._control[:, None], self._steps, axis=1)
        for k in range(self._steps):
            now = self.delay <= k
            control[now, k] = new[now]
        self._control = new
        last, acceleration = self._advance(control)
        broken = np.asarray(~np.isfinite(last).all(axis=1))
        last[broken] = self.state[broken]
        self._warm = np.nan_to_num(acceleration)
        self._warm[broken] = 0.0
        self.state = last
        return broken

    def _advance(self, control: Array) -> tuple[Array, Array]:
        """The states (n, size) after time steps with `control` (n, steps, 16), and the last accelerations (n, 22)."""
        models = [self._models[k] for k in self.drawn]
        states, _ = self._rollout.rollout(
            models, self._datas, self.state, control, initial_warmstart=self._warm
        )
        before = states[:, -2, QVEL] if self._steps > 1 else self.state[:, QVEL]
        last = np.ascontiguousarray(states[:, -1])
        return last, (last[:, QVEL] - before) / self.physics.timestep
