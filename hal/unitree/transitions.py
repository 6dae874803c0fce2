"""Sequences of requests, one generator each: advanced once per tick, every wait bounded, every failure with a
reason."""

from __future__ import annotations

from collections.abc import Callable, Generator
from typing import Any

from hal.contract import BackendError
from hal.safety.monitors import ROLLS_ON
from hal.types import LYING, NS, Phase
from hal.unitree import api
from hal.unitree.api import MotionSwitcher, ObstaclesAvoid, Response, Sport, WireError
from hal.unitree.config import UnitreeConfig
from hal.unitree.rpc import NO_ANSWER, Rpc
from hal.unitree.telemetry import Telemetry

Steps = Generator[None, None, None]


class Failed(RuntimeError):
    """A transition did not come to its end; the message says why and what to do."""


def finish(steps: Steps, tick: Callable[[], None], sleep: Callable[[float], None]) -> None:
    """Drive a sequence to its end, waiting; `tick` hears the robot before each step. Raises BackendError."""
    try:
        while True:
            tick()
            next(steps)
            sleep(0.005)
    except StopIteration:
        return
    except Failed as failure:
        raise BackendError(str(failure)) from failure


class Transitions:
    """`now` [ns] is set by the owner before each advance; `doing` names the present step in plain words."""

    def __init__(self, rpc: Rpc, telemetry: Telemetry, options: UnitreeConfig, dry_run: bool) -> None:
        self._rpc, self._telemetry, self._options, self._dry_run = rpc, telemetry, options, dry_run
        self.now = 0
        self.doing = ""
        self._running: Steps | None = None
        self.goal = ""
        """The transition that runs, in plain words; empty without one."""
        self.phase = Phase.STANDING
        """The phase that the robot shows meanwhile."""
        self._stood_up = False
        self.released = ""
        """Name of the motion service that was released; empty where none was."""

    # -- running -------------------------------------------------------------------------------------------------------

    def start(self, steps: Steps, goal: str, phase: Phase) -> None:
        """Put this sequence under way, in place of any other."""
        self.abandon()
        self._running, self.goal, self.phase = steps, goal, phase

    def abandon(self) -> None:
        """Leave off what is under way."""
        self._running, self.goal = None, ""
        self._rpc.forget()

    def advance(self) -> str:
        """One step of what is under way. Why it failed, or empty."""
        try:
            if self._running is not None:
                next(self._running)
            return ""
        except StopIteration:
            failure = ""
        except Failed as failed:
            failure = f"{self.goal}: {failed}"
        self._running, self.goal = None, ""
        return failure

    # -- sequences -------------------------------------------------------------------------------------------------

    def take_control(self) -> Steps:
        """Of a robot not seen before, or lost and found: see that a motion service owns the motors, stop what runs."""
        self._stood_up = False  # it may have been switched off and on
        yield from self._own_motion()
        yield from self._call(api.SPORT, Sport.STOP_MOVE, "stopping")

    def stand(self) -> Steps:
        """StandUp, then BalanceStand: StandUp alone leaves the joints locked and Move without effect."""
        yield from self._own_motion()
        if not self._on_its_feet():
            yield from self._call(api.SPORT, Sport.STAND_UP, "stand up")
            self._stood_up = True
            yield from self._until(
                lambda: self._telemetry.standing_tall, self._options.stand_timeout, "standing up"
            )
        yield from self._balance()

    def recover(self) -> Steps:
        """RecoveryStand from any attitude, then BalanceStand."""
        yield from self._own_motion()
        yield from self._call(api.SPORT, Sport.RECOVERY_STAND, "recovery stand")
        yield from self._until(
            lambda: self._telemetry.upright and self._telemetry.standing_tall,
            self._options.stand_timeout,
            "getting up",
        )
        yield from self._balance()

    def sit(self) -> Steps:
        """StopMove, StandDown."""
        yield from self._call(api.SPORT, Sport.STOP_MOVE, "stopping")
        yield from self._stand_down()
        yield from self._until(
            lambda: self._seen(LYING, (5,)) and not self._telemetry.standing_tall,
            self._options.stand_timeout,
            "lying down",
        )

    def damp(self) -> Steps:
        """Damp until the robot reports it."""
        yield from self._call(api.SPORT, Sport.DAMP, "damp")
        yield from self._until(lambda: self._seen(LYING, (7,)), 2.0, "going soft")

    def release_motion(self) -> Steps:
        """Have the motors for LowCmd: the robot lies down, then its motion service goes, whose torque drops at once."""
        self.released = ""
        name = yield from self._active_motion()
        if not name:
            return
        if not self._seen(LYING, (5, 7)):
            yield from self.sit()
        deadline = self.now + round(self._options.busy_timeout * NS)
        while name:
            self.released = name
            yield from self._call(
                api.MOTION_SWITCHER, MotionSwitcher.RELEASE_MODE, f"releasing motion service {name!r}"
            )
            yield from self._pause(0.2)
            name = yield from self._active_motion()
            if name and self.now > deadline:
                raise Failed(f"motion service {name!r} does not go; close the app, then start again")

    def give_back_motion(self) -> Steps:
        """The motion service that was released owns the motors again. The robot lies, soft."""
        name, self.released = self.released, ""
        if name and not (yield from self._active_motion()):  # app or remote may have selected one
            yield from self._select_motion(name)

    def come_to_rest(self) -> Steps:
        """StopMove, and the time that it takes."""
        yield from self._call(api.SPORT, Sport.STOP_MOVE, "stopping", tries=2, timeout=0.3)
        start = self.now
        while self.rolls and self.now - start < 0.9 * NS:
            yield

    @property
    def rolls(self) -> bool:
        """Whether the robot moves, as far as is heard."""
        return ROLLS_ON.outside(self._telemetry.motion.speed(self.now / NS) or 0.0)

    def leave(self, lie_down: bool) -> Steps:
        """At rest: give obstacle avoidance back; lie down. Never ReleaseMode: the robot would drop."""
        if self._options.avoid_obstacles:
            yield from self._call(
                api.OBSTACLES_AVOID,
                ObstaclesAvoid.USE_REMOTE_COMMAND_FROM_API,
                "commands from the joystick again",
                tries=1,
                timeout=0.3,
                is_remote_commands_from_api=False,
            )
        if lie_down:
            yield from self._stand_down(tries=1, timeout=0.5)

    def _seen(self, phases: tuple[Phase, ...], modes: tuple[int, ...]) -> bool:
        """Whether the robot tells one of `phases` in error_code, or, where it tells nothing there, is in one of
        `modes`."""
        told = self._telemetry.told
        return self._telemetry.mode in modes if told is None else told in phases

    def _on_its_feet(self) -> bool:
        upright = self._seen((Phase.STANDING, Phase.READY), (0, 1, 2, 3, 6))
        return upright and self._telemetry.standing_tall

    # -- parts -----------------------------------------------------------------------------------------------------

    def _own_motion(self) -> Steps:
        """CheckMode; where no motion service is active, SelectMode. Then obstacle avoidance as configured."""
        name = yield from self._active_motion()
        if not name and not self._dry_run:
            yield from self._select_motion(self._options.motion_mode)
        if self._options.avoid_obstacles:
            yield from self._call(
                api.OBSTACLES_AVOID, ObstaclesAvoid.SWITCH_SET, "obstacle avoidance on", enable=True
            )
            yield from self._call(
                api.OBSTACLES_AVOID,
                ObstaclesAvoid.USE_REMOTE_COMMAND_FROM_API,
                "commands from here",
                is_remote_commands_from_api=True,
            )

    def _active_motion(self) -> Generator[None, None, str]:
        """Name of the motion service that owns the motors; empty for none. A dry run is not told."""
        asked = "which motion service is active"
        answer = yield from self._call(api.MOTION_SWITCHER, MotionSwitcher.CHECK_MODE, asked)
        if self._dry_run:
            return ""
        try:
            return str(answer.json()["name"])
        except (WireError, KeyError) as error:  # taken for "none", the running one would be replaced
            why = error if isinstance(error, WireError) else f"answer {answer.data!r} has no name"
            raise Failed(f"{asked}: {why}") from error

    def _select_motion(self, name: str) -> Steps:
        """SelectMode, with patience for busy, until the service reports."""
        deadline = self.now + round(self._options.busy_timeout * NS)
        while True:
            answer = yield from self._call(
                api.MOTION_SWITCHER,
                MotionSwitcher.SELECT_MODE,
                f"selecting motion service {name!r}",
                accept=(0, api.BUSY),
                name=name,
            )
            if answer.code == 0:
                break
            if self.now > deadline:
                raise Failed(
                    f"mode switcher stayed busy for {self._options.busy_timeout:.0f} s; wait a minute, then recover"
                )
            self.doing = "mode switcher is busy, trying again"
            yield from self._pause(0.5)
        yield from self._until(
            lambda: self._telemetry.sport_age(self.now) < 0.5, 5.0, f"motion service {name!r} to report"
        )

    def _balance(self) -> Steps:
        """BalanceStand, repeated: right after StandUp it may be accepted without effect."""
        deadline = self.now + round(self._options.stand_timeout * NS)
        while True:
            yield from self._call(api.SPORT, Sport.BALANCE_STAND, "balance stand")
            start = self.now
            while self.now - start < NS:
                if self._dry_run or self._seen((Phase.READY,), (1, 3)):
                    return
                yield
            if self.now > deadline:
                raise Failed(
                    f"robot does not say that it balances ({self._telemetry.raw}); check that joystick and "
                    "app are not in control, "
                    "and that unitree.state_codes has the error_code of this firmware"
                )

    def _stand_down(self, tries: int | None = None, timeout: float | None = None) -> Steps:
        """StandDown; preceded by StandUp in a session that never stood up, without which it has no effect."""
        if not self._stood_up:
            yield from self._call(
                api.SPORT, Sport.STAND_UP, "stand up before lying down", tries=tries, timeout=timeout
            )
            self._stood_up = True
            yield from self._pause(0.4)
        yield from self._call(api.SPORT, Sport.STAND_DOWN, "stand down", tries=tries, timeout=timeout)
        self._stood_up = False

    def _call(
        self,
        service: str,
        number: int,
        doing: str,
        accept: tuple[int, ...] = (0,),
        tries: int | None = None,
        timeout: float | None = None,
        **parameter: Any,
    ) -> Generator[None, None, Response]:
        """One request with repetitions; the response. Raises Failed on a code that is not accepted."""
        self.doing = doing
        tries = tries or self._options.rpc_tries
        code = NO_ANSWER
        for _ in range(tries):
            identity = self._rpc.call(
                service, number, self.now, timeout or self._options.rpc_timeout, parameter
            )
            while (response := self._rpc.result(identity)) is None:
                yield
            if response.code in accept:
                return response
            code = response.code
            if code != NO_ANSWER:
                break
        raise Failed(f"{doing}: {api.describe(code)} from service {service!r}")

    def _until(self, condition: Callable[[], bool], timeout: float, doing: str) -> Steps:
        """Wait for telemetry to show it. A dry run has nothing to wait for."""
        self.doing = doing
        deadline = self.now + round(timeout * NS)
        while not self._dry_run and not condition():
            if self.now > deadline:
                raise Failed(f"{doing} took longer than {timeout:.0f} s")
            yield

    def _pause(self, seconds: float) -> Steps:
        start = self.now
        while self.now - start < seconds * NS:
            yield
