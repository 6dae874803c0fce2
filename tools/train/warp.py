"""Many robots stepped by MuJoCo Warp: on a CUDA device if there is one, else on the CPU, which only tests are for.

States, commands and rewards stay in numpy: a step sends positions, velocities and commands, and brings back the first
two.
"""

from __future__ import annotations

from typing import Any

import mujoco
import mujoco_warp as mjw
import numpy as np
import warp as wp

from hal.types import Array
from tools.train.physics import QPOS, QVEL, Robots

CONTACT_ROOM, ROW_ROOM = 256, 1200
"""Room for the contacts of a robot, on the mean of all, and for the rows of its constraints. A robot that lies on its
side in the ground had 286 and 1160; with 64 and 256 robots at a step were thrown away."""
DRAWN = ("geom_friction", "body_mass", "body_ipos", "actuator_biasprm")
"""Fields of the model in which robots differ (`tools.train.physics.variant`)."""


class WarpRobots(Robots):
    """As `Robots`. All bodies are drawn from the same models, so a step with the same states gives nearly the same."""

    def _prepare(self, model: mujoco.MjModel) -> None:
        n = len(self.state)
        self._tables = {name: np.stack([getattr(m, name) for m in self._models]) for name in DRAWN}
        self._device = wp.get_device("cuda:0" if wp.is_cuda_available() else "cpu")
        with wp.ScopedDevice(self._device):
            self._model = mjw.put_model(model, batch_sizes=dict.fromkeys(DRAWN, n))
            # Few iterations are meant (`Physics.iterations`).
            self._model.opt.warn_overflow &= ~mjw.OverflowType.ITERATIONS
            self._data = mjw.make_data(model, nworld=n, nconmax=CONTACT_ROOM, njmax=ROW_ROOM)
            self._commands = [wp.zeros_like(self._data.ctrl) for _ in range(self._steps)]
            self._before = wp.zeros_like(self._data.qvel)
        self._sent = np.full(n, -1)
        self._graph: Any = None

    def _advance(self, control: Array) -> tuple[Array, Array]:
        data = self._data
        with wp.ScopedDevice(self._device):
            if not np.array_equal(self._sent, self.drawn):
                for name, table in self._tables.items():
                    getattr(self._model, name).assign(table[self.drawn].astype(np.float32))
                self._sent = self.drawn.copy()
            for k, command in enumerate(self._commands):
                command.assign(control[:, k].astype(np.float32))
            data.qpos.assign(self.state[:, QPOS].astype(np.float32))
            data.qvel.assign(self.state[:, QVEL].astype(np.float32))
            data.qacc_warmstart.assign(self._warm.astype(np.float32))
            if not self._device.is_cuda:
                self._step()
            elif self._graph is None:
                self._step()  # compiles
                with wp.ScopedCapture() as capture:
                    self._step()
                self._graph = capture.graph
                return self._advance(control)
            else:
                wp.capture_launch(self._graph)
            last = self.state.copy()
            last[:, QPOS], last[:, QVEL] = data.qpos.numpy(), data.qvel.numpy()
            before = self._before.numpy()
        last[:, 0] += self._steps * self.physics.timestep
        return last, (last[:, QVEL] - before) / self.physics.timestep

    def _step(self) -> None:
        """All time steps of a policy step, on the device."""
        for command in self._commands:
            wp.copy(self._data.ctrl, command)
            wp.copy(self._before, self._data.qvel)
            mjw.step(self._model, self._data)
