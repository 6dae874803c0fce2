"""A Go2-W or Go2 through its sport service, as a backend of the contract.

One thread, nothing blocks after `connect`. `read` drains telemetry, advances whatever transition runs and keeps Move
going; `drive` only sets the velocity. Three things stop the robot when something above dies: the watchdog here (no
`drive` for 0.2 s), the guardian process (this process killed or stuck), and the robot's own 1 s hold.
"""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable

from hal.contract import BackendError, fulfilled, refusal
from hal.safety.monitors import ROLLS_ON, TWO_ROBOTS
from hal.types import (
    LYING,
    NS,
    ModeRequest,
    Phase,
    PostureCommand,
    RobotState,
    Sample,
    VelocityCommand,
)
from hal.unitree.config import UnitreeConfig
from hal.unitree.connect import listen_alone, open_link, wait_for_robot
from hal.unitree.guardian import Guardian
from hal.unitree.link import DRY_RUN, DryRunLink, Link
from hal.unitree.mover import Mover
from hal.unitree.news import News
from hal.unitree.rpc import Echo, Rpc
from hal.unitree.telemetry import MOUNT_TOLERANCE, Telemetry
from hal.unitree.transitions import Steps, Transitions, finish

log = logging.getLogger(__name__)

RECOVERING = "recovering"


