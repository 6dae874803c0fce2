"""The motor loop without clock and network: LowState and orders come in, LowCmd goes out.

| what happens | what the motors do |
|---|---|
| no order for `HOST_SILENT` | velocity zero, balance goes on |
| the host is gone | velocity zero, the robot lies down, then soft |
| no LowState for `STATE_SILENT` | soft |
| a motor too hot, too fast, outside its range, or that loses messages | soft |
| the controller fails, or asks for what is not a number | soft |
| L2 and B on the robot's own remote | soft |
| the robot's own motion service has the motors again | nothing is sent any more, the loop ends: two commanders shake
the robot |
| a stick of it moves | velocity zero |

Soft is a fault that RECOVER or DAMP alone leave, except the remote's, which STAND leaves, too.
"""

from __future__ import annotations

import json
import logging
import math
from dataclasses import asdict, dataclass, field
from typing import Any

from hal.contract import UP
from hal.lowlevel import Locomotion, LowCommand, LowState
from hal.postures.modes import Modes
from hal.postures.motion import damped
from hal.robots.go2w.righting import LEGS
from hal.safety.monitors import TWO_ROBOTS
from hal.types import NS, ModeRequest, Phase, PostureCommand, VelocityCommand
from hal.unitree.api import WireError
from hal.unitree.layout import LOW_STATE_CDR, low_state_checksum, view
from hal.unitree.low.limits import Limits
from hal.unitree.low.wire import Packer, low_state, wants_soft
from hal.unitree.motion import remote
from hal.unitree.turns import Turns

log = logging.getLogger(__name__)

COMMAND_PERIOD = 0.002
"""[s] between two LowCmd, as in every example of the vendor."""
HOST_SILENT = 0.2
"""[s] without an order: velocity zero, as the watchdog of the sport service's driver."""
STATE_SILENT = 0.09
"""[s] without a LowState: the robot balances by it. Motors are soft within 0.1 s."""
TOLD_SHARES = (0.5, 0.99, 0.999)
"""Of the times between two commands, as they are told."""
SOFT_TIME = 0.5
"""[s] of damping after which a robot that lies counts as at rest."""
SOFTENED = "made soft by L2 + B on the robot's own remote"
LEAVING_TIME = 8.0
"""[s] to lie down when the host is gone; then it is made soft where it is."""


@dataclass(slots=True)
class Order:
    """What the host wants, the whole of it, in every host tick."""

    vx: float = 0.0
    vy: float = 0.0
    wz: float = 0.0
    """[m/s, rad/s]"""
    roll: float = 0.0
    pitch: float = 0.0
    """[rad]"""
    height: float | None = None
    """[m]; None for the controller's own."""
    climb: bool = True
    """See `VelocityCommand.climb`."""
    taken: bool = False
    """Somebody else has the motors: send nothing more, and end."""
    requests: list[tuple[int, str]] = field(default_factory=list)
    """The newest requests with their numbers, which grow: each counts once, however often it is told."""

    def pack(self) -> bytes:
        """One line of JSON."""
        return json.dumps(asdict(self)).encode() + b"\n"

    @classmethod
    def unpack(cls, line: bytes) -> Order:
        """Raises WireError."""
        try:
            values = json.loads(line)
            order = cls(**values)
            order.requests = [(int(number), ModeRequest(mode).value) for number, mode in values["requests"]]
            numbers = (order.vx, order.vy, order.wz, order.roll, order.pitch, order.height or 0.0)
            if not all(math.isfinite(number) for number in numbers):
                raise ValueError("a number is not finite")
        except (ValueError, TypeError, KeyError) as error:
            raise WireError(f"order {line[:60]!r} cannot be read: {error}") from error
        return order


@dataclass(slots=True)
class Report:
    """What the loop tells its host."""

    phase: Phase
    cause: str
    late: int = 0
    """Commands that came more than a period late."""
    worst: float = 0.0
    """Longest time between two commands [s]..."""
    shares: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """... and that which `TOLD_SHARES` of them keep."""

    def pack(self) -> bytes:
        """One line of JSON."""
        return json.dumps(asdict(self)).encode() + b"\n"

    @classmethod
    def unpack(cls, line: bytes) -> Report:
        """Raises WireError."""
        try:
            values: dict[str, Any] = json.loads(line)
            a, b, c = map(float, values["shares"])
            late, worst = int(values["late"]), float(values["worst"])
            return cls(Phase(values["phase"]), str(values["cause"]), late, worst, (a, b, c))
        except (ValueError, TypeError, KeyError) as error:
            raise WireError(f"report {line[:60]!r} cannot be read: {error}") from error


