"""The door for programs: what pages ask for as HTTP and JSON, described at `/api` (OpenAPI 3.1).

A program comes in as a browser does, by an address with a token, and shows the cookie and the `Origin`. Its orders are
the page's wishes: the desk judges role and lease, and hands them to the same orders. Nothing else reaches the robot.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import re
import time
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError
from pydantic.json_schema import models_json_schema
from starlette.requests import Request
from starlette.responses import JSONResponse, Response, StreamingResponse
from starlette.routing import Route

from hal.errors import OperatorError
from hal.types import NS
from rbtrg_robot import __version__, msg
from rbtrg_robot import topics as t
from rbtrg_robot.console.archive import TooLong, body_of
from rbtrg_robot.console.desk import FAILED, ONLY_SEE, Answer, Desk, Page, Refused
from rbtrg_robot.console.door import STOP, WHO, Visitor
from rbtrg_robot.console.feed import Feed, Slots
from rbtrg_robot.console.frames import finite
from rbtrg_robot.console.missions import LARGEST_MISSION, LAST_STEP
from rbtrg_robot.topics import Role
from rbtrg_robot.wire.messages import stamp_of

log = logging.getLogger(__name__)

STATE = ("robot", "goal", "mission", "mission_order", "map", "pose", "route", "areas", "stop")
"""Kinds of the page's frames that are kept while nobody looks."""
ALIVE_PERIOD = 2.0
"""[s] between two signs of life on a stream of events."""
ASK_AGAIN, PICTURE_PATIENCE = 1.0, 15.0
"""[s] between two requests for a picture, and for all of them: the camera's process loads what it needs with the first.
"""


class _Body(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, strict=True)


class Nothing(_Body):
    """No fields."""


class Place(_Body):
    """A place in frame `map`."""

    x: float = Field(description="[m]")
    y: float = Field(description="[m]")
    yaw: float | None = Field(None, description="heading [rad]; null = any")


class Goal(Place):
    """A place to drive to."""

    name: str = Field("", max_length=64)
    accept: bool = Field(False, description="drive although the way is likely to fail")
    no_return: bool = Field(False, description="stay out although the battery is needed for the way home")


class Stance(_Body):
    """What the robot does with its legs."""

    what: Literal["stand", "sit", "damp", "recover"]


class Mission(_Body):
    """What the mission process is told. `run` needs `file` or `mission`, `answer` needs `answer`."""

    what: Literal["run", "pause", "resume", "skip", "stop", "answer"]
    file: str = Field("", max_length=100, description="of GET /missions")
    mission: dict[str, Any] | None = Field(
        None, description="a mission itself, as `rbtrg-robot mission schema` says"
    )
    step: int = Field(
        0, ge=0, le=LAST_STEP, description="`run`: the first step; else: only if it is this one"
    )
    order_id: str = Field("", max_length=100, description="only if it is this mission; empty = any")
    answer: str = Field("", max_length=100)
    moved: list[tuple[int, float, float]] = Field(
        [], max_length=1000, description="`run`: steps that go elsewhere; number of a `goto`, x, y [m]"
    )


class Moved(_Body):
    """A mission file with places elsewhere."""

    file: str = Field(max_length=100, description="of GET /missions")
    moved: list[tuple[int, float, float]] = Field(
        [], max_length=1000, description="number of a `goto`, x, y [m]"
    )


class Ground(_Body):
    """What to explore."""

    area: list[tuple[float, float]] = Field(
        [], max_length=100, description="corners x, y [m]; empty = all that can be reached"
    )
    minutes: float = Field(0.0, ge=0.0, le=1440.0, description="0 = no limit")
    until: float = Field(0.0, ge=0.0, le=1.0, description="share of the area; 0 = all of it")
    back: bool = Field(True, description="come home at the end")
    accept: bool = Field(False, description="come home although the way is likely to fail")