class UnitreeBackend:
    """A robot on `interface`. See `hal.contract.Backend`; the source clock is `clock`."""

    def __init__(
        self,
        interface: str,
        domain: int = 0,
        options: UnitreeConfig | None = None,
        dry_run: bool = False,
        link: Link | None = None,
        clock: Callable[[], int] = time.time_ns,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        """interface: network interface of the robot's network; domain: 0 on the real robot; dry_run: listen, send
        nothing; link, clock, sleep: replaced by tests, then no guardian is started."""
        self.options = options or UnitreeConfig()
        self.capabilities = self.options.capabilities()
        self._interface, self._domain, self._dry_run = interface, domain, dry_run
        self._given, self._clock, self._sleep = link, clock, sleep
        self._link: Link | None = None
        self._guarded = link is None and not dry_run
        self._guardian: Guardian | None = None
        self._telemetry: Telemetry | None = None
        self._now = 0
        self._phase, self._cause = Phase.DISCONNECTED, "not connected yet"
        self._fault = ""
        self._stopped = ""
        self._refusal = ""
        """Why the last request was not followed; until the next one, or until the phase changes."""
        self._away: int | None = None
        """When LowState was last found missing [ns]; None while the robot is under control."""
        self._news = News()

    # -- contract --------------------------------------------------------------------------------------------------

    def connect(self) -> None:
        """Find the robot, check who owns its motors, take the remote role. Raises BackendError."""
        if self._telemetry is not None:
            return
        link = self._given or open_link(self._interface, self._domain, self.options)
        self._link = link = DryRunLink(link) if self._dry_run else link
        self._rpc = Rpc(link)
        self._echo = Echo(self._rpc, self.options.rpc_timeout)
        self._telemetry = telemetry = Telemetry(link, self.options, log_raw=self._dry_run)
        telemetry.warm_up()
        self._mover = Mover(self._rpc, self.options, self.capabilities)
        self._steps = Transitions(self._rpc, telemetry, self.options, self._dry_run)
        try:
            if self._guarded:
                self._guardian = self._new_guardian()
            where = f"on {self._interface!r}, DDS domain {self._domain}"
            wait_for_robot(telemetry, self.options, where, self._clock, self._sleep)
            self._alone(telemetry)
            self._run_now(self._steps.take_control())
            self._alone(telemetry)
            if self._guardian is not None:
                self._guardian.wait_ready(self.options.connect_timeout)
        except BackendError:
            self._release()
            raise
        self._stopped = ""
        self._fault = ""
        self._mover.fed(self._clock())
        self._judge(telemetry, self._now)

    def read(self, now: int) -> list[Sample]:
        """Samples since the last call; also runs transitions, watchdog and the repetition of Move."""
        telemetry = self._telemetry
        if telemetry is None:
            return []
        self._now = now
        out: list[Sample] = list(telemetry.read(now))
        self._rpc.poll(now)
        # What makes LowState late: the way, or the robot's clock? A request that is answered at once tells.
        if self._dry_run or not telemetry.low_clock.doubtful:
            self._echo.rest()
        elif self._echo.prompt(now):
            telemetry.believe_clock(now)
        self._steps.now = now
        self._fault = self._steps.advance() or self._fault
        self._insist(telemetry, now)
        self._judge(telemetry, now)
        self._mover.pump(now, allowed=self._phase in (Phase.READY, Phase.MOVING))
        if self._guardian is not None:
            self._guardian.beat(self._mover.moving)
        out += self._news.of(self.state())
        return out

    def drive(self, command: VelocityCommand) -> None:
        """Velocity until the next call; ignored (zero) unless the robot is ready."""
        if self._telemetry is None:
            return
        ready = self._phase in (Phase.READY, Phase.MOVING) and not self._steps.goal
        rested = not self._mover.wanted
        self._mover.set(command if ready else VelocityCommand(command.stamp), self._now)
        if self._guardian is not None:
            if rested and self._mover.wanted:
                self._guardian.leave_off()
            # It must know before the robot does: this process may end in between.
            self._guardian.beat(self._mover.moving)
        self._mover.pump(self._now, allowed=ready)

    def posture(self, command: PostureCommand) -> None:
        """Roll and pitch offsets at rest. The present sport service has no body height."""
        self._connected()
        self._mover.posture(command)

    def request(self, mode: ModeRequest) -> None:
        """Start a transition; progress, refusal and failure show in `state`."""
        telemetry = self._connected()
        up = telemetry.upright
        self._refusal = refusal(mode, self._phase, stopped=bool(self._stopped), upright=up)
        # With locked joints and nothing under way it stands, but takes no velocity.
        locked = self._phase is Phase.STANDING and not self._steps.goal
        if self._refusal:
            log.warning("%s", self._refusal)
        elif locked or not fulfilled(mode, self._phase):
            self._follow(mode)
        self._judge(telemetry, self._now)

    def _follow(self, mode: ModeRequest) -> None:
        match mode:
            case ModeRequest.STOP:
                self._steps.abandon()
                self._stopped = "emergency stop"
                self._halt()
            case ModeRequest.RESUME:
                self._stopped = ""
            case ModeRequest.DAMP:
                self._start(self._steps.damp(), "going soft", Phase.DAMPED)
                if self._guardian is not None:
                    self._guardian.damp()
            case ModeRequest.SIT:
                self._start(self._steps.sit(), "lying down", Phase.SITTING)
            case ModeRequest.STAND:
                self._start(self._steps.stand(), "standing up", Phase.STANDING)
            case ModeRequest.RECOVER:
                self._restart_guardian()
                self._start(self._steps.recover(), RECOVERING, Phase.STANDING)

    def state(self) -> RobotState:
        """Newest summary state."""
        t = self._telemetry
        if t is None:
            return RobotState(self._now, self._phase, self._cause)
        return RobotState(
            self._now, self._phase, self._cause, t.battery, t.motor_temperature, t.contact, t.remote
        )

    def close(self, *, lie_down: bool = True) -> None:
        """Stop, lie down, release; never releases the motion service.

        Takes 3.2 s at most (1.5 to rest, 1.7 to lie down), and 5 s more where the guardian has to insist that the robot
        rests.
        """
        if self._telemetry is None:
            return
        try:
            if self._telemetry.low_age(self._clock()) < 1.0:
                lying = self._phase is Phase.SITTING and not self._steps.goal
                lie = lie_down and self.options.sit_on_close and not lying and self._phase is not Phase.DAMPED
                self._steps.abandon()
                self._halt()
                self._run_now(self._steps.come_to_rest())
                lie = lie and not self._steps.rolls  # else the guardian sees to it
                if lie:
                    self._leave_off()
                self._run_now(self._steps.leave(lie))
                if self._guardian is not None:
                    self._guardian.beat(moving=False)
        except BackendError as error:
            log.warning("leaving the robot: %s", error)
        finally:
            self._release()
            self._phase, self._cause = Phase.DISCONNECTED, "closed"

    # -- what operators ask for ------------------------------------------------------------------------------------

    def diagnostics(self) -> dict[str, float]:
        """Offsets of clocks [s], then counters: unreadable and late messages, missed sweeps, restarts of the robot."""
        if self._telemetry is None:
            return {}
        return {**self._telemetry.figures(), "late_responses": self._rpc.late}

    @property
    def guardian_pid(self) -> int | None:
        """Of the process that stops the robot when this one dies; None where there is none."""
        return None if self._guardian is None else self._guardian.pid

    # -- inside ----------------------------------------------------------------------------------------------------

    def _connected(self) -> Telemetry:
        if self._telemetry is None:
            raise BackendError("not connected: call connect() first")
        return self._telemetry

    def _run_now(self, steps: Steps) -> None:
        """Drive a transition to its end, waiting. Only in connect and close."""
        finish(steps, self._tick, self._sleep)

    def _tick(self) -> None:
        """Hear the robot while something waits for it."""
        self._now = self._steps.now = self._clock()
        self._connected().read(self._now)
        self._rpc.poll(self._now)
        if self._guardian is not None:
            self._guardian.beat(self._mover.moving)

    def _start(self, steps: Steps, goal: str, phase: Phase) -> None:
        if self._steps.goal == goal:
            return  # asked again while it is under way
        self._fault = ""
        self._steps.start(steps, goal, phase)
        self._mover.rest(self._now)
        self._leave_off()
        self._mover.confirm_reset()

    def _leave_off(self) -> None:
        """The robot is told something else than to rest: nobody insists on that any more."""
        self._mover.halt.end()
        if self._guardian is not None:
            self._guardian.leave_off()

    def _insist(self, telemetry: Telemetry, now: int) -> None:
        """A robot that was stopped rests, or is made soft, which is a fault."""
        if self._dry_run:
            self._mover.halt.end()
            return
        soft = self._mover.insist(now, telemetry)
        if soft:
            self._steps.abandon()
            self._fault = f"{soft}: made soft (Damp); {ROLLS_ON.remedy}"

    def _halt(self) -> None:
        """StopMove on both paths."""
        self._mover.stop(self._now)
        if self._guardian is not None:
            self._guardian.stop()

    def _judge(self, t: Telemetry, now: int) -> None:
        """Phase and cause from what is known now."""
        before = (self._phase, self._cause)
        self._phase, cause = self._verdict(t, now)
        if self._phase is not before[0]:
            self._refusal = ""
        parts = (f"{DRY_RUN}: {cause}" if self._dry_run else cause, self._refusal)
        self._cause = "; ".join(part for part in parts if part)
        halting = self._phase in (Phase.DISCONNECTED, Phase.FAULT)
        if halting and before[0] in (Phase.READY, Phase.MOVING) and not self._mover.halt.damped:
            self._halt()
        if self._phase != before[0]:
            driving = {before[0], self._phase} == {Phase.READY, Phase.MOVING}
            level = logging.WARNING if self._phase is Phase.FAULT else logging.INFO
            level = logging.DEBUG if driving else level
            log.log(level, "%s -> %s: %s", before[0].value, self._phase.value, self._cause)

    def _several(self, t: Telemetry, now: int) -> str:
        """That more than one robot speaks, in words; empty where one does."""
        service = self._rpc.several(now)
        found = (t.several(now), f"service {service!r} answered a request twice" if service else "")
        return (
            TWO_ROBOTS.tell(found="; ".join(filter(None, found))) if any(found) and TWO_ROBOTS.active else ""
        )

    def _alone(self, telemetry: Telemetry) -> None:
        listen_alone(lambda: self._several(telemetry, self._now), self._tick, self._clock, self._sleep)

    def _verdict(self, t: Telemetry, now: int) -> tuple[Phase, str]:
        o = self.options
        if t.low_age(now) > o.state_timeout:
            self._mover.confirm_reset()
            self._away = now
            return Phase.DISCONNECTED, t.low_trouble(now)
        if self._away is not None:
            # What its sport service said before tells nothing of a robot that may have been switched off and on.
            missed = (now - self._away) / NS
            if t.sport_age(now) >= missed and missed <= o.sport_timeout:
                return Phase.DISCONNECTED, "LowState is back, waiting for sportmodestate"
            self._away = None
            if t.sport_age(now) < missed and not self._steps.goal and not self._fault:
                self._start(self._steps.take_control(), "taking control again", Phase.STANDING)
        found = "" if self._fault else self._trouble(t, now)
        if found:
            self._steps.abandon()
            self._fault = found
        if self._fault:
            return Phase.FAULT, self._fault
        if self._steps.goal:
            return self._steps.phase, f"{self._steps.goal}: {self._steps.doing}"
        if t.phase in LYING:
            return t.phase, self._stopped or ("lying" if t.phase is Phase.SITTING else "joints are soft")
        rolls = self._mover.rolls_on(now, t)
        if self._stopped:
            return Phase.STOPPED, "; ".join(filter(None, (self._stopped, rolls)))
        if t.phase is Phase.STANDING:
            return Phase.STANDING, "joints are locked: request stand"
        if self._guardian is not None and not self._guardian.ready:
            return Phase.STANDING, "waiting for the guardian process"
        note, ignored = rolls or self._mover.note, self._ignored(t, now)
        if ignored > 1.5:
            note = f"Move is not followed for {ignored:.0f} s (normal up to 10 s after standing up)"
        # Once seen to move it counts as moving while it is told to: measured speed flickers around zero.
        seen = t.speed > 0.05 or t.yaw_rate > 0.1 or self._phase is Phase.MOVING
        if self._mover.moving and seen and ignored < 1.5:
            return Phase.MOVING, note or t.note(now) or "following velocity"
        return Phase.READY, note or t.note(now) or t.order_note or "balance stand, takes velocity"

    def _trouble(self, t: Telemetry, now: int) -> str:
        """The reason of a fault now, in words; empty without a fault."""
        o = self.options
        if several := self._several(t, now):
            return several
        if not self._steps.goal and t.sport_age(now) > o.sport_timeout:
            return "sport service is silent (motion service released?): request recover"
        if (self._steps.phase if self._steps.goal else t.phase) is Phase.DAMPED:
            return ""  # soft, it may lie as it likes, and nobody drives it
        if not t.upright and self._steps.goal != RECOVERING:
            return "fallen: recover when the robot is free"
        if self._guarded and (self._guardian is None or not self._guardian.alive()):
            return "guardian process lost: recover starts it again"
        if t.mount_error is not None and t.mount_error > MOUNT_TOLERANCE:
            return (
                f"LiDAR mount disagrees with gravity by {math.degrees(t.mount_error):.0f} deg: check the "
                "mount in lidars"
            )
        ignored = self._ignored(t, now)
        if ignored > o.ignored_timeout:
            return f"robot ignores Move for {ignored:.0f} s: request recover"
        return ""

    def _ignored(self, t: Telemetry, now: int) -> float:
        """Seconds for which Move was sent in vain; a dry run sends none."""
        return 0.0 if self._dry_run else self._mover.ignored(now, t)

    def _restart_guardian(self) -> None:
        if not self._guarded or (self._guardian is not None and self._guardian.alive()):
            return
        if self._guardian is not None:
            self._guardian.kill()
        self._guardian = self._new_guardian()

    def _new_guardian(self) -> Guardian:
        o = self.options
        return Guardian(self._interface, self._domain, o.avoid_obstacles, o.wheels)

    def _release(self) -> None:
        if self._guardian is not None:
            self._guardian.close()
            self._guardian = None
        if self._link is not None:
            self._link.close()
            self._link = None
        self._telemetry = None
