"""A learnt locomotion policy, ours or somebody else's (`hal.robots.go2w.locomotion.source`), as a controller.

Policies were trained to step at zero command and creep by 2-3 cm/s, so at zero command the robot brakes, settles and
then holds its joints where they are.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from hal.lowlevel import Ground, LowCommand, LowState
from hal.robots.go2w import facts as go2w
from hal.robots.go2w.locomotion.layout import Layout
from hal.robots.go2w.locomotion.source import read_policy
from hal.robots.go2w.locomotion.torchfile import PolicyError
from hal.rotation import up_of
from hal.types import Array, PostureCommand, VelocityCommand

SETTLE_TIME = 0.6
"""[s] of zero command that the policy brakes before the joints are held."""
HOLD_KP, HOLD_KD = 90.0, 3.0
WHEEL_HOLD_KP, WHEEL_HOLD_KD = 12.0, 1.0
"""Gains of the stand-hold [Nm/rad, Nms/rad]."""
HOLD_BLEND = 0.4
"""[s] over which the policy's soft gains turn into the hold's."""


class PolicyController:
    """`hal.lowlevel.Locomotion` from a policy, see `read_policy`. Follows vx, vy and wz; ignores posture. Raises
    PolicyError."""

    def __init__(self, source: Path) -> None:
        self.form, self.description, self.network = read_policy(source)
        self._every = self.description.every
        self.period = self.description.period / self._every
        self.layout = Layout(self.description)
        self._hold_kp = np.array([HOLD_KP] * 12 + [WHEEL_HOLD_KP] * 4)
        self._hold_kd = np.array([HOLD_KD] * 12 + [WHEEL_HOLD_KD] * 4)
        self._frames = np.zeros((self.layout.oldest + 1, self.layout.frame_size), np.float32)
        self._command = LowCommand(*(np.zeros(16) for _ in range(5)))
        self.places = self.layout.places
        """(m, 2), see `hal.lowlevel.Sighted`."""
        self._ground = Ground(np.full(len(self.places), np.nan), "nobody tells it any")
        self.reset()

    def reset(self) -> None:
        """Forget all state."""
        self.shake = 0.0
        """Standard deviation of noise on the outputs, as policies are trained with. The same after each reset."""
        self._noise = np.random.default_rng(0)
        self._action = np.zeros(self.layout.size, np.float32)
        self.network.reset()
        self._tick = 0
        self._begun = False
        self._idle_since: float | None = None
        self._held: Array | None = None

    def step(self, state: LowState, velocity: VelocityCommand, posture: PostureCommand) -> LowCommand:
        """One motor period; the network runs every `decimation`-th."""
        del posture
        if velocity.vx != 0.0 or velocity.vy != 0.0 or velocity.wz != 0.0:
            self._idle_since = None
            if self._held is not None:
                self._held = None
                self._action[:] = 0.0
                self.network.reset()
                self._tick = 0
                self._begun = False
        elif self._idle_since is None:
            self._idle_since = state.time
        if self._idle_since is not None and state.time - self._idle_since >= SETTLE_TIME:
            return self._hold(state)
        if self._tick % self._every == 0:
            self._run(state, velocity)
        self._tick += 1
        return self._command

    def see(self, ground: Ground) -> None:
        """The ground at `places`."""
        self._ground = ground

    def warning(self) -> str:
        """What it does not see; a network does not tell why it stops."""
        if not len(self.places) or not self._ground.lacks:
            return ""
        return f"the policy sees no ground: {self._ground.lacks}; it counts as {self.layout.unknown} m below"

    def _hold(self, state: LowState) -> LowCommand:
        c = self._command
        if self._held is None:
            self._held = state.q.copy()
            self._held_since = state.time
            # What the springs carry now, they carry on: no sag when the gains change.
            self._held_tau = self.layout.kp * (c.q - state.q)
            self._held_tau[go2w.WHEEL_JOINTS] = 0.0
        s = min((state.time - self._held_since) / HOLD_BLEND, 1.0)
        c.q[:] = self._held
        c.dq[:] = 0.0
        c.tau[:] = self._held_tau
        c.kp[:] = (1.0 - s) * self.layout.kp + s * self._hold_kp
        c.kd[:] = (1.0 - s) * self.layout.kd + s * self._hold_kd
        return c

    def _run(self, state: LowState, velocity: VelocityCommand) -> None:
        frames, layout = self._frames, self.layout
        frames[1:] = frames[:-1].copy()
        command = np.array([velocity.vx, velocity.vy, velocity.wz])
        up = np.array(up_of(state.quaternion))
        layout.frame(state.gyro, up, command, state.q, state.dq, self._action, frames[0], self._ground.above)
        if not self._begun:
            frames[1:] = frames[0]
            self._begun = True
        action = self.network(frames.ravel()[layout.seen])
        if not np.isfinite(action).all():
            raise PolicyError("the policy's network made what is not a number: use another controller")
        if self.shake > 0.0:
            action = action + self._noise.normal(0.0, self.shake, layout.size).astype(np.float32)
        self._action = np.clip(action, layout.lower, layout.upper)
        c = self._command
        c.q[:], c.dq[:] = layout.targets(self._action)
        c.tau[:] = 0.0
        c.kp[:] = layout.kp
        c.kd[:] = layout.kd
