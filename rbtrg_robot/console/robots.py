"""The other robots of this computer: how they are, and the way to their consoles."""

from __future__ import annotations

from typing import Any

from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import JSONResponse, RedirectResponse, Response
from starlette.routing import Route

from rbtrg_robot.console.door import WHO
from rbtrg_robot.orders.words import goal_line, mission_line, robot_line
from rbtrg_robot.process.fleet import statuses
from rbtrg_robot.process.runfiles import console_address, running


def _row(name: str, status: dict[str, Any] | None) -> dict[str, Any]:
    row: dict[str, Any] = {
        "name": name,
        "ready": 0,
        "processes": 0,
        "lines": ["the supervisor does not answer"],
    }
    row["console"] = bool(console_address(name))
    if status is None or "robot" not in status:
        return row
    lines = [make(status["robot"]) for make in (robot_line, goal_line, mission_line)]
    ready = sum(each["state"] == "ready" for each in status["processes"])
    return row | {"ready": ready, "processes": len(status["processes"]), "lines": [x for x in lines if x]}


async def _robots(_request: Request) -> Response:
    found = await run_in_threadpool(statuses)
    return JSONResponse([_row(name, status) for name, status in found.items()])


async def _enter(request: Request) -> Response:
    """To another robot's console, with what this page may do here."""
    name = request.path_params["name"]
    known = await run_in_threadpool(running)
    address = console_address(name, request.scope[WHO].role.value) if name in known else ""
    return RedirectResponse(address, 303) if address else JSONResponse({"words": "it has no console"}, 404)


ROUTES = [Route("/robots", _robots), Route("/robots/{name}", _enter)]
