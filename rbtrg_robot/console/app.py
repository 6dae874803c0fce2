"""What the server answers: the page, its socket, the stop."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import json
import logging
import time
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import FileResponse, JSONResponse, PlainTextResponse, RedirectResponse, Response
from starlette.routing import Mount, Route, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp
from starlette.websockets import WebSocket, WebSocketDisconnect

from hal.errors import OperatorError
from rbtrg_robot.config import StackConfig
from rbtrg_robot.console import frames, manual, robots
from rbtrg_robot.console.api import Api
from rbtrg_robot.console.archive import Archive
from rbtrg_robot.console.areas import Areas
from rbtrg_robot.console.desk import FAILED, Desk, Page
from rbtrg_robot.console.door import COOKIE_TIME, ENDED, OUTSIDE, STOP, WHO, Door, Guard, Visitor
from rbtrg_robot.console.feed import Feed, Slots
from rbtrg_robot.console.maps import Maps
from rbtrg_robot.console.missions import MissionFiles
from rbtrg_robot.console.replays import Replays
from rbtrg_robot.crowd import CrowdedSocket
from rbtrg_robot.process.runfiles import CONSOLE_ENTER

log = logging.getLogger(__name__)

PAGE = Path(__file__).parent / "page"
MOST_DIGITS = 18
"""Of a whole number."""
BEAT_PERIOD = 0.25
"""[s] between two heartbeats of the server to its pages."""


async def texts(socket: WebSocket) -> AsyncIterator[str]:
    """What a page says, until it closes or sends what is no text."""
    while True:
        event = await socket.receive()
        text = event.get("text")
        if event["type"] != "websocket.receive" or text is None:
            return
        yield text


def _whole(digits: str) -> int:
    if len(digits) > MOST_DIGITS:
        raise ValueError("no field of a message holds it")
    return int(digits)


def wish_in(text: str) -> dict[str, Any]:
    """What a page says. Raises ValueError, RecursionError for what is none: no object, a number that no message holds,
    half a character."""
    wish = json.loads(text, parse_int=_whole)
    if not isinstance(wish, dict):
        raise ValueError("not an object")
    json.dumps(wish, ensure_ascii=False).encode()
    return wish


def facts_of(config: StackConfig) -> dict[str, Any]:
    """What a page asks for first. It makes the scene, which takes too long while people want to stop the robot."""
    robot = config.capabilities()
    scene = config.load_scene() if config.simulated else None
    return {
        "robot": config.robot,
        "backend": config.backend,
        "scene": config.scene if scene else "",
        "accept_risk": config.planner.accept_risk,
        "goals": {name: list(goal) for name, goal in scene.goals.items()} if scene else {},
        "area": config.allowed_area(),
        "keepout": config.keepout,
        "body": [config.body.length, config.body.width],
        "max_vx": robot.max_vx,
        "max_wz": robot.max_wz,
        "max_step": robot.max_step,
        "run": Path(config.log_dir).name if config.record else "",
        "camera": _camera(config),
    }


def _camera(config: StackConfig) -> dict[str, Any] | None:
    """Where the lens is in base_link [m], and its axes (rows right, down, ahead) there; None where there is none."""
    camera = config.camera.mounted()
    if camera is None:
        return None
    return {"name": camera.name, "place": list(camera.mount.translation), "axes": camera.rotation.T.tolist()}


class Site:
    """The routes. Everything here runs in the server's thread."""

    def __init__(
        self,
        config: StackConfig,
        door: Door,
        desk: Desk,
        feed: Feed,
        loop: asyncio.AbstractEventLoop,
        step: list[str] | None = None,
    ) -> None:
        """`step`: stages that are run again on a log here, where there is no robot."""
        self._config = config
        self._facts = {**facts_of(config), "step": step}
        self._door = door
        self._desk = desk
        self._feed = feed
        self.replays = Replays(config, desk, feed, loop)
        self._numbers = itertools.count(1)
        self.frames = self.bytes = 0
        """Sent so far."""

    def app(self, crowd: CrowdedSocket) -> ASGIApp:
        """With the guard around it."""
        routes = [
            Route(CONSOLE_ENTER, self._enter),
            Route("/", self._index),
            Route("/about", self._about),
            Route(STOP, self._stop, methods=["POST"]),
            WebSocketRoute("/live", self._live),
            *Archive(self._config).routes(),
            *Maps(self._config, self._desk).routes(),
            *Areas(self._config, self._desk).routes(),
            *MissionFiles(self._config, self._desk).routes(),
            *robots.ROUTES,
            *manual.ROUTES,
            *Api(self._config.robot, self._desk, self._feed, self._numbers.__next__).routes(),
            Mount("/page", StaticFiles(directory=PAGE)),
        ]
        return Guard(Starlette(routes=routes), self._door, crowd)

    async def beat(self) -> None:
        """Until cancelled: tell all pages four times a second how old what they see is."""
        while True:
            now = time.monotonic()
            self._desk.watch_stop(now)
            self._door.renew()
            holder = self._desk.lease.holder(now)
            content = {"ages": self._feed.ages(), "operator": holder, "pages": self._feed.pages}
            self._feed.tell("beat", content, keep=False)
            await asyncio.sleep(BEAT_PERIOD)

    async def _enter(self, request: Request) -> Response:
        cookie = self._door.enter(request.query_params.get("token", ""))
        if cookie is None:
            return PlainTextResponse(f"This address was used before. {OUTSIDE}", 401)
        answer = RedirectResponse("/", 303)
        answer.set_cookie(
            self._door.cookie,
            cookie,
            max_age=COOKIE_TIME,
            path="/",
            secure=self._door.secure,
            httponly=True,
            samesite="strict",
        )
        return answer

    async def _index(self, _request: Request) -> Response:
        return FileResponse(PAGE / "index.html")

    async def _about(self, request: Request) -> Response:
        return JSONResponse({**self._facts, "role": request.scope[WHO].role.value})

    async def _stop(self, _request: Request) -> Response:
        self._desk.stop()
        return JSONResponse(self._desk.stop_state, 202)

    # --- a page -----------------------------------------------------------------------------------------------

    async def _live(self, socket: WebSocket) -> None:
        await socket.accept()
        who: Visitor = socket.scope[WHO]
        slots = Slots(self._feed)
        page = Page(next(self._numbers), who.role, slots)
        self._desk.alive(page, time.monotonic())
        slots.put("welcome", frames.pack("welcome", {"page": page.number, "role": page.role.value}))
        sender = asyncio.create_task(self._send(socket, slots, who))
        try:
            async for text in texts(socket):
                if who.ended:
                    break
                self._hear(page, slots, text)
        finally:
            self.replays.left(page)
            self._desk.leave(page)
            sender.cancel()
            with contextlib.suppress(asyncio.CancelledError, WebSocketDisconnect, RuntimeError):
                await sender
        if who.ended:
            with contextlib.suppress(WebSocketDisconnect, RuntimeError):  # closed already
                await socket.close(ENDED, OUTSIDE.strip())

    async def _send(self, socket: WebSocket, slots: Slots, who: Visitor) -> None:
        """One frame after the other; while the page is slow, newer frames take the places of older ones. It ends with
        the cookie."""
        while not who.ended:  # a heartbeat comes four times a second
            slots.feed.terrain_for(slots)
            entry = slots.take()
            if entry is None:
                await slots.wake.wait()
                continue
            await socket.send_bytes(entry[1])
            self.frames += 1
            self.bytes += len(entry[1])
        await socket.close(ENDED, OUTSIDE.strip())

    def _hear(self, page: Page, slots: Slots, text: str) -> None:
        number: Any = None

        def reply(ok: bool, words: str, found: dict[str, Any] | None = None) -> None:
            content = {"n": number, "ok": ok, "words": words, "found": found}
            slots.put(f"answer {number}", frames.pack("answer", content))

        try:
            wish = wish_in(text)
        except (ValueError, RecursionError):
            reply(False, "not a message of this console")
            return
        try:
            number = wish.get("n")
            what = wish.get("do")
            if what == "alive":
                self._desk.alive(page, time.monotonic(), wish)
            elif what == "ping":
                reply(True, "")
            elif what == "take over":
                self._desk.take_over(page, time.monotonic())
                reply(True, "this page operates")
            elif what == "see":  # from now on: before, nobody there was ready to take it
                slots.cloud, slots.ages = bool(wish.get("cloud")), bool(wish.get("ages"))
                slots.video = bool(wish.get("video"))
                if not slots.seeing:
                    slots.feed.join(slots)
                    slots.put("stop", frames.pack("stop", self._desk.stop_state))
            else:
                self._desk.do(page, wish, reply)
        except OperatorError as error:
            reply(False, str(error))
        except Exception:
            log.exception("a wish failed: %.200s", text)
            reply(False, FAILED)
