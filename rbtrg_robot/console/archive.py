"""Runs on the disk: list, look into, download, keep. All of it blocks, so it runs in worker threads."""

from __future__ import annotations

import asyncio
import json
import re
from functools import partial
from pathlib import Path
from typing import Any

from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import FileResponse, JSONResponse, Response
from starlette.routing import Route

from hal.errors import OperatorError
from hal.regular import is_own
from rbtrg_robot.config import StackConfig
from rbtrg_robot.console.desk import Refused
from rbtrg_robot.console.door import WHO
from rbtrg_robot.log.keep import Run, mark, runs
from rbtrg_robot.log.photos import photos
from rbtrg_robot.log.summary import overview
from rbtrg_robot.topics import Role

LARGEST_BODY = 10_000
"""Bytes."""
ARCHIVE_PATIENCE = 10.0
"""[s] for all of it."""
NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,80}")


class Archive:
    """The folder that this run's folder lies in."""

    def __init__(self, config: StackConfig) -> None:
        self._now = Path(config.log_dir)
        self._base = self._now.parent

    def routes(self) -> list[Route]:
        """Of the server."""
        return [
            Route("/runs", self._runs),
            Route("/runs/{run}", self._run),
            Route("/runs/{run}/keep", self._keep, methods=["POST"]),
            Route("/runs/{run}/photos", self._photos),
            Route("/runs/{run}/photos/{photo}", self._photo),
            Route("/runs/{run}/{file}", self._download),
        ]

    def _row(self, run: Run) -> dict[str, Any]:
        files = sorted(path.name for path in run.folder.glob("*.mcap"))
        return {
            "name": run.folder.name,
            "megabytes": round(run.size / 1e6, 1),
            "kept": run.kept,
            "active": run.active,
            "now": run.folder == self._now,
            "files": files,
        }

    async def _runs(self, _request: Request) -> Response:
        found = await run_in_threadpool(runs, self._base)
        return JSONResponse([self._row(run) for run in reversed(found)])

    def _folder(self, request: Request) -> Path:
        return run_folder(self._base, request.path_params["run"])

    async def _run(self, request: Request) -> Response:
        try:
            summary = await run_in_threadpool(partial(overview, quick=True), self._folder(request))
        except OperatorError as error:
            return JSONResponse({"words": str(error)}, 404)
        topics = [
            {
                "topic": name,
                "count": s.count,
                "rate": round(s.rate, 1),
            }
            for name, s in sorted(summary.topics.items())
        ]
        about = {
            "begin": summary.begin / 1e9,
            "facts": summary.metadata,
            "topics": topics,
            "damage": summary.damage,
            "unfinished": summary.unfinished,
        }
        return JSONResponse(about)

    async def _photos(self, request: Request) -> Response:
        try:
            found = await run_in_threadpool(
                lambda: [(p.name, p.stamp) for p in photos(self._folder(request))]
            )
        except OperatorError as error:
            return JSONResponse({"words": str(error)}, 404)
        return JSONResponse([{"name": name, "stamp": stamp / 1e9} for name, stamp in found])

    async def _photo(self, request: Request) -> Response:
        def wanted() -> bytes | None:
            name = request.path_params["photo"]
            return next((p.jpeg for p in photos(self._folder(request)) if p.name == name), None)

        try:
            jpeg = await run_in_threadpool(wanted)
        except OperatorError as error:
            return JSONResponse({"words": str(error)}, 404)
        if jpeg is None:
            return JSONResponse({"words": "there is no such photo"}, 404)
        return Response(jpeg, media_type="image/jpeg")

    async def _keep(self, request: Request) -> Response:
        try:
            operator(request)
            folder = self._folder(request)
            wish = json.loads(await body_of(request))
            mark(folder, keep=bool(wish["keep"]))
        except OperatorError as error:
            return JSONResponse({"words": str(error)}, 403)
        except (ValueError, KeyError, TypeError, RecursionError):
            return JSONResponse({"words": "say keep: true or false"}, 400)
        return JSONResponse({"words": "stays" if wish["keep"] else "may go when the quota is full"})

    async def _download(self, request: Request) -> Response:
        try:
            path = self._folder(request) / request.path_params["file"]
        except OperatorError as error:
            return JSONResponse({"words": str(error)}, 404)
        if not NAME.fullmatch(path.name) or path.suffix not in (".mcap", ".yaml", ".log") or not is_own(path):
            return JSONResponse({"words": "there is no such file"}, 404)
        return FileResponse(path, filename=f"{path.parent.name}_{path.name}")


def run_folder(base: Path, name: str) -> Path:
    """Of a run by its name. Raises Refused."""
    folder = base / name
    if not NAME.fullmatch(name) or not (folder / "config.yaml").is_file():
        raise Refused("there is no such run")
    return folder


class TooLong(Refused):
    """More was posted than is read."""


async def body_of(request: Request, most: int = LARGEST_BODY) -> bytes:
    """What was posted, up to `most` bytes. Raises Refused."""
    body = b""
    try:
        async with asyncio.timeout(ARCHIVE_PATIENCE):
            async for part in request.stream():
                body += part
                if len(body) > most:
                    raise TooLong("that is too long")
    except TimeoutError as error:
        raise Refused("that takes too long") from error
    return body


def operator(request: Request) -> None:
    """Raises Refused for whoever may only look and stop."""
    if request.scope[WHO].role is not Role.OPERATOR:
        raise Refused("an operator's address lets a browser do that")