class MotorLoop:
    """One controller on one robot. Call `tick` every `COMMAND_PERIOD`; all times are in s of one clock that goes on."""

    def __init__(
        self,
        controller: Locomotion,
        imu_yaw: float = 0.0,
        check_crc: bool = True,
        share: float = 1.0,
        max_vx: float = math.inf,
        law_age: float = 0.001,
    ) -> None:
        """share: of the torque limits; max_vx [m/s]: both are small while a controller is tried with the wheels off the
        ground. law_age [s]: see `UnitreeConfig`."""
        self._controller, self._imu_yaw, self._check_crc, self._max_vx = (
            controller,
            imu_yaw,
            check_crc,
            max_vx,
        )
        self._modes = Modes(controller, LEGS)
        self._limits = Limits(share, law_age)
        self._packer = Packer()
        self._damped = damped()
        self._order, self._ordered_at = Order(), -math.inf
        self._number = 0
        self._state: LowState | None = None
        self._heard_at = -math.inf
        self._tick: int | None = None
        self._turns = Turns()
        self._time = 0.0
        """[s] that LowState's counter has gone on since the first one."""
        self._controlled = -math.inf
        self._command = self._damped
        self._remote = False
        self._softened = False
        """L2 and B of the robot's own remote did it."""
        self._gone_at: float | None = None
        self._rested_at: float | None = None
        self._unread = 0
        self.finished = False
        """The loop ends: the host is gone and the robot lies soft, or somebody else has the motors."""

    # -- in --------------------------------------------------------------------------------------------------------

    def hear(self, data: bytes, now: float, speaker: int = 0) -> None:
        """A LowState message of a publisher. Raises WireError."""
        low = view(data, LOW_STATE_CDR)
        if self._check_crc and low["crc"] not in (0, low_state_checksum(data)):
            raise WireError("its checksum is wrong")
        if not self._turns.counts((speaker, low["sn"].tobytes()), round(now * NS)):
            if several := self._turns.words(round(now * NS)):
                self.soften(TWO_ROBOTS.tell(found=several))
            return
        tick = int(low["tick"])
        if tick == self._tick:
            return  # a frozen publisher tells nothing
        step = 0.0 if self._tick is None else (tick - self._tick) % 2**32 / 1000.0
        # A counter that jumps was set, and time for the controller goes on as it does here.
        self._time += step if step < STATE_SILENT else COMMAND_PERIOD
        self._tick, self._heard_at = tick, now
        first = self._state is None
        self._state = state = low_state(low, self._time, self._imu_yaw)
        self._remote = remote(low)
        if first:
            self._limits.begin(state.time)
            self._modes.begin(state, seated=True)
        if trouble := self._limits.trouble(state, low):
            self.soften(trouble)
        if wants_soft(low):
            self._softened = True
            if self._modes.phase is not Phase.DAMPED:
                self._modes.request(ModeRequest.DAMP)
        elif self._modes.phase is not Phase.DAMPED:
            self._softened = False

    def order(self, order: Order, now: float) -> None:
        """From the host."""
        self._order, self._ordered_at = order, now
        self.finished = self.finished or order.taken
        # Before the first LowState nothing can be followed; what was asked for is told again.
        for number, mode in order.requests if self._state is not None else ():
            if number > self._number:
                self._number = number
                self._modes.request(ModeRequest(mode))

    def unreadable(self, reason: str) -> None:
        """A LowState message could not be read."""
        self._unread += 1
        if self._unread in (1, 10, 100) or self._unread % 1000 == 0:
            log.warning("LowState: unreadable message %d: %s", self._unread, reason)

    def leave(self, now: float) -> None:
        """The host is gone: rest, lie down, go soft. Idempotent."""
        if self._gone_at is None:
            self._gone_at = now
            log.warning("the host is gone: the robot lies down and its joints go soft")

    # -- out -------------------------------------------------------------------------------------------------------

    def tick(self, now: float) -> bytes | None:
        """The next LowCmd; None before the first LowState, and when the loop is finished."""
        state = self._state
        if state is None or self.finished:
            self.finished = self.finished or self._gone_at is not None
            return None
        silent = now - self._heard_at
        if silent > STATE_SILENT:
            self.soften(f"no LowState for {silent:.2f} s: check the cable, then recover")
        if self._gone_at is not None:
            self._lie_down(now, now - self._gone_at)
        self._steer(now)
        if (
            state.time - self._controlled >= self._controller.period - COMMAND_PERIOD / 2
            or silent > STATE_SILENT
        ):
            self._controlled = state.time
            self._command = self._step(state)
        out = self._limits.apply(self._command, state)
        if out is None:
            self.soften("the controller asked for what is not a number: recover starts it anew")
            self._command = self._damped
            out = self._limits.apply(self._damped, state)
            assert out is not None
        return self._packer.pack(out)

    def report(self) -> Report:
        """Phase and cause now."""
        cause = SOFTENED if self._softened else self._modes.cause
        if self._remote:
            cause += "; somebody moves a stick of the robot's own remote"
        return Report(self._modes.phase, cause)

    def _steer(self, now: float) -> None:
        o = self._order
        held = self._remote or self._gone_at is not None or now - self._ordered_at > HOST_SILENT
        vx = 0.0 if held else max(-self._max_vx, min(self._max_vx, o.vx))
        turn = 0.0 if held else o.wz
        self._modes.drive(VelocityCommand(0, vx, 0.0 if held else o.vy, turn, climb=o.climb))
        self._modes.posture(PostureCommand(0, roll=o.roll, pitch=o.pitch, height=o.height))

    def _step(self, state: LowState) -> LowCommand:
        try:
            return self._modes.step(state)
        except Exception as error:  # whatever it is, the motors must not keep the last command
            log.exception("the controller failed")
            self.soften(f"the controller failed ({type(error).__name__}: {error}): recover starts it anew")
            return self._damped

    def soften(self, reason: str) -> None:
        """Let the motors go soft for this reason: a fault, unless they are soft because somebody wants it."""
        if self._modes.phase not in (Phase.FAULT, Phase.DAMPED):
            log.error("%s", reason)
        if self._modes.phase is not Phase.DAMPED:
            self._modes.fault(reason)
            self._command = self._damped

    def _lie_down(self, now: float, gone: float) -> None:
        """One step of `leave`, `gone` [s] after the host."""
        phase = self._modes.phase
        if phase in UP:
            self._modes.request(ModeRequest.SIT)
        elif phase in (Phase.FAULT, Phase.DAMPED):
            self._rested_at = now if self._rested_at is None else self._rested_at
            self.finished = now - self._rested_at > SOFT_TIME
        elif self._modes.seated or gone > LEAVING_TIME:
            self._modes.request(ModeRequest.DAMP)
