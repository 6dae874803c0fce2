"""Requests that wait for their response without blocking: send, poll, time out."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from typing import Any

from hal.types import NS
from hal.unitree.api import MOTION_SWITCHER, SERVICES, MotionSwitcher, Request, Response, compact
from hal.unitree.link import Link

NO_ANSWER = 3104
"""Result code of a request that was not answered in time (the SDK's own code for it)."""

PROMPT_TRIP = 0.1
"""[s]: the longest round trip of a short way; half of the oldest LowState by which the robot drives."""
PROMPT_TRIPS = 3
"""Prompt round trips in a row that show a short way."""


class Rpc:
    """All requests of one client. Owned by one thread."""

    def __init__(self, link: Link) -> None:
        self._link = link
        self._last_id = 0
        self._pending: dict[int, tuple[str, int, int]] = {}
        self._done: dict[int, Response] = {}
        self._answered: deque[int] = deque(maxlen=50)
        self._twice: tuple[int, str] | None = None
        self.late = 0
        """Responses that came after their time was over, or to nobody."""
        self.history: deque[tuple[int, str, int, str]] = deque(maxlen=200)
        """The last requests: now [ns], service, api, parameter."""

    def send(self, service: str, api: int, now: int, **parameter: Any) -> None:
        """Write a request that wants no reply."""
        self._write(service, api, now, parameter, no_reply=True)

    def call(self, service: str, api: int, now: int, timeout: float, parameter: Mapping[str, Any]) -> int:
        """Write a request; `result` with the returned id tells the outcome within `timeout` [s]."""
        identity = self._write(service, api, now, parameter, no_reply=False)
        self._pending[identity] = (service, api, now + round(timeout * NS))
        return identity

    def _write(self, service: str, api: int, now: int, parameter: Mapping[str, Any], no_reply: bool) -> int:
        self._last_id = max(self._last_id + 1, now)
        text = compact(dict(parameter))
        self.history.append((now, service, api, text))
        self._link.send(service, Request(self._last_id, int(api), text, no_reply))
        return self._last_id

    def poll(self, now: int) -> None:
        """Collect responses and time out what waited too long. Call once per tick."""
        for service in SERVICES:
            for response in self._link.responses(service):
                waiting = self._pending.pop(response.id, None)
                if waiting is not None and waiting[0] == service:
                    self._done[response.id] = response
                    self._answered.append(response.id)
                elif response.id in self._answered:
                    self._twice = now, service
                else:
                    self.late += 1
        for identity, (_, api, deadline) in list(self._pending.items()):
            if now >= deadline:
                del self._pending[identity]
                self._done[identity] = Response(identity, api, NO_ANSWER)

    def result(self, identity: int) -> Response | None:
        """The response, once; None while waiting."""
        return self._done.pop(identity, None)

    def several(self, now: int) -> str:
        """The service that answered one request twice within the last second; empty where none did."""
        return self._twice[1] if self._twice is not None and 0 <= now - self._twice[0] < NS else ""

    def forget(self) -> None:
        """Give up all that is pending; its answers will count as late."""
        self._pending.clear()
        self._done.clear()


class Echo:
    """How long a request and its answer take, asked again and again while somebody doubts the way to the robot.

    A message that comes the same way was not delayed by more than that.
    """

    def __init__(self, rpc: Rpc, timeout: float) -> None:
        """timeout [s] of one request."""
        self._rpc, self._timeout = rpc, timeout
        self._asked: tuple[int, int] | None = None
        """Id and time [ns] of the request under way."""
        self._prompt = 0

    def rest(self) -> None:
        """Nobody doubts."""
        self._asked, self._prompt = None, 0

    def prompt(self, now: int) -> bool:
        """Call in every tick, `now` [ns]. Whether the last `PROMPT_TRIPS` round trips took no longer than
        `PROMPT_TRIP`."""
        if self._asked is not None:
            identity, asked = self._asked
            answer = self._rpc.result(identity)
            took = (now - asked) / NS
            if answer is None and took <= self._timeout:
                return False
            quick = answer is not None and answer.code != NO_ANSWER and took <= PROMPT_TRIP
            self._prompt = self._prompt + 1 if quick else 0
        if self._prompt >= PROMPT_TRIPS:
            self.rest()
            return True
        number = MotionSwitcher.CHECK_MODE  # changes nothing
        self._asked = self._rpc.call(MOTION_SWITCHER, number, now, self._timeout, {}), now
        return False