class Lanes(_Body):
    """What to drive over in lanes."""

    area: list[tuple[float, float]] = Field(min_length=3, max_length=100, description="corners x, y [m]")
    swath: float = Field(2.0, ge=0.3, le=50.0, description="from one lane to the next [m]")
    minutes: float = Field(0.0, ge=0.0, le=1440.0, description="0 = no limit")
    back: bool = Field(True, description="come home at the end")
    accept: bool = Field(False, description="come home although the way is likely to fail")


class MapName(_Body):
    """A saved map."""

    file: str = Field(max_length=100, description="of GET /maps")


class Pose(_Body):
    """Where the robot stands in frame `map`."""

    x: float = Field(description="[m]")
    y: float = Field(description="[m]")
    yaw: float = Field(description="[rad]")


class Alive(_Body):
    """A sign of life of whoever operates."""

    watched: bool = Field(False, description="an operator is there: contact with the mission")


class Area(_Body):
    """An area."""

    corners: list[tuple[float, float]] = Field(min_length=3, description="x, y [m] in frame `map`")


class Drawn(_Body):
    """An area that counts."""

    name: str = Field(min_length=1, max_length=64)
    keep_out: bool = Field(description="the robot stays out of it; else inside")
    corners: list[tuple[float, float]] = Field(
        min_length=3, max_length=100, description="x, y [m] in frame `map`"
    )


class Fence(_Body):
    """All areas that count from now on, beside those of the configuration."""

    areas: list[Drawn] = Field(max_length=50)


class Keep(_Body):
    """Whether a run stays on the disk."""

    keep: bool


@dataclass(frozen=True, slots=True)
class Call:
    """One path, as it is described."""

    method: str
    path: str
    words: str
    body: type[_Body] | None = None
    media: str = "application/json"
    """Of a good answer."""
    wish: str = ""
    """What the desk is asked for; empty where the path is served elsewhere."""


CALLS = (
    Call("GET", "/api", "This description."),
    Call("GET", "/api/state", "The newest word of each part, and how old each topic is [s]."),
    Call("GET", "/api/photo", "A picture of now. Header `x-age`: seconds since its exposure.", media="image/jpeg"),
    Call("GET", "/api/events", "What happens, as a stream (SSE): the id counts up, `Last-Event-ID` tells the "
        "newest that is known; without it those from now on.", media="text/event-stream"),
    Call("POST", STOP, "The emergency stop, for every role. `state` of GET /api/state tells when the robot confirms."),
    Call("POST", "/api/goal", "Drive to a place; answers once the robot moves or why not. `found.id` names "
        "the goal.", Goal, wish="goal"),
    Call("POST", "/api/ask", "How would it go? The planner answers, nothing moves.", Place, wish="ask"),
    Call("POST", "/api/cancel", "Cancel the goal.", Nothing, wish="cancel"),
    Call("POST", "/api/resume", "Release the stop.", Nothing, wish="resume"),
    Call("POST", "/api/posture", "Stand, sit, damp or recover.", Stance, wish="posture"),
    Call("POST", "/api/photo", "Keep the next frame of the camera as a photo in the log.", Nothing, wish="photo"),
    Call("POST", "/api/home", "Drive home.", Nothing, wish="home"),
    Call("POST", "/api/explore", "See all ground of an area: a mission of its own.", Ground, wish="explore"),
    Call("POST", "/api/cover", "Drive over an area in lanes: a mission of its own.", Lanes, wish="cover"),
    Call("POST", "/api/mission", "Run a mission, or tell the one that is under way.", Mission, wish="mission"),
    Call("POST", "/api/areas", "Where the robot stays in and keeps out of from now on. `areas` of GET "
        "/api/state tells.", Fence, wish="areas"),
    Call("POST", "/api/map", "Begin anew with a saved map.", MapName, wish="load map"),
    Call("POST", "/api/pose", "The robot stands there.", Pose, wish="set pose"),
    Call("POST", "/api/alive", "Go on operating: the lease ends after 2 s without a call.", Alive, wish="alive"),
    Call("POST", "/api/take_over", "Operate in place of whoever does.", Nothing, wish="take over"),
    Call("GET", "/about", "The robot, its scene, its limits."),
    Call("GET", "/missions", "The mission files."),
    Call("GET", "/missions/{file}", "The steps of one."),
    Call("POST", "/missions/{file}", "Save one under this name, with places elsewhere.", Moved),
    Call("GET", "/areas", "The saved areas."),
    Call("POST", "/areas/{name}", "Save an area under this name.", Area),
    Call("GET", "/maps", "The saved maps."),
    Call("GET", "/maps/{file}", "One of them.", media="application/octet-stream"),
    Call("POST", "/maps/{file}", "Save the present map under this name.", Nothing),
    Call("GET", "/runs", "The runs on the disk, the newest first."),
    Call("GET", "/runs/{run}", "What one holds."),
    Call("POST", "/runs/{run}/keep", "Keep it, or not.", Keep),
    Call("GET", "/runs/{run}/photos", "Its photos: name, and time of exposure [s]."),
    Call("GET", "/runs/{run}/photos/{photo}", "One of them.", media="image/jpeg"),
    Call("GET", "/runs/{run}/{file}", "A file of it.", media="application/octet-stream"),
)  # fmt: skip
"""Everything a program may ask for."""
ORDERS = {call.path: call for call in CALLS if call.wish}


