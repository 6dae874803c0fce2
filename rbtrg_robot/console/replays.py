"""Runs in the page: a run is played under another domain to the pages that ask for it, or stages run on it again.

Who looks at a replay may command nothing but the stop. The replay comes over a bus of its own, from a process that is
never connected to the robot's domain."""

from __future__ import annotations

import asyncio
import json
import logging
import math
import re
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

from starlette.concurrency import run_in_threadpool

from rbtrg_robot.config import StackConfig
from rbtrg_robot.console.archive import run_folder
from rbtrg_robot.console.desk import Answer, Desk, Page, Refused
from rbtrg_robot.console.feed import HEARD, Feed, Slots
from rbtrg_robot.processes import PROCESSES
from rbtrg_robot.scope import Scope
from rbtrg_robot.wire.bus import Bus

DOMAIN_COUNT, DOMAIN_OFFSET = 233, 100
"""ROS domains there are; the replay's is so many farther than the robot's."""
FASTEST_REPLAY = 20.0
PAUSE, GO_ON = b"p", b"g"
"""What a replay reads from its stdin."""
SETTING = re.compile(r"[A-Za-z0-9_.]+=\S+")
STAGES = [row.name for row in PROCESSES if row.hosted]


log = logging.getLogger(__name__)


class Playback:
    """One run that is played, and who looks."""

    def __init__(self, config: StackConfig, loop: asyncio.AbstractEventLoop, run: str) -> None:
        """Blocks until the bus is open. Raises BusError."""
        self.run = run
        self.domain = (config.domain + DOMAIN_OFFSET) % DOMAIN_COUNT
        self._bus = Bus(config.endpoint, "console", Scope(self.domain))
        self.feed = Feed(self._bus, config.capabilities(), loop, replayed=True)
        self._loop = loop
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._turn, name="replay", daemon=True)
        self._bus.subscribe(HEARD)
        self._thread.start()

    def _turn(self) -> None:
        try:
            while not self._end.is_set():
                for received in self._bus.take(0.05):
                    self.feed.take(received)
                self.feed.tick(time.monotonic())
        except Exception:
            log.exception("the replay of %s cannot be shown", self.run)
            wrong = "it cannot be shown; see the log of the console"
            told = {"run": self.run, "state": "ended", "wrong": wrong}
            self._loop.call_soon_threadsafe(self.feed.tell, "replay", told)

    def close(self) -> None:
        """Blocks for a moment."""
        self._end.set()
        self._bus.wake()
        self._thread.join()
        self._bus.close()


