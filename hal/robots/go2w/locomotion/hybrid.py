"""The model-based controller drives. The learnt policy takes over where the ground holds a wheel or twists the robot,
and hands back on level ground.

The model-based controller stands, creeps, stops, turns on the spot and drives, to the centimetre, on ground without
climbs. It climbs by lifting one wheel at a time, up to 0.10 m; with one wheel 0.2 m below the others it tips over. A
learnt policy climbs higher while driving, but it sways at rest and turns badly. The torques of both are mixed over
`BLEND_TIME` at each change."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np

from hal.lowlevel import Ground, LowCommand, LowState
from hal.robots.go2w import facts as go2w
from hal.robots.go2w.locomotion.policy import PolicyController
from hal.robots.go2w.locomotion.vmc import VmcController
from hal.rotation import up_of
from hal.types import Array, PostureCommand, VelocityCommand

BLEND_TIME = 0.16
"""[s] over which one controller's torques turn into the other's."""
FAST_SPEED = 0.3
"""Slowest commanded speed [m/s], ahead or back, at which the learnt policy takes over."""
ONWARD_SPEED = 0.15
"""The same for going on: paths slow down amid a climb, and a change of controllers there is worse than a slow climb."""
BLOCKED_SHARE = 0.5
"""Share of the model-based controller's waiting time before it lifts a blocked wheel, after which the learnt one
takes over."""
STALLED_SHARE, STALL_TIME = 0.1, 0.6
"""A wheel slower than this share of a fast command for so long [s] calls the learnt controller too. A wheel before a
post was pushed too little to count as blocked, and the other three spun for 4 s."""
TWIST_HEIGHT, TWIST_TIME = 0.14, 0.1
"""One wheel so far [m] off the plane of the others for so long [s] calls the learnt controller. A lifted wheel is put
down sooner."""
ASTRIDE_HEIGHT = 0.12
"""While leg lengths differ by more than this [m] the learnt controller also turns and creeps: the model-based one
tips over there."""
CALM_TIME = 1.0
"""[s] of level ground after which the climb is over."""
CALM_SPREAD = 0.03
"""Largest difference of the wheels' heights [m] that counts as level ground."""
PUSH_GAIN, PUSH_MOST = 0.4, 0.9
"""Extra speed asked of the policy per distance that it falls behind [1/s], and largest total speed asked [m/s]."""
PUSH_FADE = 0.2
"""What is left of it at the next take-over is less by so much per time without the policy [m/s^2]."""
TURN_MOST = 0.8
"""Largest yaw rate [rad/s] asked of the policy amid a climb, as in its training: at 1.0 rad/s a policy tipped over on
a plate of 10 cm."""
HELD_SHARE, HELD_TIME = 0.5, 0.2
"""A wheel is held when it rolls slower than this share of the commanded speed; after so long [s] ..."""
SHAKE_SIGMA = 0.4
"""... the policy's outputs are shaken by this standard deviation, somewhat more than it was trained with."""
SLOW_SPEED = 0.05
"""Wheel speed [m/s] below which the model-based controller takes over for a turn on the spot, a slow drive, or a tilt
of the trunk..."""
OTHER_TIME = 0.6
"""... and time [s] after which it does so at any speed."""


