"""Missions: list the files, look into one, move its places, run it, interrupt it, answer. What touches the disk runs in
worker threads."""

from __future__ import annotations

import json
import math
import re
import uuid
from pathlib import Path
from typing import Any, Literal

from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route

from hal.errors import OperatorError
from hal.regular import is_own
from rbtrg_robot.config import StackConfig
from rbtrg_robot.console.archive import body_of, operator
from rbtrg_robot.console.desk import Answer, Desk, Page, Refused, answer
from rbtrg_robot.console.frames import mission_order
from rbtrg_robot.missions.file import MissionError, MissionFile, dump, load, outing, parse
from rbtrg_robot.orders.mission import TellMission

FOLDER = "missions"
"""Beside the runs."""
LAST_STEP = 1_000_000
LARGEST_MISSION = 100_000
"""Bytes of a mission that is posted."""
NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_ .-]{0,80}\.ya?ml")


class MissionFiles:
    """The YAML files of one folder."""

    def __init__(self, config: StackConfig, desk: Desk) -> None:
        self._desk = desk
        self._folder = Path(config.log_dir).parent / FOLDER
        desk.wishes |= {"mission": self._tell, "explore": self._explore, "cover": self._cover}

    def routes(self) -> list[Route]:
        """Of the server."""
        return [
            Route("/missions", self._list),
            Route("/missions/{file}", self._look),
            Route("/missions/{file}", self._save, methods=["POST"]),
        ]

    def load(self, name: str) -> MissionFile:
        """A file by its name. Raises MissionError."""
        path = self._folder / name
        if not NAME.fullmatch(name) or not is_own(path):
            raise MissionError(f"there is no mission {name[:80]!r} in {self._folder}")
        return load(path)

    async def _tell(self, page: Page, wish: dict[str, Any]) -> Answer:
        """Run one of the files, or tell the mission that is under way."""
        what, owner = str(wish.get("what")), self._desk.owner(page)
        try:
            step = int(wish.get("step") or 0)
        except (TypeError, ValueError, OverflowError) as error:
            raise Refused("a step is a number") from error
        if not 0 <= step <= LAST_STEP:
            raise Refused(f"there is no step {step}")
        if what == "run":
            mission = await run_in_threadpool(self._wanted, wish)
            order = mission.order(uuid.uuid4().hex[:12], start=max(step, 1), owner=owner)
            request = TellMission(what, owner=owner, order=order)
        else:
            told = {name: str(wish.get(name, ""))[:100] for name in ("order_id", "answer")}
            request = TellMission(what, owner=owner, step=step, **told)
        return answer(await self._desk.carry_out(request))

    def _wanted(self, wish: dict[str, Any]) -> MissionFile:
        """The mission itself, or a file's. Raises MissionError."""
        own = wish.get("mission")
        mission = parse(own, "this mission") if own is not None else self.load(str(wish.get("file")))
        return mission.moved(_places(wish))

    async def _save(self, request: Request) -> Response:
        """A file under another name, with places elsewhere."""
        name = request.path_params["file"]
        target = self._folder / name
        try:
            operator(request)
            wish = json.loads(await body_of(request, LARGEST_MISSION))
            if not NAME.fullmatch(name):
                raise Refused("a name has letters, digits, - and _, and ends with .yaml")
            await run_in_threadpool(self._write, target, wish)
        except OperatorError as error:
            return JSONResponse({"words": str(error)}, 403)
        except (ValueError, AttributeError, RecursionError):
            return JSONResponse({"words": "say `file`, and `moved`: rows of step, x and y in metres"}, 400)
        except OSError as error:
            return JSONResponse({"words": f"cannot write into {self._folder}: {error.strerror}"}, 507)
        return JSONResponse({"words": f"saved as {target}"})

    def _write(self, target: Path, wish: dict[str, Any]) -> None:
        text = dump(self._wanted(wish))
        try:
            with target.open("x") as file:
                file.write(text)
        except FileExistsError as error:
            raise Refused(f"{target.name} exists; choose another name") from error

    async def _explore(self, page: Page, wish: dict[str, Any]) -> Answer:
        return await self._go_out("explore", ("area", "minutes", "until"), page, wish)

    async def _cover(self, page: Page, wish: dict[str, Any]) -> Answer:
        return await self._go_out("cover", ("area", "minutes", "swath"), page, wish)

    async def _go_out(
        self, kind: Literal["explore", "cover"], fields: tuple[str, ...], page: Page, wish: dict[str, Any]
    ) -> Answer:
        ground = {key: wish[key] for key in fields if key in wish}
        back, accept = wish.get("back") is not False, wish.get("accept") is True
        owner = self._desk.owner(page)
        order = outing(kind, ground, back=back, accept=accept).order(uuid.uuid4().hex[:12], owner=owner)
        return answer(await self._desk.carry_out(TellMission("run", owner=owner, order=order)))

    def _rows(self) -> list[dict[str, Any]]:
        found = sorted(self._folder.iterdir()) if self._folder.is_dir() else []
        rows = []
        for path in found:
            if not NAME.fullmatch(path.name):
                continue
            row: dict[str, Any] = {"file": path.name, "name": "", "steps": 0, "wrong": ""}
            try:
                order = self.load(path.name).order("")
                row |= {"name": order.name, "steps": len(order.steps)}
            except MissionError as error:
                row["wrong"] = str(error).replace(f"{self._folder}/", "")
            rows.append(row)
        return rows

    async def _list(self, _request: Request) -> Response:
        rows = await run_in_threadpool(self._rows)
        return JSONResponse({"folder": str(self._folder), "missions": rows})

    async def _look(self, request: Request) -> Response:
        try:
            mission = await run_in_threadpool(self.load, request.path_params["file"])
        except MissionError as error:
            return JSONResponse({"words": str(error)}, 404)
        return JSONResponse(mission_order(mission.order("")))


def _places(wish: dict[str, Any]) -> dict[int, tuple[float, float]]:
    """`moved` of a wish: x, y [m] by the number of the step. Raises Refused."""
    try:
        places = {int(step): (float(x), float(y)) for step, x, y in wish.get("moved") or ()}
    except (TypeError, ValueError, OverflowError) as error:
        raise Refused("a place that is moved has the number of its step, x and y in metres") from error
    if not all(math.isfinite(v) for place in places.values() for v in place):
        raise Refused("a place is x and y in metres")
    return places
