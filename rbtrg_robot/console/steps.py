"""A console without a robot, for `log step`: pages see a re-run that stands between two messages, lead it, and look
into its stages."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from starlette.concurrency import run_in_threadpool

from rbtrg_robot.config import StackConfig
from rbtrg_robot.console.desk import Answer, Desk, Page, Refused
from rbtrg_robot.console.feed import HEARD, Feed
from rbtrg_robot.console.frames import route
from rbtrg_robot.console.replays import FASTEST_REPLAY
from rbtrg_robot.hosts.stepping import Stepper
from rbtrg_robot.stages.navigation.reasons import words
from rbtrg_robot.topics import Topic
from rbtrg_robot.wire.bus import Received

STEP_PATIENCE = 60.0
"""[s] that a page waits for a step; a seek goes on behind it."""
TELL_PERIOD = 0.2
"""[s] between two lines of how far it is."""


class StepFeed(Feed):
    """What is shown does not grow old while the re-run stands."""

    def ages(self) -> dict[str, float]:
        """All of it is of now."""
        return {topic.name: 0.0 for topic in HEARD if topic.rate}

    def anew(self) -> None:
        """The log begins again: what was drawn goes. Runs in the server's thread."""
        with self.terrain_lock:
            self.terrain.forget()
        self._frames.clear()
        self._epoch, self._correction, self._odom = 0, 0.0, None
        for page in self.looking:
            page.clear()


class Steps:
    """What pages ask for. They command nothing else: there is no robot."""

    def __init__(
        self,
        run: Path,
        names: list[str],
        config: StackConfig,
        desk: Desk,
        feed: StepFeed,
        loop: asyncio.AbstractEventLoop,
    ) -> None:
        """Raises LogError, ConfigError."""
        self._run, self._feed, self._loop = run, feed, loop
        self._told = 0.0
        self.stepper = Stepper(run, names, config, self._message, self._stood)
        desk.wishes = {
            "step": self._step,
            "inside": self._inside,
            "ask": self._why,
            "pause replay": self._pause,
        }

    def _stood(self) -> None:
        self._loop.call_soon_threadsafe(self.tell)

    def _message(self, topic: Topic, payload: bytes, stamp: int, sequence: int) -> None:
        if topic in HEARD:
            self._feed.take(Received(topic, payload, stamp, sequence))
        if time.monotonic() - self._told > TELL_PERIOD:
            self._told = time.monotonic()
            self._stood()

    def tell(self) -> None:
        """How far it is. In the server's thread."""
        stepper = self.stepper
        self._feed.tell(
            "replay",
            {
                "run": f"{self._run.name}{f' (run {stepper.round})' if stepper.round > 1 else ''}",
                "state": "ended" if stepper.ended else "playing",
                "paused": stepper.standing,
                "seconds": stepper.seconds,
                "last": "" if stepper.last is None else stepper.last.name,
                "length": stepper.length,
                **({"wrong": stepper.wrong} if stepper.wrong else {}),
            },
        )

    async def _led(self, act: Callable[[], None]) -> Answer:
        await run_in_threadpool(act)
        await run_in_threadpool(self.stepper.wait, STEP_PATIENCE)
        return True, "", None

    async def _step(self, _page: Page, wish: dict[str, Any]) -> Answer:
        stepper, what = self.stepper, str(wish.get("what"))
        if what in ("message", "scan"):
            return await self._led(lambda: stepper.step(what))  # type: ignore[arg-type]
        if what == "play":
            rate = _number(wish, "rate", 0.05, FASTEST_REPLAY)
            await run_in_threadpool(stepper.play, rate)
            self.tell()
            return True, "", None
        if what == "seek":
            seconds = _number(wish, "seconds", 0.0, math.inf)
            if stepper.behind(seconds):
                await run_in_threadpool(stepper.close)
                self._feed.anew()
            return await self._led(lambda: stepper.seek(seconds))
        raise Refused("a step is message, scan, play or seek")

    async def _pause(self, _page: Page, wish: dict[str, Any]) -> Answer:
        if wish.get("on"):
            return await self._led(self.stepper.pause)
        return await self._step(_page, {"what": "play", "rate": 1.0})

    async def _inside(self, _page: Page, wish: dict[str, Any]) -> Answer:
        at = None if wish.get("x") is None else (_number(wish, "x"), _number(wish, "y"))
        name = str(wish.get("stage"))
        return True, "", await run_in_threadpool(self.stepper.look, name, at)

    async def _why(self, _page: Page, wish: dict[str, Any]) -> Answer:
        """Why not there? The planner answers as it does a page of a robot."""
        if not self._feed.located:
            raise Refused("where the robot is is not known yet")
        goal = _number(wish, "x"), _number(wish, "y")
        report = await run_in_threadpool(self.stepper.why, goal, self._feed.place)
        return report.ok, "" if report.ok else words(report.reason, report.detail), route(report)


def _number(wish: dict[str, Any], name: str, low: float = -math.inf, high: float = math.inf) -> float:
    try:
        value = float(wish[name])
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise Refused(f"{name} is a number") from error
    if not (low <= value <= high and math.isfinite(value)):
        raise Refused(f"{name} is {low:g} to {high:g}")
    return value
