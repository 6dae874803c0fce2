"""Keeps Move going while it is wanted, and ends it properly."""

from __future__ import annotations

import math

from hal.safety.monitors import ROLLS_ON
from hal.types import NS, Capabilities, PostureCommand, VelocityCommand
from hal.unitree import api
from hal.unitree.config import UnitreeConfig
from hal.unitree.motion import Halt
from hal.unitree.rpc import Rpc
from hal.unitree.telemetry import Telemetry

_ZERO_TIME = 0.3
"""[s] of zero Moves after a stop: a single packet may be lost."""
_TOLD_AFTER = 0.7
"""[s] of rolling on after a stop before the cause tells it."""
_EULER_PERIOD = 0.2
"""[s]; an attitude offset must be repeated to hold."""
_EULER_STEP = 0.05
"""[s] between two different ones."""


class Mover:
    """Repeats the wanted velocity as Move; at zero, or when the host falls silent: StopMove, zero Moves, silence.

    A robot that rolls on is told again, and made soft where that is safer: `halt`.
    """

    def __init__(self, rpc: Rpc, options: UnitreeConfig, capabilities: Capabilities) -> None:
        self._rpc, self._options, self._capabilities = rpc, options, capabilities
        self._period = round(NS / options.move_rate)
        self._velocity = (0.0, 0.0)
        self._fed_at = 0
        self._sent_at: int | None = None
        self._rest_since: int | None = None
        self._ignored_since: int | None = None
        self._posture = self._told = (0.0, 0.0)
        """Roll and pitch [rad] to hold at rest: wanted, and sent last."""
        self._told_at = 0
        self.halt = Halt()
        """After a stop, until the robot rests."""
        self._halted_at = 0
        self.note = ""
        """Why the robot is not given the wanted velocity; empty when it is."""

    @property
    def wanted(self) -> bool:
        """Whether a velocity other than zero is wanted."""
        return self._velocity != (0.0, 0.0)

    @property
    def moving(self) -> bool:
        """Whether a velocity other than zero is, or within the last moments was, on its way to the robot."""
        return self.wanted or self._rest_since is not None

    def fed(self, now: int) -> None:
        """The host lives."""
        self._fed_at = now

    def set(self, command: VelocityCommand, now: int) -> None:
        """The wanted velocity; not finite counts as zero, beyond the capabilities is clipped. Motion ends `halt`."""
        self._fed_at = now
        limit_v, limit_w = self._capabilities.max_vx, self._capabilities.max_wz
        if not (math.isfinite(command.vx) and math.isfinite(command.wz)):
            self.note = "velocity is not finite"
            self.rest(now)
            return
        self.note = ""
        velocity = (max(-limit_v, min(limit_v, command.vx)), max(-limit_w, min(limit_w, command.wz)))
        if velocity == (0.0, 0.0):
            self.rest(now)
        else:
            self._velocity, self._rest_since = velocity, None
            self.halt.end()

    def rest(self, now: int) -> None:
        """Want zero: StopMove once, then zero Moves for a moment."""
        if self._velocity != (0.0, 0.0):
            self._velocity = (0.0, 0.0)
            self.stop(now)

    def stop(self, now: int) -> None:
        """StopMove at once, whatever was wanted, and again while the robot moves."""
        self._velocity, self._rest_since = (0.0, 0.0), now
        self._halted_at = now
        self.halt.begin(api.Sport.STOP_MOVE, now / NS)
        self.halt.answered()
        self._rpc.send(api.SPORT, api.Sport.STOP_MOVE, now)
        self._move(now)

    def posture(self, command: PostureCommand) -> None:
        """Attitude offset to hold at rest."""
        if math.isfinite(command.roll) and math.isfinite(command.pitch):
            self._posture = (max(-0.75, min(0.75, command.roll)), max(-0.75, min(0.75, command.pitch)))

    def pump(self, now: int, allowed: bool) -> None:
        """Send what is due. Not `allowed`: the wanted velocity is dropped."""
        if not allowed:
            self.rest(now)
        if self._velocity != (0.0, 0.0) and (now - self._fed_at) / NS > self._options.watchdog:
            self.note = "no velocity from the host"
            self.rest(now)
        if self._rest_since is not None and (now - self._rest_since) / NS > _ZERO_TIME:
            self._rest_since = None
        # A tick early rather than a tick late: host loops are not exact.
        if self.moving and (self._sent_at is None or now - self._sent_at >= 0.9 * self._period):
            self._move(now)
        if allowed and not self.moving:
            self._tilt(now)

    def insist(self, now: int, telemetry: Telemetry) -> str:
        """See that a robot that was stopped rests. Why it was made soft just now, in words; empty where it was not."""
        soft = self.halt.damped
        number = self.halt.due(now / NS, telemetry.motion)
        if number is not None:
            self._rpc.send(api.SPORT, number, now)
        return "" if soft else self.halt.damped

    def rolls_on(self, now: int, telemetry: Telemetry) -> str:
        """That the robot does not follow a stop, in words; empty where it does."""
        lasted = (now - self._halted_at) / NS
        speed = telemetry.motion.speed(now / NS)
        if self.halt.order is None or lasted < _TOLD_AFTER or speed is None or not ROLLS_ON.outside(speed):
            return ""
        return ROLLS_ON.tell(speed=f"{speed:.2f} m/s", after=f"{lasted:.1f} s")

    def _tilt(self, now: int) -> None:
        """Repeat the attitude offset; level is sent once."""
        same = self._posture == self._told
        period = _EULER_PERIOD if same else _EULER_STEP
        if (same and self._told == (0.0, 0.0)) or (now - self._told_at) / NS < period:
            return
        self._told, self._told_at = self._posture, now
        roll, pitch = self._told
        self._rpc.send(api.SPORT, api.Sport.EULER, now, x=roll, y=pitch, z=0.0)

    def _move(self, now: int) -> None:
        self._sent_at = now
        vx, wz = (round(v, 4) for v in self._velocity)
        if self._options.avoid_obstacles:
            self._rpc.send(api.OBSTACLES_AVOID, api.ObstaclesAvoid.MOVE, now, x=vx, y=0.0, yaw=wz, mode=0)
        else:
            self._rpc.send(api.SPORT, api.Sport.MOVE, now, x=vx, y=0.0, z=wz)

    def ignored(self, now: int, telemetry: Telemetry) -> float:
        """Seconds for which Move has been sent and nothing measured moved."""
        vx, wz = self._velocity
        if abs(vx) < 0.1 and abs(wz) < 0.15:
            if not self.moving:
                self._ignored_since = None
            return 0.0
        if (telemetry.speed > 0.2 * abs(vx) and abs(vx) >= 0.1) or telemetry.yaw_rate > 0.2 * abs(wz) > 0.02:
            self._ignored_since = None
            return 0.0
        if self._ignored_since is None:
            self._ignored_since = now
        return (now - self._ignored_since) / NS

    def confirm_reset(self) -> None:
        """Forget how long Move was ignored: the robot was out of sight."""
        self._ignored_since = None
