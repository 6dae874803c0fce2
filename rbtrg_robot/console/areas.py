"""Areas drawn on the ground: files beside the runs, as `rbtrg-robot explore --area FILE` reads them; and the areas
that the robot stays in and keeps out of."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import yaml
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route

from hal.errors import OperatorError
from hal.regular import is_own
from hal.safety.geofence import Geofence
from rbtrg_robot import yaml_file
from rbtrg_robot.areas import of_rows
from rbtrg_robot.config import StackConfig
from rbtrg_robot.console.archive import NAME, body_of, operator
from rbtrg_robot.console.desk import Answer, Desk, Page, Refused, answer
from rbtrg_robot.orders.areas import SetAreas
from rbtrg_robot.yaml_file import YamlError

AREAS = "areas"
"""Folder beside the runs."""


class Areas:
    """The folder."""

    def __init__(self, config: StackConfig, desk: Desk) -> None:
        self._folder = Path(config.log_dir).parent / AREAS
        self._desk = desk
        desk.wishes["areas"] = self._draw

    def routes(self) -> list[Route]:
        """Of the server."""
        return [Route("/areas", self._list), Route("/areas/{name}", self._save, methods=["POST"])]

    async def _draw(self, _page: Page, wish: dict[str, Any]) -> Answer:
        return answer(await self._desk.carry_out(SetAreas(of_rows(wish.get("areas")))))

    def _read(self) -> list[dict[str, Any]]:
        """Name and corners x, y [m] in `map` of every file that holds an area."""
        found = []
        for path in sorted(filter(is_own, self._folder.glob("*.yaml"))):
            try:
                corners = Geofence.of(yaml_file.read(path)).corners
            except (OSError, YamlError, OperatorError, TypeError):
                continue  # of somebody else
            found.append({"name": path.stem, "corners": corners})
        return found

    async def _list(self, _request: Request) -> Response:
        return JSONResponse(await run_in_threadpool(self._read))

    async def _save(self, request: Request) -> Response:
        name = request.path_params["name"]
        try:
            operator(request)
            target = self._folder / f"{name}.yaml"
            if not NAME.fullmatch(name):
                raise Refused("a name has letters, digits, - and _")
            if target.exists():
                raise Refused(f"{target.name} exists; choose another name")
            corners = Geofence.of(json.loads(await body_of(request))["corners"]).corners
            self._folder.mkdir(parents=True, exist_ok=True)
            with target.open("x") as file:
                yaml.safe_dump([list(corner) for corner in corners], file, default_flow_style=None)
        except OperatorError as error:
            return JSONResponse({"words": str(error)}, 403)
        except (ValueError, KeyError, TypeError, RecursionError):
            return JSONResponse({"words": "an area is a list of corners x, y in metres"}, 400)
        except OSError as error:
            return JSONResponse({"words": f"cannot write into {self._folder}: {error.strerror}"}, 507)
        return JSONResponse({"words": f"{len(corners)} corners in {target}"})
