"""Who comes in: one-time tokens, signed cookies, and one guard over everything that is served.

The tokens lie in the run folder, which only the user who runs `up` can read. Whoever opens an address with a token gets
a cookie, and the token is replaced; one that nobody uses ends after ten minutes. Cookies are signed and outlive a
restart of the process: a page that is open can still stop the robot. They end with the stack, whose supervisor removes
the secret.
"""

from __future__ import annotations

import hashlib
import hmac
import json
import os
import secrets
import time
from dataclasses import dataclass
from typing import Any

from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import cookie_parser
from starlette.responses import JSONResponse, PlainTextResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from rbtrg_robot.crowd import CrowdedSocket
from rbtrg_robot.process.runfiles import CONSOLE_ENTER, console_file
from rbtrg_robot.topics import Role

COOKIE_TIME = 12 * 3600
"""[s] a cookie counts."""
WHO = "rbtrg.who"
"""Key of the visitor in an ASGI scope."""
HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' "
    "data:; connect-src 'self'; "
    "manifest-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}
TOKEN_LIFE = 600.0
"""[s] after which a token that nobody used lets nobody in."""
STOP = "/stop"
"""Where a page stops the robot, however many pages there are."""
API = "/api"
"""Where programs ask for something."""
ENDED = 4401
"""Code with which the socket of a page closes whose cookie has ended."""
OUTSIDE = (
    "Open the address that `rbtrg-robot console` prints on the robot's computer: it lets this browser in.\n"
)


@dataclass(frozen=True, slots=True)
class Visitor:
    """Who a cookie was given to."""

    role: Role
    until: int
    """[s] Unix time when the cookie ends."""
    name: str
    """Of this cookie alone."""

    @property
    def ended(self) -> bool:
        """The cookie has ended: who shows it may stop the robot, and nothing else."""
        return self.until <= time.time()


class Door:
    """Tokens and cookies of one console."""

    def __init__(self, robot: str, address: str) -> None:
        """`address`: scheme://host:port that browsers use. The secret of a console that was killed is taken over."""
        self.address = address
        self.secure = address.startswith("https")
        self.host = address.partition("://")[2]
        self.cookie = f"rbtrg_{self.host.rpartition(':')[2]}"
        self._file = console_file(robot)
        self._secret = self._kept() or secrets.token_hex(32)
        self._tokens: dict[str, tuple[Role, float]] = {}
        """Role and birth [s, monotonic] of each, the newest of a role last."""
        for role in Role:
            self._renew(role)
        self._write()

    def _kept(self) -> str:
        try:
            return str(json.loads(self._file.read_text())["secret"])
        except (OSError, KeyError, json.JSONDecodeError):
            return ""

    def _write(self) -> None:
        tokens = {role.value: token for token, (role, _) in self._tokens.items()}
        content = json.dumps({"address": self.address, "secret": self._secret, **tokens})
        fresh = self._file.with_name(f"{self._file.name}.new")
        fresh.unlink(missing_ok=True)
        with os.fdopen(os.open(fresh, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w") as file:
            file.write(content)
        fresh.replace(self._file)

    def renew(self) -> None:
        """Call now and then: old tokens end, and whoever asks for one gets one that lives for half of its life at
        least."""
        now = time.monotonic()
        kept = {
            token: (role, born) for token, (role, born) in self._tokens.items() if now - born < TOKEN_LIFE
        }
        young = {role for role, born in kept.values() if now - born < TOKEN_LIFE / 2}
        changed = len(kept) < len(self._tokens) or len(young) < len(Role)
        self._tokens = kept
        for role in Role:
            if role not in young:
                self._renew(role)
        if changed:
            self._write()

    def _renew(self, role: Role) -> None:
        self._tokens[secrets.token_urlsafe(24)] = role, time.monotonic()

    def enter(self, token: str) -> str | None:
        """The cookie for a token, which counts no second time; None for a wrong one."""
        self.renew()
        for good, (role, _) in self._tokens.items():
            if hmac.compare_digest(token.encode(), good.encode()):
                del self._tokens[good]
                self._renew(role)
                self._write()
                return self._signed(f"{role.value}.{int(time.time()) + COOKIE_TIME}.{secrets.token_hex(4)}")
        return None

    def _signed(self, text: str) -> str:
        return f"{text}.{hmac.new(self._secret.encode(), text.encode(), hashlib.sha256).hexdigest()}"

    def visitor(self, cookie: str) -> Visitor | None:
        """Whose cookie it is, also one that has ended; None where it is not ours."""
        text = cookie.rpartition(".")[0]
        if text.count(".") != 2 or not hmac.compare_digest(self._signed(text).encode(), cookie.encode()):
            return None
        role, until, name = text.split(".")
        return Visitor(Role(role), int(until), name)

    @property
    def hosts(self) -> tuple[str, ...]:
        """What a browser that means us names in `Host`: a name that was bent to this computer is none of them."""
        if self.host.startswith("127.0.0.1:"):
            return self.host, self.host.replace("127.0.0.1", "localhost")
        return (self.host,)

    @property
    def origins(self) -> tuple[str, ...]:
        """Pages that may ask us for something."""
        scheme = self.address.partition("://")[0]
        return tuple(f"{scheme}://{host}" for host in self.hosts)


class Guard:
    """ASGI: lets through whoever names this host, comes from this page and shows a cookie, over HTTP and WebSocket
    alike."""

    def __init__(self, app: ASGIApp, door: Door, crowd: CrowdedSocket) -> None:
        self._app = app
        self._door = door
        self._crowd = crowd

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """One request or connection."""
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
            return
        status, why = self._refusal(scope)
        if not status:
            await self._app(scope, receive, _with_headers(send))
        elif scope["type"] == "websocket":
            await receive()
            await send({"type": "websocket.close", "code": 4000 + status, "reason": why.strip()})
        else:
            refusal: Response = PlainTextResponse(why, status)
            if scope["path"].startswith(f"{API}/"):
                refusal = JSONResponse({"ok": False, "words": why.strip(), "found": None}, status)
            await refusal(scope, receive, _with_headers(send))

    def _refusal(self, scope: Scope) -> tuple[int, str]:
        """HTTP status and words; 0 where it may pass."""
        headers = Headers(scope=scope)
        if headers.get("host", "") not in self._door.hosts:
            return 421, "This console has another name.\n"
        origin = headers.get("origin")
        must = scope["type"] == "websocket" or scope["method"] not in ("GET", "HEAD")
        if origin not in self._door.origins and (must or origin is not None):
            return 403, "This came from another page.\n"
        if scope["type"] == "http" and scope["path"] == CONSOLE_ENTER and not must:
            return 0, ""
        cookies = cookie_parser(headers.get("cookie", ""))
        who = self._door.visitor(cookies.get(self._door.cookie, ""))
        if who is None or (who.ended and scope["path"] != STOP):
            return 401, OUTSIDE
        scope[WHO] = who
        if not self._crowd.admit(scope["client"]) and scope["path"] != STOP:
            return 503, "Too many pages are open: close some.\n"
        return 0, ""


def _with_headers(send: Send) -> Send:
    async def sending(message: Message) -> None:
        if message["type"] == "http.response.start":
            headers: Any = MutableHeaders(scope=message)
            for name, value in HEADERS.items():
                headers.setdefault(name, value)
        await send(message)

    return sending
