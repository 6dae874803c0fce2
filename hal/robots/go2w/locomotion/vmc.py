"""Virtual model control: a model-based locomotion controller for the wheeled legs that needs no learnt weights.

The trunk is held by virtual springs to a level attitude above the ground plane under the wheels; the wanted lift and
tilting moments are distributed on the four wheels, the legs carry the forces by their Jacobians, the wheels roll at
the commanded speed. Stiffness and damping that must be fast sit in the motors (kp, kd); what is computed here changes
slowly, so that a late command does little harm."""

from __future__ import annotations

import numpy as np

from hal.lowlevel import LowCommand, LowState
from hal.robots.go2w.facts import wheel_centres
from hal.robots.go2w.locomotion.climb import DRIVE
from hal.robots.go2w.locomotion.memory import MEMORY
from hal.robots.go2w.locomotion.params import RECORD, VmcParams
from hal.robots.go2w.locomotion.vmc_kernel import OUT_DQ, OUT_KD, OUT_KP, OUT_Q, OUT_TAU, vmc_tick
from hal.types import FELT_EDGE, PostureCommand, VelocityCommand


class VmcController:
    """Model-based locomotion (`hal.lowlevel.Locomotion`). Uses joint encoders, joint torques, attitude and gyro
    only."""

    def __init__(self, params: VmcParams | None = None, period: float = 0.005) -> None:
        """`period`: control period [s], 1 to 10 ms."""
        if not 0.001 <= period <= 0.010:
            raise ValueError(f"the control period must lie in 1..10 ms, got {period * 1e3:g} ms")
        self.params = params or VmcParams()
        self.period = period
        self._record = np.array([self.params], RECORD)
        self._memory = np.zeros(1, MEMORY)
        self._mode, self._blocked = self._memory["mode"], self._memory["blocked"][0]
        self._climb = self._record["climb"]
        self._command = np.zeros(5)
        self._out = np.zeros((5, 16))
        self._low = LowCommand(
            self._out[OUT_Q],
            self._out[OUT_DQ],
            self._out[OUT_TAU],
            self._out[OUT_KP],
            self._out[OUT_KD],
        )

    def reset(self) -> None:
        """Forget all state: the robot was moved, stood up or fell."""
        self._memory[:] = np.zeros(1, MEMORY)

    def take_over(self, vx: float) -> None:
        """Forget all state but this: the robot drives at `vx` [m/s]."""
        self.reset()
        self._memory["vx"] = self._memory["speed"] = vx

    def step(self, state: LowState, velocity: VelocityCommand, posture: PostureCommand) -> LowCommand:
        """One control tick. `velocity.vy` is not followed: the wheels cannot roll sideways. Without `velocity.climb`
        no wheel is lifted onto an obstacle; a climb under way goes on."""
        self._climb[0] = self.params.climb if velocity.climb else 0.0
        command = self._command
        command[0] = velocity.vx
        command[1] = velocity.wz
        command[2] = self.params.height if posture.height is None else posture.height
        command[3] = posture.roll
        command[4] = posture.pitch
        vmc_tick(
            state.q,
            state.dq,
            state.tau,
            state.quaternion,
            state.gyro,
            command,
            self.period,
            self._record,
            self._memory,
            self._out,
        )
        return self._low

    def contacts(self) -> tuple[bool, bool, bool, bool]:
        """Which wheels carry load, from leg torques: FR, FL, RR, RL."""
        c = self._memory["contact"][0]
        return bool(c[0]), bool(c[1]), bool(c[2]), bool(c[3])

    def blocked(self) -> float:
        """Time that the ground has held a wheel, as a share of the time after which the wheel is lifted; 1 while it
        is."""
        if self._mode[0] != DRIVE:
            return 1.0
        return max(self._blocked.tolist()) / self.params.blocked_time

    def warning(self) -> str:
        """An edge felt while creeping, in words; empty most of the time."""
        way = float(self._memory["cliff"][0])
        if way == 0.0:
            return ""
        side, back = ("ahead", "back") if way > 0.0 else ("behind", "forward")
        return (
            f"{FELT_EDGE} {side}, deeper than the wheels can feel; drive {back}, "
            "or come down faster than 0.1 m/s where it is known to be safe"
        )

    def ground_speed(self) -> float:
        """Forward speed [m/s] estimated from the wheels' rolling; wrong while all wheels slip."""
        return float(self._memory["speed"][0])


def warm_up() -> None:
    """Compile or load the kernels, so that the first control tick is in time."""
    state = LowState(
        0.0, np.zeros(16), np.zeros(16), np.zeros(16), np.array([1.0, 0, 0, 0]), np.zeros(3), np.zeros(3)
    )
    state.q[1:12:3] = 0.8
    state.q[2:12:3] = -1.5
    wheel_centres(state.q)  # the hybrid controller asks for them by itself
    VmcController().step(state, VelocityCommand(0), PostureCommand(0))