def description(robot: str) -> dict[str, Any]:
    """OpenAPI 3.1."""
    bodies = sorted({call.body for call in CALLS if call.body}, key=lambda body: body.__name__)
    _, schemas = models_json_schema(
        [(body, "validation") for body in bodies], ref_template="#/components/schemas/{model}"
    )
    answer = {
        "type": "object",
        "properties": {
            "ok": {"type": "boolean"},
            "words": {"type": "string"},
            "found": {"type": ["object", "null"]},
        },
    }
    paths: dict[str, dict[str, Any]] = {}
    for call in CALLS:
        shape = {"$ref": "#/components/schemas/Answer"} if call.wish else {}
        told: dict[str, Any] = {
            "summary": call.words,
            "responses": {
                "200": {"description": "done", "content": {call.media: {"schema": shape}}},
                "4XX": {"description": "not done; `words` or the text tells why"},
            },
        }
        if names := re.findall(r"{(\w+)}", call.path):
            place = {"in": "path", "required": True, "schema": {"type": "string"}}
            told["parameters"] = [{"name": name, **place} for name in names]
        if call.body is not None:
            shape = {"$ref": f"#/components/schemas/{call.body.__name__}"}
            told["requestBody"] = {"content": {"application/json": {"schema": shape}}}
        paths.setdefault(call.path, {})[call.method.lower()] = told
    return {
        "openapi": "3.1.0",
        "info": {"title": f"rbtrg-robot: {robot}", "version": __version__},
        "paths": paths,
        "components": {"schemas": {**schemas["$defs"], "Answer": answer}},
    }


def _said(status: int, words: str, found: dict[str, Any] | None = None) -> JSONResponse:
    return JSONResponse({"ok": status == 200, "words": words, "found": found}, status)


def _wrong(error: ValidationError) -> str:
    first = error.errors(include_url=False, include_input=False, include_context=False)[0]
    return ": ".join(filter(None, (".".join(str(part) for part in first["loc"])[:200], first["msg"])))


