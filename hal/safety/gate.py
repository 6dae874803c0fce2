"""The safety gate: the last thing in front of every robot.

Whatever happens elsewhere, a robot behind the gate moves only on a fresh, valid command, within its limits, upright,
inside its fence and with its sensors alive. Two ways to stop:

- a *hold* gives zero velocity while its condition lasts (no fresh command, stale sensor, robot not ready, fence);
- a *latch* gives zero velocity until `resume` (operator's stop, operator's own remote, tilt, battery, motor
  temperature, robot fault, moving without a command, not moving for long in spite of one).

The gate is pure: time comes in as `now` [ns of the source clock], nothing blocks, nothing is random."""

from __future__ import annotations

import math
from collections import Counter

from hal.contract import UP
from hal.safety.gate_types import (
    GateConfig,
    GateInputs,
    GateStatus,
    MotionLimits,
    Refusal,
    RefusalReason,
    StopCause,
)
from hal.safety.geofence import NO_FENCE, Fence
from hal.safety.trunk import TrunkTilt
from hal.safety.untold import Untold
from hal.types import FELT_EDGE, NS, Capabilities, Phase, PostureCommand, VelocityCommand

__all__ = [
    "GateConfig",
    "GateInputs",
    "GateStatus",
    "Refusal",
    "RefusalReason",
    "SafetyGate",
    "StopCause",
]


