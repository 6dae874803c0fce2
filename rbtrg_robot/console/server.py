"""The console's process: one thread for the bus, one for the server. Its loss stops nothing."""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import ssl
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import uvicorn
from starlette.concurrency import run_in_threadpool

from hal.errors import OperatorError
from rbtrg_robot import topics as t
from rbtrg_robot.access.certificates import check
from rbtrg_robot.access.identity import CERTIFICATE, KEY, ROBOT, keys_dir
from rbtrg_robot.config import StackConfig
from rbtrg_robot.console.app import Site
from rbtrg_robot.console.desk import Desk
from rbtrg_robot.console.door import Door
from rbtrg_robot.console.feed import HEARD, Feed
from rbtrg_robot.console.steps import StepFeed, Steps
from rbtrg_robot.console.webhooks import hooks
from rbtrg_robot.crowd import CrowdedSocket
from rbtrg_robot.topics import Topic
from rbtrg_robot.wire.bus import Bus
from rbtrg_robot.wire.heart import Heart

log = logging.getLogger(__name__)

LARGEST_REQUEST = 16_384
"""Bytes of a message from a page, and of the head of a request."""
TURN_TAKES = 64
"""Connections that are accepted in one turn of the loop."""
MOST_STRANGERS = 400
"""Connections without a cookie. A browser shows its cookie with its first bytes, which are read a few turns of the loop
after it was let in, and each turn lets in as many as TURN_TAKES."""
MOST_GUESTS = 128
"""Connections with one. A page holds one, and up to six more while it loads."""
LOOPBACK = "127.0.0.1"
STATUS_PERIOD, TURN_PERIOD = 1.0, 0.05
"""[s]"""


class ConsoleError(OperatorError):
    """The console cannot serve; the message tells what to do."""


def listening(host: str, port: int) -> CrowdedSocket:
    """A socket on this address; on any free port where that one is taken. Raises ConsoleError."""

    def asks(first: bytes) -> bool:
        """A whole head; over TLS, which is spoken elsewhere, nobody can tell."""
        return b"\r\n\r\n" in first if host == LOOPBACK else first != b""

    for wanted in (port, 0):
        try:
            return CrowdedSocket(host, wanted, strangers=MOST_STRANGERS, guests=MOST_GUESTS, asks=asks)
        except OSError as error:
            if wanted == 0 or host != LOOPBACK:  # elsewhere people wrote the address down
                raise ConsoleError(
                    f"cannot serve on {host} port {wanted}: {error.strerror}; see `console.address`"
                ) from error
    raise AssertionError


def main(
    config: StackConfig, bus: Bus, stopping: Callable[[], bool], _restored: dict[Topic, bytes] | None = None
) -> None:
    """The process, until told to stop. Raises ConsoleError, KeysError."""
    with serving(config, bus) as serve:
        heart = Heart(bus, "console")
        while not stopping() and serve.worker.is_alive():
            heart.beat()
            serve.turn(bus)


@dataclass(frozen=True, slots=True)
class Serving:
    """The parts of a console that serves."""

    desk: Desk
    feed: Feed
    site: Site
    door: Door
    listener: CrowdedSocket
    worker: threading.Thread
    """Of the server."""

    def turn(self, bus: Bus) -> None:
        """Hand on what came, repeat what is due."""
        for received in bus.take(TURN_PERIOD):
            # What is so before the order that it answers: who reads that the stop is confirmed sees it.
            if received.topic in HEARD:
                self.feed.take(received)
            if received.topic in self.desk.HEARS:
                self.desk.take(received)
        self.desk.tick()
        self.feed.tick(time.monotonic())


@contextlib.contextmanager
def serving(config: StackConfig, bus: Bus, lead: tuple[Path, list[str]] | None = None) -> Iterator[Serving]:
    """The server in a thread of its own; its door's address is in the run folder. `lead`: instead of a robot, a run and
    the stages that are run on it again, step by step."""
    host, port = config.console.address, config.console.port
    tls: dict[str, Any] = {}
    if host != LOOPBACK:
        folder = Path(config.network.keys or keys_dir() / ROBOT)
        check(folder)
        tls = {
            "ssl_certfile": folder / CERTIFICATE,
            "ssl_keyfile": folder / KEY,
            "ssl_version": ssl.PROTOCOL_TLS_SERVER,
        }
    listener = listening(host, port)
    name = f"[{host}]" if ":" in host else host
    door = Door(config.robot, f"{'https' if tls else 'http'}://{name}:{listener.getsockname()[1]}")
    loop = asyncio.new_event_loop()
    made = StepFeed if lead else Feed
    feed = made(bus, config.capabilities(), loop, replayed=lead is not None, folder=Path(config.log_dir))
    desk = Desk(config, bus, feed, loop)
    site = Site(config, door, desk, feed, loop, lead[1] if lead else None)
    steps = Steps(*lead, config, desk, feed, loop) if lead and isinstance(feed, StepFeed) else None
    listeners = contextlib.ExitStack()
    for hook in hooks(config.console.webhooks, config.robot):
        listeners.enter_context(feed.listening(t.EVENTS, hook))
        listeners.callback(hook.close)
    bus.subscribe(tuple(dict.fromkeys((*HEARD, *desk.HEARS))))
    server = uvicorn.Server(
        uvicorn.Config(
            site.app(listener),
            log_config=None,
            access_log=False,
            lifespan="off",
            proxy_headers=False,
            server_header=False,
            ws_per_message_deflate=False,
            ws_max_size=LARGEST_REQUEST,
            h11_max_incomplete_event_size=LARGEST_REQUEST,
            http="h11",
            backlog=TURN_TAKES,
            timeout_graceful_shutdown=1,
            **tls,
        )
    )

    async def serve() -> None:
        beat = asyncio.create_task(site.beat())
        try:
            await server.serve([listener])
        finally:
            beat.cancel()
            await site.replays.close()
            if steps is not None:
                await run_in_threadpool(steps.stepper.close)

    ended = threading.Event()

    def ask() -> None:
        """The supervisor, once a second while somebody looks. It may be slow: nobody waits for it."""
        told = False
        while not ended.wait(STATUS_PERIOD):
            try:
                if not told and (events := bus.ask("events", timeout=STATUS_PERIOD)) is not None:
                    told = True
                    feed.remember(json.loads(events))
                answer = bus.ask("status", timeout=STATUS_PERIOD) if feed.pages else None
                if answer is not None:
                    feed.status(answer)
            except Exception:
                log.exception("the supervisor's status cannot be shown")

    asker = threading.Thread(target=ask, name="status", daemon=True)
    if lead is None:  # else there is none
        asker.start()
    failed: list[BaseException] = []

    def thread() -> None:
        try:
            loop.run_until_complete(serve())
        except BaseException as error:  # noqa: BLE001  the other thread ends the process with it
            failed.append(error)

    worker = threading.Thread(target=thread, name="server", daemon=True)
    worker.start()
    log.info("serving %s", door.address)
    try:
        yield Serving(desk, feed, site, door, listener, worker)
    finally:
        ended.set()
        listeners.close()
        if lead is None:
            asker.join(2 * STATUS_PERIOD)
        server.should_exit = True
        worker.join()  # it ends within a second; closing its sockets under it would hit whoever gets their numbers next
        listener.close()
    if failed:
        raise failed[0]
