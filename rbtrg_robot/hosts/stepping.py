"""A re-run that somebody leads through: it stands between two messages until it is told how far to go, and can be
looked into while it stands."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

from hal.errors import OperatorError
from hal.types import NS
from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.config import StackConfig
from rbtrg_robot.hosts import inside
from rbtrg_robot.hosts.offline import Stages, Window, feed, fitting, stages_for
from rbtrg_robot.log.summary import overview
from rbtrg_robot.stages.planner import PlannerStage
from rbtrg_robot.topics import Topic
from rbtrg_robot.wire.messages import MessageError, decode

Told = Callable[[Topic, bytes, int, int], None]
"""Called with topic, wire bytes, stamp [ns] and number of each message, in the thread of the re-run."""
Until = Literal["message", "scan"]
STAND = ("", 0.0)

log = logging.getLogger(__name__)


class StepError(OperatorError):
    """What was asked for cannot be done now; the message says why."""


class _Over(Exception):
    """The re-run is given up."""


class Stepper:
    """Runs stages on a log again in a thread of its own. Its first act is to stand before the first message."""

    def __init__(
        self,
        run: Path,
        names: list[str],
        config: StackConfig,
        told: Told,
        stood: Callable[[], None] = lambda: None,
    ) -> None:
        """`stood` is called whenever it begins to stand, and at its end. Raises LogError, ConfigError where the log
        does not do for these stages."""
        fitting(run, names, config)
        self.names = names
        self.length = overview(run).seconds
        """[s] of the log."""
        self._log, self._config, self._told, self._stood = run, config, told, stood
        self._turn = threading.Condition()
        self._target = STAND
        """What it goes on to: `message`, `scan`, a `time` [s], or `play` at a rate."""
        self._began = (0.0, 0.0)
        """When it was told to: on the wall, and in the log [s]."""
        self._standing = False
        self._over = False
        self.ended = False
        self.wrong = ""
        """Why it ended before the end of the log."""
        self.seconds = 0.0
        """[s] of the log that are done."""
        self.newest: dict[Topic, tuple[bytes, float]] = {}
        """The newest message of each topic, and when it was [s of the log]."""
        self.last: Topic | None = None
        self.round = 0
        """How often it began anew."""
        self._stages: dict[str, Any] = {}
        self._thread: threading.Thread | None = None
        self._begin(STAND)

    # --- who leads ----------------------------------------------------------------------------------------------

    @property
    def standing(self) -> bool:
        """It waits to be told how far to go, or has ended."""
        return self._standing or self.ended

    def step(self, until: Until) -> None:
        """To the next message, or to the next scan that odometry or the log tells a pose of."""
        self._go((until, 0.0))

    def play(self, rate: float) -> None:
        """On and on, `rate` seconds of the log in a second."""
        self._go(("play", rate))

    def pause(self) -> None:
        """Stand before the next message."""
        with self._turn:
            self._target = STAND
            self._turn.notify_all()

    def behind(self, seconds: float) -> bool:
        """Whether a time of the log [s] can be reached from its start alone."""
        return self.ended or seconds < self.seconds

    def seek(self, seconds: float) -> None:
        """To a time of the log [s]; for what lies behind the re-run begins anew."""
        if not self.behind(seconds):
            self._go(("time", seconds))
        else:
            self.close()
            self._begin(("time", seconds))

    def close(self) -> None:
        """Give the re-run up."""
        with self._turn:
            self._over = True
            self._turn.notify_all()
        if self._thread is not None:
            self._thread.join()

    def _go(self, target: tuple[str, float]) -> None:
        with self._turn:
            if self.ended:
                raise StepError(self.wrong or "the log is at its end: seek an earlier time")
            self._target, self._standing = target, False
            self._began = time.monotonic(), self.seconds
            self._turn.notify_all()

    def wait(self, timeout: float) -> bool:
        """Until it stands; False where it does not in `timeout` [s]."""
        with self._turn:
            return self._turn.wait_for(lambda: self.standing, timeout)

    # --- looking in ---------------------------------------------------------------------------------------------

    def look(self, name: str, at: tuple[float, float] | None = None) -> dict[str, Any]:
        """Inputs, outputs and figures of a stage while the re-run stands; `at`: x, y [m] in `map` of a place it is
        asked about. Raises StepError."""
        with self._turn:
            stage = self._stage(name)
            rows = {
                "inputs": [self._row(topic) for topic in stage.inputs],
                "outputs": [self._row(topic) for topic in stage.outputs],
                "place": inside.place(stage, *at) if at else [],
                "inside": inside.figures(stage),
            }
            if isinstance(stage, PlannerStage) and at:
                rows["place"] += inside.frontiers(stage, *at)
            return {"stage": name, "seconds": self.seconds, **rows}

    def why(self, goal: tuple[float, float], start: tuple[float, float, float]) -> msg.RouteReport:
        """The planner's answer to "how would it go there?": a route with its price and worst place, or why there is
        none. `start`: x, y [m], heading [rad]. Raises StepError."""
        with self._turn:
            stage = self._stage("planner")
            x, y, yaw = start
            question = msg.RouteQuestion(
                id="step", start_x=x, start_y=y, start_yaw=yaw, goal_x=goal[0], goal_y=goal[1], graph=True
            )
            [(_, report)] = stage.on(t.ROUTE_QUESTION, question)
            assert isinstance(report, msg.RouteReport)
            return report

    def _stage(self, name: str) -> Any:
        if not self.standing:
            raise StepError("it runs: pause it first")
        if name not in self._stages:
            raise StepError(f"{name} is not run again here: `log step RUN --stage {name}`")
        return self._stages[name]

    def _row(self, topic: Topic) -> tuple[str, str]:
        if topic not in self.newest:
            return topic.name, "none yet"
        payload, at = self.newest[topic]
        try:
            words = inside.brief(decode(payload, topic.kind))
        except MessageError as error:
            words = str(error)
        return topic.name, f"{at:.3f} s: {words}"

    # --- the re-run ---------------------------------------------------------------------------------------------

    def _begin(self, target: tuple[str, float]) -> None:
        self._target, self._began = target, (time.monotonic(), 0.0)
        self._over = self._standing = self.ended = False
        self.wrong, self.seconds, self.last = "", 0.0, None
        self.newest.clear()
        self.round += 1
        self._thread = threading.Thread(target=self._run, name="re-run", daemon=True)
        self._thread.start()

    def _run(self) -> None:
        pairs: Stages = {}
        try:
            pairs = stages_for(self._log, self.names, self._config)
            self._stages = {name: stage for name, (stage, _) in pairs.items()}
            zero = overview(self._log).begin

            def take(topic: Topic, payload: bytes, now: int, stamp: int, sequence: int) -> None:
                self._stand(topic, (now - zero) / NS)
                self.seconds = max(self.seconds, (now - zero) / NS)
                self.newest[topic], self.last = (payload, self.seconds), topic
                self._told(topic, payload, stamp, sequence)

            feed(self._log, pairs, self._config, take, Window(zero))
        except _Over:
            for stage, _ in pairs.values():
                stage.close()
        except OperatorError as error:
            self.wrong = str(error)
        except Exception:
            log.exception("the re-run of %s failed", self._log)
            self.wrong = "a fault in the program ended it; see what stands above"
        finally:
            with self._turn:
                self.ended = True
                self._turn.notify_all()
            self._stood()

    def _stand(self, topic: Topic, seconds: float) -> None:
        """Before a message: wait until it is its turn. Raises _Over."""
        with self._turn:
            while not self._over:
                what, value = self._target
                wait = self._began[0] + (seconds - self._began[1]) / (value or 1.0) - time.monotonic()
                if what == "play" and wait > 0.0:
                    self._turn.wait(wait)
                elif what == "play" or (what == "time" and seconds < value):
                    return
                elif what in ("message", "scan"):
                    if what == "message" or topic is t.ODOM:
                        self._target = STAND
                    return
                else:
                    self._standing = True
                    self._turn.notify_all()
                    self._stood()
                    self._turn.wait()
                    self._standing = False
            raise _Over