class SafetyGate:
    """Lets a velocity through or holds it at zero. Call `command` for every incoming command, and `output` at the
    rate the robot is driven (>= 50 Hz)."""

    def __init__(
        self,
        capabilities: Capabilities,
        params: GateConfig | None = None,
        geofence: Fence = NO_FENCE,
        *,
        guarded: bool = True,
    ) -> None:
        """`guarded`: nothing moves without fresh `GateInputs.limits`."""
        self._guarded = guarded
        self.capabilities = capabilities
        self.params = params or GateConfig()
        self._timeouts = tuple(self.params.sensor_timeout)
        self.geofence = geofence
        self._limits = (
            capabilities.max_vx,
            capabilities.max_vy if capabilities.strafe else 0.0,
            capabilities.max_wz,
        )
        self._accepted: VelocityCommand | None = None
        self._fresh_from = 0
        self._count = 0
        self._refused: Counter[RefusalReason] = Counter()
        self._refusal: tuple[Refusal, int] | None = None
        self._cause: StopCause | None = None
        self._detail = ""
        self._hold = "no command yet"
        self._output = VelocityCommand(0)
        self._now: int | None = None
        self._since: dict[str, int] = {}
        self._zero_since: int | None = None
        self._untold = Untold(self.params)
        self._unchecked = True
        self._trunk = TrunkTilt(capabilities, self.params)

    # -- what comes in ---------------------------------------------------------------------------------------------

    def command(self, command: VelocityCommand, now: int) -> Refusal | None:
        """Take a command at `now` [ns], or say why not."""
        refusal = self._check(command, now)
        if refusal is not None:
            self.refuse(refusal, now)
            return refusal
        self._accepted = command
        # A stamp slightly ahead of the clock must not prolong the command's life.
        self._fresh_from = min(command.stamp, now)
        self._count += 1
        return None

    def refuse(self, refusal: Refusal, now: int) -> None:
        """Count a command that does not count, and say why nothing moves."""
        self._refused[refusal.reason] += 1
        self._refusal = refusal, now

    def posture(self, command: PostureCommand, now: int) -> Refusal | None:
        """Take a tilt of the trunk at `now` [ns], or return why not. Like a velocity it must be repeated; the height
        is not passed on."""
        refusal = self._trunk.command(command, now, "" if self._cause is None else self._cause.value)
        if refusal is not None:
            self._refused[refusal.reason] += 1
        return refusal

    @property
    def trunk(self) -> PostureCommand:
        """Tilt of the trunk for the robot, beside the velocity of `output`."""
        return self._trunk.output

    def _check(self, command: VelocityCommand, now: int) -> Refusal | None:
        p = self.params
        values = (command.vx, command.vy, command.wz)
        if not all(math.isfinite(v) for v in values):
            return Refusal(RefusalReason.NOT_FINITE, f"vx, vy, wz = {values}")
        if command.frame != "base_link":
            return Refusal(RefusalReason.WRONG_FRAME, f"expected base_link, got {command.frame!r}")
        for name, value, limit in zip(("vx", "vy", "wz"), values, self._limits, strict=True):
            if abs(value) > limit + 1e-6:  # rounding of a float32 on the way; clipped in `_slewed`
                return Refusal(RefusalReason.OVER_LIMIT, f"{name} {value:.3f}, limit {limit:.3f}")
        age = (now - command.stamp) / NS
        if age < -p.future:
            return Refusal(RefusalReason.FROM_FUTURE, f"stamp is {-age:.3f} s ahead of the clock")
        if age >= p.deadman:
            return Refusal(RefusalReason.TOO_OLD, f"{age:.3f} s old, limit {p.deadman} s")
        if self._cause is not None:
            return Refusal(RefusalReason.LATCHED, self._cause.value)
        if self._accepted is not None and command.stamp < self._accepted.stamp:
            return Refusal(RefusalReason.OUT_OF_ORDER, "stamp is before that of the last command")
        return None

    def stop(self, cause: StopCause = StopCause.OPERATOR, detail: str = "") -> None:
        """Latch: zero velocity from the next output until `resume`. The first cause stays."""
        if self._cause is None:
            self._cause, self._detail = cause, detail
        self._accepted = None

    def forget(self) -> None:
        """Drop the accepted command: zero velocity until the next fresh one."""
        self._accepted = None

    def resume(self) -> None:
        """Release the latch. The robot moves on the next fresh command; a condition that persists latches again."""
        self._cause, self._detail = None, ""
        self._accepted = None
        self._since.clear()
        self._zero_since = None
        self._untold.forget()

    # -- what goes out ---------------------------------------------------------------------------------------------

    def output(self, now: int, inputs: GateInputs) -> VelocityCommand:
        """Velocity for the robot at `now` [ns]: limited, slewed, and zero where anything is wrong."""
        elapsed = 0.0 if self._now is None else (now - self._now) / NS
        if elapsed < 0.0:  # the clock went back: nothing accepted before can be dated any more
            self._accepted = None
            self._since.clear()
            self._zero_since = None
            self._untold.forget()
        self._now = now
        elapsed = min(max(elapsed, 0.0), 0.1)
        self._watch_robot(now, inputs)
        self._hold = "" if self._cause else self._holds(now, inputs)
        if self._cause or self._hold:
            self._output = VelocityCommand(now)
        else:
            self._output = self._slewed(now, elapsed)
            if self._guarded and inputs.limits is not None:
                self._keep_clear(inputs.limits)
            if self.geofence and inputs.pose is not None:
                self._keep_inside(inputs.pose)
        self._watch_motion(now, inputs)
        self._watch_rest(now, inputs)
        if self._cause is not None:
            self._hold, self._output = "", VelocityCommand(now)
        free = self._cause is None and not self._hold and not self._wants_motion
        self._trunk.step(now, elapsed, inputs, self._zero_since if free else None)
        return self._output

    @property
    def _wants_motion(self) -> bool:
        told = self._accepted
        return told is not None and not told.vx == told.vy == told.wz == 0.0

    @property
    def latched(self) -> bool:
        """Stopped until `resume`."""
        return self._cause is not None

    def status(self) -> GateStatus:
        """Snapshot after the last call."""
        age = None
        if self._accepted is not None and self._now is not None:
            age = (self._now - self._fresh_from) / NS
        warn = self._now is not None and self._lasted("not moving", self._now) >= self.params.not_moving_warn
        cause = "" if self._cause is None else self._cause.value
        return GateStatus(
            latched=self.latched,
            cause=f"{cause}: {self._detail}" if self._detail else cause,
            hold=self._hold,
            not_moving=warn,
            motion_unchecked=self._unchecked,
            creeps=self._untold.creeps,
            accepted=self._count,
            refused={r.value: self._refused[r] for r in RefusalReason if r in self._refused}
            if self._refused
            else {},
            command_age=age,
        )

    # -- conditions ------------------------------------------------------------------------------------------------

    def _watch_robot(self, now: int, inputs: GateInputs) -> None:
        """Latch on what an operator has to look at."""
        p, state = self.params, inputs.state
        if inputs.tilt is not None and not inputs.tilt <= p.max_tilt:
            self.stop(
                StopCause.TILT,
                f"{math.degrees(inputs.tilt):.0f} deg, limit {math.degrees(p.max_tilt):.0f} deg",
            )
        if state is None:
            return
        if state.remote:
            self.stop(StopCause.REMOTE)
        if state.phase is Phase.FAULT:
            self.stop(StopCause.ROBOT_FAULT, state.cause)
        if not state.battery >= p.min_battery:
            self.stop(StopCause.BATTERY, f"{100 * state.battery:.0f} %, limit {100 * p.min_battery:.0f} %")
        if not state.motor_temperature <= p.max_motor_temperature:
            self.stop(
                StopCause.MOTOR_TEMPERATURE,
                f"{state.motor_temperature:.0f} deg C, limit {p.max_motor_temperature:.0f} deg C",
            )

    def _holds(self, now: int, inputs: GateInputs) -> str:
        """Why the robot must stand still right now; empty when it may move."""
        if inputs.state is None:
            return "no robot state yet"
        for sensor, limit in self._timeouts:
            stamp = inputs.state.stamp if sensor == "state" else inputs.stamps.get(sensor)
            if stamp is None:
                return f"no {sensor} yet"
            age = (now - stamp) / NS
            if age > limit:
                return f"{sensor} is {age:.1f} s old"
            if age < -limit:
                return f"{sensor} is stamped {-age:.1f} s ahead of the clock"
        if inputs.state.phase not in (Phase.READY, Phase.MOVING):
            return f"robot is {inputs.state.phase.value}: {inputs.state.cause}".removesuffix(": ")
        if inputs.tilt is None:
            return "no attitude yet"
        if self.geofence and inputs.pose is None:
            return "no pose for the geofence"
        if self._guarded:
            if inputs.limits is None:
                return "no guard yet"
            age = (now - inputs.limits.stamp) / NS
            if abs(age) > self.params.guard_timeout:
                return f"guard is {age:.1f} s old"
        if self._accepted is not None and (now - self._fresh_from) / NS < self.params.deadman:
            return "" if self._trunk.level or not self._wants_motion else "the trunk is not level yet"
        if self._refusal is not None and 0 <= (now - self._refusal[1]) / NS < self.params.deadman:
            refusal = self._refusal[0]
            return f"command refused, {refusal.reason.value}: {refusal.detail}"
        return "no command" if self._accepted is None else "no fresh command"

    def _slewed(self, now: int, dt: float) -> VelocityCommand:
        c, p, last = self.capabilities, self.params, self._output
        target = self._accepted
        assert target is not None
        left = p.deadman - (now - self._fresh_from) / NS
        share = min(1.0, left / p.deadman_ramp) if p.deadman_ramp > 0.0 else 1.0

        def slew(before: float, wanted: float, rate: float, limit: float) -> float:
            wanted = max(-limit, min(limit, share * wanted))
            # Braking is free: the gate never stretches a stop.
            if before * wanted >= 0.0 and abs(wanted) <= abs(before):
                return wanted
            start = before if before * wanted > 0.0 else 0.0
            return start + max(-rate * dt, min(rate * dt, wanted - start))

        return VelocityCommand(
            now,
            vx=slew(last.vx, target.vx, c.max_accel, self._limits[0]),
            vy=slew(last.vy, target.vy, c.max_accel, self._limits[1]),
            wz=slew(last.wz, target.wz, c.max_alpha, self._limits[2]),
        )

    def _keep_clear(self, limits: MotionLimits) -> None:
        """No faster than the guard allows. It does not look sideways; what is not a number allows nothing."""
        target, out = self._accepted, self._output
        assert target is not None

        def cut(value: float, most: float, least: float) -> float:
            limit = most if value > 0.0 else least
            return math.copysign(min(abs(value), limit), value) if limit > 0.0 else 0.0

        vx, wz = cut(out.vx, limits.forward, limits.backward), cut(out.wz, limits.left, limits.right)
        self._output = VelocityCommand(out.stamp, vx, 0.0, wz)
        wanted = target.vx != 0.0 or target.vy != 0.0 or target.wz != 0.0
        cleared = cut(target.vx, limits.forward, limits.backward), cut(target.wz, limits.left, limits.right)
        if wanted and cleared == (0.0, 0.0):
            self._hold = (
                f"guard: {limits.reason or 'nothing is known to be in the way, and nothing is allowed'}"
            )

    def _keep_inside(self, pose: tuple[float, float, float]) -> None:
        """Slow down before the fence and stop at it. A robot behind it may come back, and turn.

        The command decides, not the slewed output: a velocity that starts from zero would creep out in spurts.
        """
        target, out, p = self._accepted, self._output, self.params
        assert target is not None
        wanted, speed = math.hypot(target.vx, target.vy), math.hypot(out.vx, out.vy)
        course = math.atan2(target.vy, target.vx)
        size = self.capabilities.length, self.capabilities.width
        most, ahead = self.geofence.speed(pose, wanted, course, p.fence_margin, p.fence_horizon, size[1])
        turn, beside = self.geofence.turn(pose, target.wz, p.fence_horizon, size)
        share = most / speed if speed > most else 1.0
        wz = math.copysign(min(abs(out.wz), abs(turn)), out.wz)
        self._output = VelocityCommand(out.stamp, share * out.vx, share * out.vy, wz)
        held = ahead if wanted > 0.0 and most == 0.0 else beside if wanted == 0.0 and turn == 0.0 else None
        if held is not None:
            self._hold = f"geofence: {held.words}"

    def _watch_motion(self, now: int, inputs: GateInputs) -> None:
        """Whether the robot does what is commanded."""
        p, out = self.params, self._output
        standing = out.vx == 0.0 and out.vy == 0.0 and out.wz == 0.0
        if not standing:
            self._zero_since = None
        elif self._zero_since is None:
            self._zero_since = now
        self._unchecked = inputs.velocity is None or not all(map(math.isfinite, inputs.velocity))
        if inputs.velocity is None or self._unchecked:
            self._since.pop("not moving", None)
            return
        vx, vy, wz = inputs.velocity
        wanted = max(math.hypot(out.vx, out.vy), 0.5 * abs(out.wz))
        actual = max(math.hypot(vx, vy), 0.5 * abs(wz))
        self._mark("not moving", now, wanted > 0.1 and actual < 0.2 * wanted)
        if self._lasted("not moving", now) >= p.not_moving_stop:
            self.stop(StopCause.NOT_MOVING, f"{wanted:.1f} m/s commanded for {p.not_moving_stop:.0f} s")

    def _watch_rest(self, now: int, inputs: GateInputs) -> None:
        """Latch on motion that nothing explains: no command, no posture, no reflex of the robot."""
        state = inputs.state
        if (
            self._zero_since is None
            or not self._trunk.level
            or state is None
            or state.phase not in UP
            or state.cause.startswith(FELT_EDGE)
        ):
            self._untold.forget()
        elif found := self._untold.judge(now, inputs):
            self.stop(StopCause.MOVING, found)

    def _mark(self, what: str, now: int, condition: bool) -> None:
        if condition:
            self._since.setdefault(what, now)
        else:
            self._since.pop(what, None)

    def _lasted(self, what: str, now: int) -> float:
        return (now - self._since[what]) / NS if what in self._since else 0.0
