"""A crowd before the console: whoever has shown a cookie stays, a fresh browser comes in, and STOP is served."""

from __future__ import annotations

import contextlib
import http.client
import json
import socket
from pathlib import Path

import pytest
from websockets.exceptions import InvalidStatus
from websockets.sync.client import ClientConnection, connect

from rbtrg_robot.console import archive
from tests.rbtrg_robot.strangers import ended, until
from tools.bench.console.stack import Console


def ask(
    console: Console, path: str, method: str = "GET", body: bytes | None = None, **headers: str
) -> tuple[int, str]:
    host = console.address().split("/")[2]
    client = http.client.HTTPConnection(host, timeout=10)
    client.request(method, path, body, headers={"Host": host, **headers})
    answer = client.getresponse()
    answer.read()
    client.close()
    return answer.status, answer.headers["set-cookie"] or ""


@pytest.fixture
def who(console: Console) -> dict[str, str]:
    cookie = ask(console, "/enter" + console.address().partition("/enter")[2])[1].partition(";")[0]
    return {"Cookie": cookie, "Origin": f"http://{console.address().split('/')[2]}"}


def page(who: dict[str, str]) -> ClientConnection:
    address = who["Origin"].replace("http", "ws") + "/live"
    return connect(address, origin=who["Origin"], additional_headers={"Cookie": who["Cookie"]})  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "says",
    [
        b"",
        b"GET / HTTP/1.1\r\nHost: x",
        b"POST /stop HTTP/1.1\r\nHost: x\r\nContent-Length: 100000\r\n\r\n",
        b"GET /live HTTP/1.1\r\nHost: x\r\nUpgrade: websocket\r\nConnection: upgrade\r\n",
    ],
    ids=["silent", "half a head", "endless body", "half a websocket"],
)
def test_a_flood_of_strangers_keeps_nobody_from_stopping(
    console: Console, who: dict[str, str], says: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert console.serve is not None
    monkeypatch.setattr(console.serve.listener, "strangers", 8)
    host, port = who["Origin"].rpartition("/")[2].split(":")
    with contextlib.ExitStack() as held:
        here = held.enter_context(page(who))
        here.recv()
        strangers = []
        for _ in range(40):
            strangers.append(held.enter_context(socket.create_connection((host, int(port)), timeout=10)))
            strangers[-1].sendall(says)
            strangers[-1].setblocking(False)
        until(lambda: sum(not ended(stranger) for stranger in strangers) <= 8)
        assert ask(console, "/stop", "POST", **who)[0] == 202
        assert ask(console, "/", **who)[0] == 200
        here.send('{"do": ["goal"], "n": 5}')
        answer = json.loads(here.recv()[4:])
        while answer.get("n") != 5:
            answer = json.loads(here.recv()[4:])


def test_too_many_pages_are_refused_but_stop(
    console: Console, who: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert console.serve is not None
    listener = console.serve.listener
    until(lambda: listener.connected == 0)
    monkeypatch.setattr(listener, "guests", 3)
    with page(who), page(who), page(who):
        with pytest.raises(InvalidStatus), page(who):
            pass
        assert ask(console, "/about", **who)[0] == 503
        assert ask(console, "/stop", "POST", **who)[0] == 202
    until(lambda: listener.connected == 0)
    assert ask(console, "/about", **who)[0] == 200


def test_a_body_that_never_ends_is_given_up(
    console: Console, who: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(archive, "ARCHIVE_PATIENCE", 0.05)
    folder = Path(console.config.log_dir).parent / "20260101"
    folder.mkdir(parents=True)
    (folder / "config.yaml").touch()
    host, port = who["Origin"].rpartition("/")[2].split(":")
    with socket.create_connection((host, int(port)), timeout=10) as slow:
        head = f"POST /runs/20260101/keep HTTP/1.1\r\nHost: {host}:{port}\r\nContent-Length: 100\r\n"
        slow.sendall((head + "".join(f"{k}: {v}\r\n" for k, v in who.items()) + "\r\n{").encode())
        said = b""
        while b"takes too long" not in said:
            part = slow.recv(10_000)
            assert part, said
            said += part
