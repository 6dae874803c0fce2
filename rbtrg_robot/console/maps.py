"""Maps on the disk beside the runs: list, download, save the present one, load one; and where the robot stands on
it."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import FileResponse, JSONResponse, Response
from starlette.routing import Route

from hal.errors import OperatorError
from hal.regular import is_own
from rbtrg_robot.config import StackConfig
from rbtrg_robot.console.archive import NAME, operator
from rbtrg_robot.console.desk import Answer, Desk, Page, Refused, answer
from rbtrg_robot.orders.map import FetchMap, LoadMap, read, save
from rbtrg_robot.orders.pose import SetPose

MAPS = "maps"
"""Folder beside the runs."""


class Maps:
    """The folder, and what pages ask for."""

    def __init__(self, config: StackConfig, desk: Desk) -> None:
        self._config = config
        self._desk = desk
        self._folder = Path(config.log_dir).parent / MAPS
        desk.wishes |= {"load map": self._load, "set pose": self._set_pose}

    def routes(self) -> list[Route]:
        """Of the server."""
        return [
            Route("/maps", self._list),
            Route("/maps/{file}", self._map),
            Route("/maps/{file}", self._save, methods=["POST"]),
        ]

    def _path(self, name: str) -> Path:
        path = self._folder / name
        if not NAME.fullmatch(name) or path.suffix != ".npz" or not is_own(path):
            raise Refused("there is no such map")
        return path

    async def _list(self, _request: Request) -> Response:
        found = sorted(filter(is_own, self._folder.glob("*.npz")))
        return JSONResponse(
            [{"name": x.name, "megabytes": round(x.stat().st_size / 1e6, 2), "path": str(x)} for x in found]
        )

    async def _map(self, request: Request) -> Response:
        try:
            path = self._path(request.path_params["file"])
        except OperatorError as error:
            return JSONResponse({"words": str(error)}, 404)
        return FileResponse(path, filename=path.name)

    async def _save(self, request: Request) -> Response:
        name = request.path_params["file"]
        try:
            operator(request)
            if not NAME.fullmatch(name):
                raise Refused("a name has letters, digits, - and _")
            target = self._folder / f"{name.removesuffix('.npz')}.npz"
            if target.exists():
                raise Refused(f"{target.name} exists; choose another name")
            self._folder.mkdir(parents=True, exist_ok=True)
            order = FetchMap()
            outcome = await self._desk.carry_out(order)
            if not order.patches:
                raise Refused(outcome.words)
            known = await run_in_threadpool(save, order.patches, order.cloud, target, None, order.areas)
        except OperatorError as error:
            return JSONResponse({"words": str(error)}, 403)
        except OSError as error:
            return JSONResponse({"words": f"cannot write into {self._folder}: {error.strerror}"}, 507)
        return JSONResponse({"words": f"{known} known cells in {target.name}; `up --map {target}` loads it"})

    async def _load(self, _page: Page, wish: dict[str, Any]) -> Answer:
        self._desk.only_standing("a map is loaded")
        path = self._path(str(wish.get("file")))
        prior = await run_in_threadpool(read, path, self._config.elevation)
        self._desk.only_standing("a map is loaded")
        outcome = await self._desk.carry_out(LoadMap(prior))
        return outcome.ok, f"{path.name}: {outcome.words}", None

    async def _set_pose(self, _page: Page, wish: dict[str, Any]) -> Answer:
        self._desk.only_standing("a pose is set")
        try:
            x, y, yaw = (float(wish[name]) for name in ("x", "y", "yaw"))
        except (KeyError, TypeError, ValueError) as error:
            raise Refused("a pose is x, y in metres and a heading") from error
        if not all(map(math.isfinite, (x, y, yaw))):
            raise Refused("a pose is finite")
        return answer(await self._desk.carry_out(SetPose(x, y, yaw)))