class Replays:
    """What pages ask for. Runs in the server's thread."""

    def __init__(self, config: StackConfig, desk: Desk, feed: Feed, loop: asyncio.AbstractEventLoop) -> None:
        self._config, self._feed, self._loop = config, feed, loop
        self._base = Path(config.log_dir).parent
        self._playback: Playback | None = None
        self._children: dict[str, asyncio.subprocess.Process] = {}
        self._tasks: set[asyncio.Task[None]] = set()
        desk.wishes |= {
            "replay": self._replay,
            "pause replay": self._pause,
            "live": self._live,
            "rerun": self._rerun,
        }

    async def _replay(self, page: Page, wish: dict[str, Any]) -> Answer:
        folder = run_folder(self._base, str(wish.get("run")))
        try:
            rate, start = float(wish.get("rate") or 1.0), float(wish.get("start") or 0.0)
        except (TypeError, ValueError, OverflowError) as error:
            raise Refused("speed and start are numbers") from error
        if not (0.05 <= rate <= FASTEST_REPLAY and 0.0 <= start < math.inf):
            raise Refused(f"a replay has a speed of up to {FASTEST_REPLAY:g} and starts at 0 s or later")
        looking = self._looking()
        await self.stop()
        playback = await run_in_threadpool(Playback, self._config, self._loop, folder.name)
        self._playback = playback
        for slots in {page.slots, *looking}:
            self._show(slots, playback.feed, folder.name)
        where = (self._config.endpoint, str(playback.domain), str(folder), str(rate), str(start))
        await self._start("replay", where, lambda line: self._played(playback, line))
        return True, f"replay of {folder.name}", None

    async def _pause(self, page: Page, wish: dict[str, Any]) -> Answer:
        """All pages that look at the replay see it stand, or go on."""
        child = self._children.get("replay")
        if page.slots not in self._looking() or child is None or child.stdin is None:
            raise Refused("no replay is playing")
        child.stdin.write(PAUSE if wish.get("on") else GO_ON)
        return True, "", None

    async def _live(self, page: Page, _wish: dict[str, Any]) -> Answer:
        if page.slots.feed is not self._feed:
            self._show(page.slots, self._feed, "")
        if not self._looking():
            await self.stop()
        return True, "live", None

    def _looking(self) -> frozenset[Slots]:
        return self._playback.feed.looking if self._playback else frozenset()

    def _show(self, slots: Slots, feed: Feed, run: str) -> None:
        """From now on a page sees what this feed hears; the stop and the heartbeat come from the robot all the same."""
        slots.feed.leave(slots)
        slots.clear()
        slots.tell("replay", {"run": run, "state": "playing"})
        feed.join(slots)
        slots.feed = feed
        self._feed.follow(slots, away=bool(run))

    def left(self, page: Page) -> None:
        """A page was closed."""
        page.slots.feed.leave(page.slots)
        self._feed.follow(page.slots, away=False)
        if self._playback and not self._looking():
            task = self._loop.create_task(self.stop())
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)

    def _played(self, playback: Playback, line: dict[str, Any]) -> None:
        state = "ended" if "words" in line or "wrong" in line else "playing"
        playback.feed.tell("replay", {"run": playback.run, "state": state, **line})

    async def stop(self) -> None:
        """The replay ends; whoever looks at it keeps the last picture."""
        playback, self._playback = self._playback, None
        await self._kill("replay")
        if playback is not None:
            await run_in_threadpool(playback.close)

    async def close(self) -> None:
        """The console ends."""
        await self.stop()
        await self._kill("rerun")

    # --- run again --------------------------------------------------------------------------------------------

    async def _rerun(self, _page: Page, wish: dict[str, Any]) -> Answer:
        folder = run_folder(self._base, str(wish.get("run")))
        stages = [name for name in str(wish.get("stages", "")).split(",") if name]
        sets = str(wish.get("sets", "")).split()
        if not stages or not set(stages) <= set(STAGES):
            raise Refused(f"name stages of {', '.join(STAGES)}")
        if wrong := [text for text in sets if not SETTING.fullmatch(text)]:
            raise Refused(f"{wrong[0][:60]!r} is not a.b=c")
        if "rerun" in self._children:
            raise Refused("a run is being run again; wait for its end")
        number = next(k for k in range(1, 1000) if not (self._base / f"{folder.name}_again{k}").exists())
        out = self._base / f"{folder.name}_again{number}"
        about = {"run": folder.name, "out": out.name, "stages": stages, "sets": sets}
        self._feed.tell("job", {**about, "state": "running", "seconds": 0.0})

        def told(line: dict[str, Any]) -> None:
            state = "done" if "words" in line else "failed" if "wrong" in line else "running"
            self._feed.tell("job", {**about, "state": state, **line})

        await self._start("rerun", (str(folder), str(out), ",".join(stages), *sets), told)
        return True, f"{folder.name} is run again", None

    # --- processes --------------------------------------------------------------------------------------------

    async def _start(self, what: str, arguments: tuple[str, ...], told: Any) -> None:
        child = await asyncio.create_subprocess_exec(
            *(sys.executable, "-m", "rbtrg_robot.console.child", what, *arguments),
            stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.PIPE,
        )
        self._children[what] = child
        task = self._loop.create_task(self._read(what, child, told))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _read(self, what: str, child: asyncio.subprocess.Process, told: Any) -> None:
        assert child.stdout is not None
        end: dict[str, Any] = {}
        try:
            async for text in child.stdout:
                line = _said(text)
                if "words" in line or "wrong" in line:
                    end = line  # told when the process is gone: then the next one may begin
                elif line:
                    told(line)
        except Exception:  # a line without end; nobody would wait for the child, and the next one never begin
            log.exception("what the %s says cannot be read or shown", what)
            end = {"wrong": "what it says cannot be read or shown; see the log of the console"}
            with suppress(ProcessLookupError):  # it has ended by itself
                child.kill()
        code = await child.wait()
        if self._children.get(what) is child:
            del self._children[what]
            if not end and code:
                end = {"wrong": f"it ended with status {code}; see the log of the console"}
        if end:
            told(end)

    async def _kill(self, what: str) -> None:
        child = self._children.pop(what, None)
        if child is not None and child.returncode is None:
            child.kill()
            await child.wait()


def _said(text: bytes) -> dict[str, Any]:
    """What a line of a child says; empty where it is none of ours, such as a warning of a library."""
    try:
        line = json.loads(text)
    except (ValueError, RecursionError):
        return {}
    return line if isinstance(line, dict) else {}
