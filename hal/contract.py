"""The contract between the stack and a robot.

A backend is driven from one thread by its host (a live process or the lockstep runner):

    backend.connect()
    while running:
        samples = backend.read(now)        # simulators advance their physics to `now` here
        backend.drive(gate.output(...))    # the safety gate stands in front of every backend
    backend.close()

`drive` sets the velocity that holds until the next call; the gate, not the backend, implements the command
deadline, but a backend whose robot keeps moving after its host died must add its own (see `hal.unitree`).
"""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from hal.types import (
    Capabilities,
    ModeRequest,
    PostureCommand,
    RobotState,
    Sample,
    VelocityCommand,
)


class BackendError(RuntimeError):
    """The robot cannot be reached or refuses. The message tells the operator what to do next."""


@runtime_checkable
class Backend(Protocol):
    """A robot. One instance belongs to one thread."""

    capabilities: Capabilities

    def connect(self) -> None:
        """Reach the robot and start its sensors. Raises BackendError. Bounded in time."""

    def read(self, now: int) -> list[Sample]:
        """All samples with stamp <= `now` [ns, source clock] since the last call, in stamp order. Never blocks.

        A simulator advances its physics to `now`; hardware drains its queues.
        """

    def drive(self, command: VelocityCommand) -> None:
        """Velocity until the next call. Already limited and checked by the gate. Never blocks."""

    def posture(self, command: PostureCommand) -> None:
        """Trunk height and attitude offsets until the next call."""

    def request(self, mode: ModeRequest) -> None:
        """Start a transition (stand, sit, damp, recover). Its progress shows in `state`. Never blocks."""

    def state(self) -> RobotState:
        """Newest summary state."""

    def close(self) -> None:
        """Leave the robot safe (stopped, then seated or damped) and release everything. Idempotent."""
