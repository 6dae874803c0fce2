"""Events as HTTP requests to addresses of the configuration, and to no others. A slow or dead one delays nobody."""

from __future__ import annotations

import json
import logging
import queue
import threading
import urllib.request
from collections.abc import Iterable
from http.client import HTTPException
from typing import Any

from hal.errors import one_line
from rbtrg_robot import msg
from rbtrg_robot.process.events import plain

log = logging.getLogger(__name__)

WAITING_EVENTS = 200
"""Events that wait for an address; more are lost, the newest first."""
REQUEST_PATIENCE = 5.0
"""[s] for one request."""
RETRY_TIMES = (1.0, 5.0, 20.0)
"""[s] until a request that failed is tried again."""


class _NoRedirect(urllib.request.HTTPRedirectHandler):
    def redirect_request(self, *_: Any) -> None:
        """Elsewhere is an address of somebody else's choice."""


class Webhook:
    """One address, with a thread of its own."""

    def __init__(self, address: str, robot: str) -> None:
        self._address, self._robot = address, robot
        self._queue: queue.Queue[dict[str, Any]] = queue.Queue(WAITING_EVENTS)
        self._end = threading.Event()
        self._opener = urllib.request.build_opener(_NoRedirect())
        threading.Thread(target=self._run, name="webhook", daemon=True).start()

    def __call__(self, event: msg.Event) -> None:
        """It happened."""
        try:
            self._queue.put_nowait({"robot": self._robot, **plain(event)})
        except queue.Full:
            log.warning("webhook %s: event %d is lost, %d wait", self._address, event.number, WAITING_EVENTS)

    def close(self) -> None:
        """Nothing is sent any more; a request that is under way ends with the process."""
        self._end.set()

    def _run(self) -> None:
        while not self._end.is_set():
            try:
                event = self._queue.get(timeout=0.5)
            except queue.Empty:
                continue
            for pause in (*RETRY_TIMES, 0.0):
                wrong = self._send(event)
                if not wrong or self._end.wait(pause):
                    break
            else:
                log.warning("webhook %s: event %d is lost: %s", self._address, event["number"], wrong)

    def _send(self, event: dict[str, Any]) -> str:
        """Why it did not arrive; empty where it did."""
        request = urllib.request.Request(
            self._address, json.dumps(event).encode(), {"Content-Type": "application/json"}, method="POST"
        )
        try:
            self._opener.open(request, timeout=REQUEST_PATIENCE).close()
        except (
            OSError,
            ValueError,
            HTTPException,
        ) as error:  # HTTPError is an OSError; HTTPException: no HTTP
            return one_line(error)
        return ""


def hooks(addresses: Iterable[str], robot: str) -> list[Webhook]:
    """Of the configuration."""
    return [Webhook(address, robot) for address in addresses]