class Api:
    """The routes of programs. Runs in the server's thread."""

    def __init__(self, robot: str, desk: Desk, feed: Feed, number: Callable[[], int]) -> None:
        """`number`: of the next page; a program is one to the desk."""
        self._robot, self._desk, self._feed, self._number = robot, desk, feed, number
        self._programs: dict[Visitor, Page] = {}

    def routes(self) -> list[Route]:
        """Of the server."""
        return [
            Route("/api", self._describe),
            Route("/api/state", self._state),
            Route("/api/photo", self._photo),
            Route("/api/events", self._events),
            *(Route(path, self._order, methods=["POST"]) for path in ORDERS),
        ]

    def _page(self, request: Request) -> Page:
        """The program as the desk knows it, the same for all that shows one cookie."""
        who: Visitor = request.scope[WHO]
        if who not in self._programs:
            self._programs = {past: page for past, page in self._programs.items() if not past.ended}
            self._programs[who] = Page(self._number(), who.role, Slots(self._feed), "program")
        return self._programs[who]

    async def _describe(self, _request: Request) -> Response:
        return JSONResponse(description(self._robot))

    async def _state(self, request: Request) -> Response:
        known = self._feed.known()
        page = self._page(request)
        content = {
            "program": page.number,
            "role": page.role.value,
            "operator": self._desk.lease.holder(time.monotonic()),
            "ages": self._feed.ages(),
        }
        return JSONResponse(content | {kind: known[kind] for kind in STATE if kind in known})

    async def _events(self, request: Request) -> Response:
        known = request.headers.get("last-event-id", "")
        if known and not (known.isascii() and known.isdigit() and len(known) < 12):
            return _said(400, "Last-Event-ID is the id of an event")
        newest = max((event["number"] for event in self._feed.events), default=0)
        told = int(known) if known else newest
        told = told if told <= newest else 0  # of a stack before this one
        return StreamingResponse(self._stream(request.scope[WHO], told), media_type="text/event-stream")

    async def _stream(self, who: Visitor, told: int) -> AsyncIterator[str]:
        """Events after number `told`, until the cookie ends. What a slow program misses it asks for again."""
        came = asyncio.Event()
        with self._feed.listening(t.EVENTS, lambda _: came.set()):
            while not who.ended:
                newer = [event for event in self._feed.events if event["number"] > told]
                for event in newer:
                    told = event["number"]
                    yield f"id: {told}\ndata: {json.dumps(event)}\n\n"
                if not newer:
                    yield ": alive\n\n"  # also finds out that nobody listens
                came.clear()
                with contextlib.suppress(TimeoutError):
                    await asyncio.wait_for(came.wait(), ALIVE_PERIOD)

    async def _photo(self, _request: Request) -> Response:
        taken: asyncio.Future[msg.CompressedImage] = asyncio.get_running_loop().create_future()

        def hear(message: msg.CompressedImage) -> None:
            if not taken.done():
                taken.set_result(message)

        with self._feed.listening(t.CAMERA, hear):
            deadline = time.monotonic() + PICTURE_PATIENCE
            while not taken.done() and time.monotonic() < deadline:
                self._feed.film()
                await asyncio.wait([taken], timeout=ASK_AGAIN)
        if not taken.done():
            return _said(503, "the camera gives no picture; see `rbtrg-robot status`")
        message = taken.result()
        headers = {"x-age": f"{self._feed.age(message):.3f}", "x-stamp": f"{stamp_of(message) / NS:.9f}"}
        return Response(message.data.tobytes(), 200, headers, "image/jpeg")

    async def _order(self, request: Request) -> Response:
        """One wish of a program: always an answer."""
        call = ORDERS[request.url.path]
        assert call.body is not None
        page = self._page(request)
        try:
            body = call.body.model_validate_json(await body_of(request, LARGEST_MISSION) or b"{}")
            ok, words, found = await self._granted(page, call.wish, body.model_dump())
        except TooLong as error:
            return _said(413, str(error))
        except ValidationError as error:
            return _said(400, _wrong(error))
        except OperatorError as error:
            return _said(409 if page.role is Role.OPERATOR else 403, str(error))
        except Exception:
            log.exception("a program's wish failed: %s", call.path)
            return _said(500, FAILED)
        return _said(200 if ok else 409, words, found)

    async def _granted(self, page: Page, what: str, fields: dict[str, Any]) -> Answer:
        if what == "alive":
            if page.role is not Role.OPERATOR:
                raise Refused(ONLY_SEE)
            self._desk.alive(page, time.monotonic(), fields)
            operates = self._desk.lease.holder(time.monotonic()) == page.number
            return operates, "this program operates" if operates else "another one operates", None
        if what == "take over":
            self._desk.take_over(page, time.monotonic())
            return True, "this program operates", None
        done: asyncio.Future[Answer] = asyncio.get_running_loop().create_future()

        def reply(ok: bool, words: str, found: dict[str, Any] | None) -> None:
            done.set_result((ok, words, finite(found)))

        self._desk.do(page, {"do": what, **fields}, reply)
        return await done