class HybridController:
    """`hal.lowlevel.Locomotion` from the model-based controller and a learnt policy. Raises PolicyError."""

    def __init__(self, source: Path) -> None:
        """source: of the policy, as for `PolicyController`, whose control period is that of both."""
        self.climber = PolicyController(source)
        self.period, self.places = self.climber.period, self.climber.places
        self.wheels = VmcController(period=self.period)
        self._command = LowCommand(*(np.zeros(16) for _ in range(5)))
        self.reset()

    def reset(self) -> None:
        """Forget all state."""
        self.wheels.reset()
        self.climber.reset()
        self.climbing = False
        """The learnt policy drives."""
        self._share = 0.0
        """Of the learnt policy in the torques."""
        self._calm = self._other = self._twist = self._stalled = 0.0
        self._push = self._held = 0.0

    def step(self, state: LowState, velocity: VelocityCommand, posture: PostureCommand) -> LowCommand:
        """One motor period."""
        fast = abs(velocity.vx) >= FAST_SPEED
        # It lifts wheels only where the learnt policy cannot help.
        driven = replace(velocity, climb=velocity.climb and not fast)
        centres = go2w.wheel_centres(state.q)
        heights = centres @ np.array(up_of(state.quaternion))
        blocked, moves = self.wheels.blocked(), velocity.vx != 0.0 or velocity.wz != 0.0
        fr, fl, rr, rl = heights.tolist()
        twisted = abs(fr + rl - fl - rr) > TWIST_HEIGHT and blocked < 1.0
        self._twist = self._twist + self.period if twisted else 0.0
        way, speed = math.copysign(1.0, velocity.vx), abs(velocity.vx)
        roll = way * go2w.WHEEL_RADIUS
        stalls = fast and min(roll * v for v in state.dq[go2w.WHEEL_JOINTS].tolist()) < STALLED_SHARE * speed
        self._stalled = self._stalled + self.period if stalls else 0.0
        held = fast and velocity.climb and (blocked >= BLOCKED_SHARE or self._stalled >= STALL_TIME)
        if not self.climbing and (held or (moves and self._twist >= TWIST_TIME)):
            self.climbing = True
            self._calm = self._other = 0.0
            if self._share == 0.0:
                self.climber.reset()
                self._held = 0.0
        elif self.climbing and self._over(state, velocity, posture, centres, heights):
            self.climbing = False
            if self._share == 1.0:
                self.wheels.take_over(_rolling(state))
        step = self.period / BLEND_TIME
        self._share = min(max(self._share + (step if self.climbing else -step), 0.0), 1.0)
        if self._share == 0.0:
            self._push = max(self._push - PUSH_FADE * self.period, 0.0)
            return self.wheels.step(state, driven, posture)
        learnt = self.climber.step(state, self._helped(state, velocity), posture)
        if self._share == 1.0:
            return learnt
        return mixed(self.wheels.step(state, driven, posture), learnt, self._share, self._command)

    def see(self, ground: Ground) -> None:
        """The ground at `places`, for the learnt policy."""
        self.climber.see(ground)

    def warning(self) -> str:
        """What it does instead of plain driving, in words."""
        if self.climbing:
            return " ".join(filter(None, ("climbing with the learnt policy", self.climber.warning())))
        return self.wheels.warning()

    def _helped(self, state: LowState, velocity: VelocityCommand) -> VelocityCommand:
        """The command for the learnt policy, with help where it makes no progress.

        It is asked for more speed than commanded while the wheels turn slower than that. If one wheel is held for
        long, its outputs are shaken: a network without memory repeats the same motion for ever."""
        way, speed = float(np.sign(velocity.vx)), abs(velocity.vx)
        drives = speed >= ONWARD_SPEED
        rolling = way * go2w.WHEEL_RADIUS * state.dq[go2w.WHEEL_JOINTS]
        most = max(PUSH_MOST - speed, 0.0) if drives else 0.0
        behind = speed - float(rolling.mean())
        self._push = float(np.clip(self._push + PUSH_GAIN * behind * self.period, 0.0, most))
        held = drives and float(rolling.min()) < HELD_SHARE * speed
        self._held = float(
            np.clip(self._held + (self.period if held else -self.period), 0.0, 2.0 * HELD_TIME)
        )
        self.climber.shake = SHAKE_SIGMA if drives and self._held >= HELD_TIME else 0.0
        turn = min(max(velocity.wz, -TURN_MOST), TURN_MOST)
        return replace(velocity, vx=velocity.vx + way * self._push, wz=turn)

    def _over(
        self,
        state: LowState,
        velocity: VelocityCommand,
        posture: PostureCommand,
        centres: Array,
        heights: Array,
    ) -> bool:
        """Whether the model-based controller goes on; wheels (4, 3) in base_link and their heights (4,) [m]."""
        level = np.ptp(heights) < CALM_SPREAD
        astride = np.ptp(centres[:, 2]) > ASTRIDE_HEIGHT
        self._calm = self._calm + self.period if level else 0.0
        # A robot that stops amid a climb is braked and held by the policy: the model-based controller would move to
        # its own stance.
        stop = velocity.vx == 0.0 and velocity.vy == 0.0 and velocity.wz == 0.0
        tilted = posture.roll != 0.0 or posture.pitch != 0.0
        other = not astride and (tilted if stop else abs(velocity.vx) < ONWARD_SPEED)
        self._other = self._other + self.period if other else 0.0
        slow = other and abs(_rolling(state)) < SLOW_SPEED
        return self._calm >= CALM_TIME or slow or self._other >= OTHER_TIME


def mixed(one: LowCommand, other: LowCommand, share: float, out: LowCommand) -> LowCommand:
    """Write into `out` a command whose torques are those of `one` and `other`, `share` of the latter, for any motor
    state."""
    a, b = 1.0 - share, share
    for gain, target in (("kp", "q"), ("kd", "dq")):
        first, second = a * getattr(one, gain), b * getattr(other, gain)
        total = first + second
        getattr(out, gain)[:] = total
        weighted = first * getattr(one, target) + second * getattr(other, target)
        getattr(out, target)[:] = np.where(total > 0.0, weighted / np.where(total > 0.0, total, 1.0), 0.0)
    out.tau[:] = a * one.tau + b * other.tau
    return out


def _rolling(state: LowState) -> float:
    """Forward speed [m/s] by the wheels' mean turning rate."""
    return go2w.WHEEL_RADIUS * float(state.dq[go2w.WHEEL_JOINTS].mean())
