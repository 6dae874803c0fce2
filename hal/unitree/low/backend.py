"""The Go2-W with a locomotion controller of ours at its motors, as a backend of the contract.

Three processes: this one, which has the sensors and tells velocities; the motor loop, which balances
(`hal.unitree.low.process`); and its watchdog (`hal.unitree.low.watch`). Each stops the robot when the one above it
dies. The robot's own motion service is released from a robot that lies, and given back at the end.
"""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from hal.contract import BackendError
from hal.safety.monitors import TWO_ROBOTS
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
from hal.unitree.link import Link
from hal.unitree.low.handle import MotorProcess, Motors
from hal.unitree.low.loop import Order
from hal.unitree.low.wire import LOW_CMD
from hal.unitree.news import News
from hal.unitree.rpc import Rpc
from hal.unitree.telemetry import Telemetry
from hal.unitree.transitions import Transitions, finish

log = logging.getLogger(__name__)

TETHER_SHARE, TETHER_VX = 1.0 / 3.0, 0.2
"""Share of the torque limits and speed [m/s] of a controller that was not tried on this robot yet."""
TETHER = "not tried on this robot: hang it with its wheels off the ground; then name the controller in unitree.tried"
START_TIME = 120.0
"""[s] for the motor loop to compile and start."""
RETURNED = (
    "the robot's own motion service has the motors again (app or remote), nothing is sent any more: "
    "start the stack anew"
)
OWNED_WITHIN = 0.5
"""[s] within which a motion service that has the motors tells its state."""
KEPT_REQUESTS = 8
"""Requests that are told again and again: a line may be lost."""


