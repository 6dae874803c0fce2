"""The robot's state machine: which motions the motors follow in which phase, how phases end, and why.

| phase | motors | left by |
|---|---|---|
| damped | soft dampers | STAND, RECOVER |
| sitting | brake, fold the legs, then hold | STAND, RECOVER, DAMP; timeout, fall -> fault |
| standing | fold, stretch, take the stance | done -> ready; timeout, fall -> fault |
| ready, moving | locomotion controller | SIT, DAMP, STOP; fall -> fault |
| stopped | locomotion controller at zero velocity | RESUME, SIT, DAMP |
| fault | soft dampers | RECOVER, DAMP |
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from hal.contract import fulfilled, refusal
from hal.limbs import WHEEL_JOINTS
from hal.lowlevel import Locomotion, LowCommand, LowState
from hal.postures.legs import UPRIGHT_COSINE, Legs, Righting
from hal.postures.motion import Keyframe, Motion, damped, level_stance
from hal.rotation import up_of
from hal.types import Array, ModeRequest, Phase, PostureCommand, VelocityCommand

STAND_TIMEOUT = 6.0
"""[s] from the start of getting up to a checked stance."""
RECOVER_TIMEOUT = 24.0
"""[s] from the request to the last try of turning over."""
SIT_TIMEOUT = 6.0
"""[s] from the request to seated."""
FOLDED_WITHIN = 0.35
"""[rad] of every leg joint from the folded pose counts as lying; 0.08 on level ground and on slopes."""
STANCE_TIME = 0.5
"""[s] the controller holds the stance before the robot counts as ready."""
FALLEN_UP = 0.5
"""Cosine of the tilt from which a robot counts as fallen (60 deg)..."""
FALLEN_TIME = 0.15
"""... when it lasts this long [s]."""
STEADY_SPEED = 0.35
"""Wheel speed [rad/s] below which the robot counts as standing still."""
BRAKE_DAMPING = 8.0
"""[Nms/rad] of the wheels of a robot without legs that sits."""
MOVING_TIME = 0.5
"""Phase `moving` ends this long [s] after the last command that was not zero."""


class Modes:
    """The state machine of a robot's postures. Call `step` once per control tick."""

    def __init__(self, controller: Locomotion, legs: Legs | None) -> None:
        """legs: None of a robot whose wheels sit on its body: it sits and stands alike."""
        self._controller, self._legs = controller, legs
        self.phase = Phase.DISCONNECTED
        self.cause = "not connected"
        self._velocity = VelocityCommand(0)
        self._posture = PostureCommand(0)
        self._latched = False
        self._act: Callable[[LowState], LowCommand] = self._damp
        self._motion: Motion | None = None
        self._righting: Righting | None = None
        self._deadline = np.inf
        self._tilted_since: float | None = None
        self._moved = -np.inf
        self._doing = ""
        self._damped, self._braked = damped(), damped(kd=BRAKE_DAMPING)
        self._pending: ModeRequest | None = None
        self._recover_until = -np.inf

    # --- asked from outside ----------------------------------------------------------------------------------------
    def drive(self, velocity: VelocityCommand) -> None:
        """Velocity until the next call."""
        self._velocity = velocity

    def posture(self, posture: PostureCommand) -> None:
        """Posture until the next call."""
        self._posture = posture

    def request(self, mode: ModeRequest) -> None:
        """Takes effect with the next `step`; the last request before it counts, but a STOP is never overtaken."""
        if mode is ModeRequest.STOP:
            self._latched = True
        elif mode is ModeRequest.RESUME:
            self._latched = False
        else:
            self._pending = mode

    def begin(self, state: LowState, seated: bool) -> None:
        """The robot was just connected: on its wheels, or lying."""
        self._latched = False
        self._pending = None
        self._velocity, self._posture = VelocityCommand(0), PostureCommand(0)
        self._tilted_since = None
        if seated:
            self._enter(Phase.SITTING, "connected, seated", self._hold_seat)
            if self._legs is not None:
                self._motion = Motion(state, [Keyframe(0.5, self._legs.seat)], kp=40.0)
        else:
            self._take_stance(state, "connected, taking its stance", state.time + STAND_TIMEOUT)

    def disconnect(self) -> None:
        """Nobody drives the robot any more."""
        self._enter(Phase.DISCONNECTED, "disconnected", self._damp)

    def fault(self, reason: str) -> None:
        """Damp the motors; only RECOVER or DAMP lead out."""
        self._enter(Phase.FAULT, reason, self._damp)

    @property
    def seated(self) -> bool:
        """Whether it lies on its folded legs, and holds them so."""
        return self._act == self._hold_seat

    # --- ticking ---------------------------------------------------------------------------------------------------
    def step(self, state: LowState) -> LowCommand:
        """One control tick."""
        if self._pending is not None:
            mode, self._pending = self._pending, None
            self._handle(mode, state)
        self._watch_fall(state)
        return self._act(state)

    def _enter(self, phase: Phase, cause: str, act: Callable[[LowState], LowCommand]) -> None:
        self.phase, self.cause, self._act = phase, cause, act
        self._motion = None
        self._righting = None
        self._deadline = np.inf

    def _handle(self, mode: ModeRequest, state: LowState) -> None:
        why = refusal(
            mode, self.phase, stopped=self._latched, upright=up_of(state.quaternion)[2] > UPRIGHT_COSINE
        )
        if why:
            self.cause = f"{self.cause.split('; ')[0]}; {why}"
        elif fulfilled(mode, self.phase):
            return
        elif mode is ModeRequest.DAMP:
            self._enter(Phase.DAMPED, "damp requested", self._damp)
        elif mode is ModeRequest.SIT:
            self._enter(Phase.SITTING, "sit requested: stopping", self._stop_to_sit)
            self._deadline = state.time + SIT_TIMEOUT
        else:
            self._recover_until = state.time + RECOVER_TIMEOUT if mode is ModeRequest.RECOVER else -np.inf
            if up_of(state.quaternion)[2] > UPRIGHT_COSINE:
                self._get_up(state, f"{mode.value} requested: getting up")
            else:
                self._turn_over(state, "recover requested: turning onto its belly")

    def _turn_over(self, state: LowState, cause: str) -> None:
        if self._legs is None or self._legs.righting is None:
            self.fault("fallen: it cannot turn itself over; put it on its wheels, then request recover")
            return
        self._enter(Phase.STANDING, cause, self._right)
        self._righting = self._legs.righting(state, self._recover_until)

    def _watch_fall(self, state: LowState) -> None:
        if (
            self._righting is not None
            or self.phase in (Phase.FAULT, Phase.DAMPED, Phase.DISCONNECTED)
            or up_of(state.quaternion)[2] > FALLEN_UP
        ):
            self._tilted_since = None
        elif self._tilted_since is None:
            self._tilted_since = state.time
        elif state.time - self._tilted_since >= FALLEN_TIME:
            tilt = np.degrees(np.arccos(np.clip(up_of(state.quaternion)[2], -1.0, 1.0)))
            if self.phase is Phase.STANDING and state.time < self._recover_until:
                self._turn_over(state, f"fell again (tilt {tilt:.0f} deg): turning onto its belly")
                return
            self.fault(f"fallen: tilt {tilt:.0f} deg; clear the place and request recover")

    # --- what the motors do ----------------------------------------------------------------------------------------
    def _damp(self, state: LowState) -> LowCommand:
        return self._damped

    def _hold_seat(self, state: LowState) -> LowCommand:
        return self._braked if self._motion is None else self._motion.step(state.time)

    def _stop_to_sit(self, state: LowState) -> LowCommand:
        """Brake first: a robot that folds its legs at speed tips over."""
        steady = np.abs(state.dq[WHEEL_JOINTS]).max() < STEADY_SPEED
        if (steady or state.time > self._deadline - SIT_TIMEOUT / 2) and self._legs is None:
            self._enter(Phase.SITTING, "seated", self._hold_seat)
            return self._braked
        if steady or state.time > self._deadline - SIT_TIMEOUT / 2:
            self._enter(Phase.SITTING, "sit requested: folding its legs", self._fold)
            self._motion = Motion(state, [Keyframe(2.0, self._folded(state.q))], kp=120.0)
            self._deadline = state.time + SIT_TIMEOUT / 2
            return self._motion.step(state.time)
        return self._controller.step(state, VelocityCommand(self._velocity.stamp), self._posture)

    def _fold(self, state: LowState) -> LowCommand:
        assert self._motion is not None
        assert self._legs is not None
        if np.abs(state.q[:12] - self._legs.seat[:12]).max() < FOLDED_WITHIN and self._motion.done(
            state.time
        ):
            self.cause = "seated"
            self._act = self._hold_seat
        elif state.time > self._deadline:
            self.fault(f"did not lie down within {SIT_TIMEOUT:.0f} s: free its legs, then request recover")
            return self._damped
        return self._motion.step(state.time)

    def _folded(self, turned: Array) -> Array:
        """The seat with the wheels where they have `turned` to (16,)."""
        assert self._legs is not None
        q = self._legs.seat.copy()
        q[WHEEL_JOINTS] = turned[WHEEL_JOINTS]
        return q

    def _get_up(self, state: LowState, cause: str, deadline: float | None = None) -> None:
        deadline = state.time + STAND_TIMEOUT if deadline is None else deadline
        if self._legs is None:
            self._take_stance(state, cause, deadline)
            return
        self._enter(Phase.STANDING, cause, self._stretch)
        frames = [Keyframe(1.0, self._legs.seat), Keyframe(0.2, self._legs.seat)]
        self._motion = Motion(state, frames, kp=120.0)
        self._stretching = False
        self._deadline = deadline

    def _stretch(self, state: LowState) -> LowCommand:
        assert self._motion is not None
        assert self._legs is not None
        if self._motion.done(state.time):
            if self._stretching:
                self._take_stance(state, self.cause, self._deadline)
                return self._act(state)
            # Folded and on the ground: its slope is known now.
            self._stretching = True
            self._motion = Motion(state, [Keyframe(1.5, level_stance(self._legs, state))], kp=150.0)
        return self._motion.step(state.time)

    def _take_stance(self, state: LowState, cause: str, deadline: float) -> None:
        self._enter(Phase.STANDING, cause, self._stance)
        self._deadline = deadline
        self._stance_since = state.time
        self._controller.reset()

    def _stance(self, state: LowState) -> LowCommand:
        steady = (
            np.abs(state.dq[WHEEL_JOINTS]).max() < 2 * STEADY_SPEED
            and up_of(state.quaternion)[2] > 0.8
            and (self._legs is None or self._legs.stretched(state.q))
        )
        if not steady:
            self._stance_since = state.time
        if state.time - self._stance_since >= STANCE_TIME:
            self._enter(Phase.READY, "standing", self._walk)
            self._recover_until = -np.inf
            self._moved = -np.inf
        elif state.time > self._deadline:
            self.fault(f"does not stand still on its wheels after {STAND_TIMEOUT:.0f} s; request recover")
            return self._damped
        posture = replace(self._posture, height=None)  # up first, then as low as wanted
        return self._controller.step(state, VelocityCommand(self._velocity.stamp), posture)

    def _walk(self, state: LowState) -> LowCommand:
        v = self._velocity
        if self._latched:
            if self.phase is not Phase.STOPPED:
                self.phase, self.cause = Phase.STOPPED, "stop requested; request resume"
            v = VelocityCommand(v.stamp)
        else:
            if v.vx != 0.0 or v.vy != 0.0 or v.wz != 0.0:
                self._moved = state.time
            moving = state.time - self._moved < MOVING_TIME
            phase = Phase.MOVING if moving else Phase.READY
            doing = self._controller.warning() or ("driving" if moving else "standing")
            if phase is not self.phase or doing != self._doing:
                self.phase, self.cause, self._doing = phase, doing, doing
        return self._controller.step(state, v, self._posture)

    def _right(self, state: LowState) -> LowCommand:
        assert self._righting is not None
        command = self._righting.step(state)
        if self._righting.upright:
            self._get_up(state, "on its belly again: getting up")
        elif self._righting.failed:
            self.fault("fallen: it could not turn itself over; put it on its wheels, then request recover")
        return command
