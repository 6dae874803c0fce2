"""The contract between the stack and a robot.

A backend is driven from one thread by its host (a live process or the lockstep runner):

    backend.connect()
    while running:
        samples = backend.read(now)        # simulators advance their physics to `now` here
        backend.drive(gate.output(...))    # the safety gate stands in front of every backend
    backend.close()

`drive` sets the velocity that holds until the next call; the gate, not the backend, implements the command
deadline, but a backend whose robot keeps moving after its host died must add its own (see `hal.unitree`).

What a request does depends on the phase, in every backend alike (`refusal`, `fulfilled`); a refusal adds its reason to
`RobotState.cause` and changes nothing else:

| request | followed in | while under way | ends in | in time |
|---|---|---|---|---|
| STAND | sitting, damped; not under a latched STOP, not on its side or back | standing | ready | or fault |
| RECOVER | sitting, damped, fault; not under a latched STOP | standing | ready | or fault |
| SIT | ready, moving, stopped | sitting | sitting | or fault |
| DAMP | every phase | damped | damped | or fault |
| STOP | every phase | | zero velocity at once; stopped, where it stands | |
| RESUME | every phase | | ready, where it stands | |

A fault is left by RECOVER or DAMP alone, and shows again where its reason is still there. A damped robot may lie as
it likes: falling over is no fault then. Lying, a latched STOP is not a phase of its own: the robot is sitting or
damped, and stays so."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from hal.errors import OperatorError
from hal.types import (
    LYING,
    Capabilities,
    ModeRequest,
    Phase,
    PostureCommand,
    RobotState,
    Sample,
    VelocityCommand,
)


class BackendError(OperatorError):
    """The robot cannot be reached or refuses. Unless raised with `retry=False` it may answer the next attempt."""

    retry = True


@runtime_checkable
class Backend(Protocol):
    """A robot. One instance belongs to one thread."""

    capabilities: Capabilities

    def connect(self) -> None:
        """Reach the robot and start its sensors. Raises BackendError. Bounded in time."""

    def read(self, now: int) -> list[Sample]:
        """All samples delivered by `now` [ns, source clock] since the last call, each kind in stamp order. Never
        blocks.

        No stamp is later than `now`. A simulator advances its physics to `now`; hardware drains its queues. Nothing
        before `connect` and after `close`."""

    def drive(self, command: VelocityCommand) -> None:
        """Velocity until the next call. Already limited and checked by the gate. Never blocks.

        A robot that is not ready or moving stays at rest, before `connect` and after `close` too.
        """

    def posture(self, command: PostureCommand) -> None:
        """Trunk height and attitude offsets until the next call. Raises BackendError unless connected."""

    def request(self, mode: ModeRequest) -> None:
        """Start a transition; see the table. Its progress shows in `state`. Never blocks.

        Raises BackendError unless connected.
        """

    def state(self) -> RobotState:
        """Newest summary state."""

    def diagnostics(self) -> dict[str, float]:
        """Figures for operators by name: measured values as float (offsets of clocks in s), counters as int. May be
        empty."""

    def close(self, *, lie_down: bool = True) -> None:
        """Leave the robot safe (stopped, then seated or damped) and release everything. Idempotent.

        `lie_down` False: stopped and on its feet, where it may stand on a stair. A program that failed leaves it so.
        """


UP = (Phase.READY, Phase.MOVING, Phase.STOPPED)
"""On its wheels."""


def fulfilled(mode: ModeRequest, phase: Phase) -> bool:
    """Whether there is nothing to do for this request, because it is done or under way."""
    if mode is ModeRequest.SIT:
        return phase is Phase.SITTING
    return mode in (ModeRequest.STAND, ModeRequest.RECOVER) and phase in (*UP, Phase.STANDING)


def refusal(mode: ModeRequest, phase: Phase, *, stopped: bool, upright: bool) -> str:
    """Why a request is not followed, for `RobotState.cause`; empty where it is. For the backends.

    `stopped`: a STOP is latched; `upright`: the robot lies neither on its side nor on its back.
    """
    why = ""
    if mode in (ModeRequest.STOP, ModeRequest.RESUME, ModeRequest.DAMP) or fulfilled(mode, phase):
        pass
    elif phase is Phase.DISCONNECTED or (mode is ModeRequest.SIT and phase not in UP):
        why = f"robot is {phase.value}"
    elif mode is ModeRequest.SIT:
        pass
    elif stopped:
        why = "stop is latched; request resume first"
    elif mode is ModeRequest.STAND and phase not in LYING:
        why = "request recover to leave a fault"
    elif mode is ModeRequest.STAND and not upright:
        why = "the robot lies on its side or back; request recover"
    return f"{mode.value} refused: {why}" if why else ""