class LowLevelBackend:
    """A Go2-W on `interface`. See `hal.contract.Backend`; the source clock is `clock`."""

    def __init__(
        self,
        interface: str,
        domain: int = 0,
        options: UnitreeConfig | None = None,
        controller: str = "",
        policy: str = "",
        link: Link | None = None,
        clock: Callable[[], int] = time.time_ns,
        sleep: Callable[[float], None] = time.sleep,
        motors: Callable[[dict[str, Any]], Motors] = MotorProcess,
    ) -> None:
        """interface: of the robot's network; domain: 0 on the real robot; policy: see `controller_of`.

        link, clock, sleep, motors: replaced by tests.
        """
        self.options = options or UnitreeConfig(level="low")
        self.capabilities = self.options.capabilities(controller)
        self._interface, self._domain = interface, domain
        self._tried = controller in self.options.tried
        self._settings = {
            "interface": interface,
            "domain": domain,
            "controller": controller,
            "policy": policy,
            "imu_yaw": self.options.imu_yaw,
            "check_crc": self.options.check_crc,
            "law_age": self.options.law_age,
            "share": 1.0 if self._tried else TETHER_SHARE,
            "max_vx": self.options.max_vx if self._tried else TETHER_VX,
        }
        self._given, self._clock, self._sleep, self._start = link, clock, sleep, motors
        self._link: Link | None = None
        self._telemetry: Telemetry | None = None
        self._motors: Motors | None = None
        self._order = Order()
        self._requests = 0
        self._fed_at = self._released_at = 0
        self._now = 0
        self._phase, self._cause = Phase.DISCONNECTED, "not connected yet"
        self._news = News()

    # -- contract --------------------------------------------------------------------------------------------------

    def connect(self) -> None:
        """Find the robot, have it lie down, release its motion service, start the motor loop. Raises BackendError."""
        if self._telemetry is not None:
            return
        self._link = link = self._given or open_link(self._interface, self._domain, self.options)
        self._rpc = Rpc(link)
        self._telemetry = telemetry = Telemetry(link, self.options)
        telemetry.warm_up()
        self._steps = Transitions(self._rpc, telemetry, self.options, dry_run=False)
        try:
            where = f"on {self._interface!r}, DDS domain {self._domain}"
            wait_for_robot(telemetry, self.options, where, self._clock, self._sleep)
            self._alone(link, telemetry)
            finish(self._steps.release_motion(), self._tick, self._sleep)
            self._start_motors()
        except BackendError:
            self._leave()
            raise
        self._order, self._requests = Order(), 0
        self._fed_at = self._released_at = self._clock()
        self._judge()

    def read(self, now: int) -> list[Sample]:
        """Samples since the last call; also tells the motor loop that this process lives."""
        telemetry = self._telemetry
        if telemetry is None:
            return []
        self._now = now
        out: list[Sample] = list(telemetry.read(now))
        self._rpc.poll(now)
        # Its last words may come after its release.
        if telemetry.sport_age(now) < OWNED_WITHIN and now - self._released_at > 2 * OWNED_WITHIN * NS:
            self._order.taken = True
        self._tell(now)
        self._judge()
        out += self._news.of(self.state())
        return out

    def drive(self, command: VelocityCommand) -> None:
        """Velocity until the next call; zero where it is not finite, clipped to the capabilities."""
        if self._telemetry is None:
            return
        able, order = self.capabilities, self._order
        values = (command.vx, command.vy, command.wz)
        vx, vy, wz = values if all(map(math.isfinite, values)) else (0.0, 0.0, 0.0)
        order.vx = max(-able.max_vx, min(able.max_vx, vx))
        order.vy = max(-able.max_vy, min(able.max_vy, vy))
        order.wz = max(-able.max_wz, min(able.max_wz, wz))
        order.climb = command.climb
        self._fed_at = self._now

    def posture(self, command: PostureCommand) -> None:
        """Trunk height and attitude offsets until the next call."""
        self._connected()
        if all(map(math.isfinite, (command.roll, command.pitch, command.height or 0.0))):
            self._order.roll, self._order.pitch, self._order.height = (
                command.roll,
                command.pitch,
                command.height,
            )

    def request(self, mode: ModeRequest) -> None:
        """Start a transition; the motor loop follows or refuses, and `state` shows it."""
        self._connected()
        if mode is ModeRequest.RECOVER and self._lost() and not self._order.taken:
            self._restart_motors()
        self._requests += 1
        self._order.requests = [*self._order.requests, (self._requests, mode.value)][-KEPT_REQUESTS:]
        self._tell(self._now)
        self._judge()

    def state(self) -> RobotState:
        """Newest summary state."""
        t = self._telemetry
        if t is None:
            return RobotState(self._now, self._phase, self._cause)
        return RobotState(
            self._now, self._phase, self._cause, t.battery, t.motor_temperature, t.contact, t.remote
        )

    def close(self, *, lie_down: bool = True) -> None:
        """Rest, lie down, go soft, give the motors back. Bounded to `CLOSING` and `unitree.busy_timeout`.

        Nobody else holds the joints of this robot: it lies down whatever `lie_down` says.
        """
        if self._telemetry is None:
            return
        try:
            self._leave()
        finally:
            self._phase, self._cause = Phase.DISCONNECTED, "closed"

    # -- what operators ask for ------------------------------------------------------------------------------------

    def diagnostics(self) -> dict[str, float]:
        """Those of the telemetry; commands that came late, the time between two of them that 99.9 % keep, and the
        longest [s]."""
        if self._telemetry is None:
            return {}
        report = self._motors.report() if self._motors is not None else None
        own: dict[str, float] = {}
        if report is not None:
            own = {"commands_late": report.late, "command_gap_999": report.shares[-1]}
            own["command_gap"] = report.worst
        return {**self._telemetry.figures(), "late_responses": self._rpc.late, **own}

    # -- inside ----------------------------------------------------------------------------------------------------

    def _connected(self) -> Telemetry:
        if self._telemetry is None:
            raise BackendError("not connected: call connect() first")
        return self._telemetry

    def _alone(self, link: Link, telemetry: Telemetry) -> None:
        """One robot on the network, and nobody else at its motors. Raises BackendError."""

        def several() -> str:
            found = telemetry.several(self._now)
            return TWO_ROBOTS.tell(found=found) if found and TWO_ROBOTS.active else ""

        listen_alone(several, self._tick, self._clock, self._sleep)
        if others := link.publishers(LOW_CMD):
            raise BackendError(
                f"{others} other programs send {LOW_CMD}: two commanders shake the robot; end the others first",
                retry=False,
            )

    def _tick(self) -> None:
        """Hear the robot while something waits for it."""
        self._now = self._steps.now = self._clock()
        self._connected().read(self._now)
        self._rpc.poll(self._now)

    def _start_motors(self) -> None:
        """The motor loop, up to its first report. Raises BackendError."""
        self._motors = self._start(dict(self._settings))
        deadline = self._clock() + round(START_TIME * NS)
        while True:
            self._tick()
            report = self._motors.report()
            if report is not None and report.phase is not Phase.DISCONNECTED:
                return
            if lost := self._motors.lost():
                raise BackendError(lost)
            if self._now > deadline:
                raise BackendError(f"the motor loop did not start within {START_TIME:.0f} s")
            self._sleep(0.005)

    def _restart_motors(self) -> None:
        """A new motor loop for a robot that lies soft. It starts while `read` goes on."""
        assert self._motors is not None
        self._motors.close()
        self._order.requests = []  # what the old loop was asked for is over
        self._motors = self._start(dict(self._settings))

    def _tell(self, now: int) -> None:
        if self._motors is not None:
            fed = (now - self._fed_at) / NS <= self.options.watchdog
            self._motors.tell(self._order if fed else replace(self._order, vx=0.0, vy=0.0, wz=0.0))

    def _lost(self) -> str:
        return "" if self._motors is None else self._motors.lost()

    def _judge(self) -> None:
        """Phase and cause from what is known now."""
        before = self._phase
        self._phase, self._cause = self._verdict()
        driving = {before, self._phase} == {Phase.READY, Phase.MOVING}
        if self._phase is not before and not driving:
            level = logging.WARNING if self._phase is Phase.FAULT else logging.INFO
            log.log(level, "%s -> %s: %s", before.value, self._phase.value, self._cause)

    def _verdict(self) -> tuple[Phase, str]:
        telemetry = self._connected()
        if self._order.taken:
            return Phase.FAULT, RETURNED
        if lost := self._lost():
            return Phase.FAULT, f"{lost}; recover starts it again"
        report = self._motors.report() if self._motors is not None else None
        if report is None or report.phase is Phase.DISCONNECTED:
            return Phase.STANDING, "the motor loop starts"
        notes = [report.cause]
        if not self._tried:
            notes.append(TETHER)
        if report.phase not in (Phase.FAULT, *LYING):
            notes.append(telemetry.note(self._now))
        return report.phase, "; ".join(filter(None, notes))

    def _leave(self) -> None:
        """End the motor loop, then give the motors back; say what of it did not work."""
        if self._motors is not None:
            self._motors.close()
            self._motors = None
        try:
            if self._telemetry is not None:
                finish(self._steps.give_back_motion(), self._tick, self._sleep)
        except BackendError as error:
            log.warning("the robot's own motion service was not given its motors back: %s", error)
        if self._link is not None:
            self._link.close()
        self._link = self._telemetry = None
