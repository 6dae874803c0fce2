"""The door for programs: what it takes, what it refuses, and that it always answers. The client is that of
`docs/extend.md`."""

from __future__ import annotations

import http.client
import http.server
import json
import math
import socketserver
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from hal.types import NS
from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.config import ConfigError, load
from rbtrg_robot.console.api import CALLS, LARGEST_MISSION, ORDERS
from rbtrg_robot.console.desk import ONLY_SEE, TAKEN, Page
from rbtrg_robot.console.feed import Slots
from rbtrg_robot.console.webhooks import hooks
from rbtrg_robot.log.write import LogWriter
from rbtrg_robot.topics import Role
from rbtrg_robot.wire.messages import encode, header
from tests.places import extension
from tests.rbtrg_robot.strangers import until
from tools.bench.console.stack import Console

PAGES = {"/", "/enter", "/live", "/page", "/robots", "/robots/{name}", "/docs/{name:path}", "/docs/images"}
"""What is served for browsers alone."""


CLIENT: dict[str, Any] = {"__name__": "errand"}
exec(extension("errand"), CLIENT)


class Program:
    """The client of the docs, and a way to post what it would not."""

    def __init__(self, console: Console, role: str = "operator") -> None:
        self.robot = CLIENT["Robot"](console.address(role))
        self.call = self.robot.call
        jar = next(h for h in self.robot.http.handlers if hasattr(h, "cookiejar")).cookiejar
        self.headers = {"Cookie": "; ".join(f"{c.name}={c.value}" for c in jar), "Origin": self.robot.base}

    def post(self, path: str, body: bytes, **headers: str) -> tuple[int, dict[str, Any]]:
        client = http.client.HTTPConnection(self.robot.base.partition("//")[2], timeout=60)
        client.request("POST", path, body, {**self.headers, **headers})
        answer = client.getresponse()
        found = answer.status, json.loads(answer.read())
        client.close()
        return found


@pytest.fixture(scope="module")
def robot(console: Console) -> Program:
    """One program that operates in all tests: no other one is refused its lease of before."""
    return Program(console)


@pytest.fixture(autouse=True)
def _fresh(console: Console, robot: Program) -> None:
    console.robot.reset()
    assert console.serve is not None
    until(lambda: console.serve.desk.stop_state["state"] != "sending")  # type: ignore[union-attr]
    until(lambda: console.serve.feed.known().get("goal", {}).get("state") == "idle")  # type: ignore[union-attr]
    until(lambda: console.serve.feed.located)  # type: ignore[union-attr]
    robot.call("/api/take_over", {})


def test_what_is_served_is_described(console: Console, robot: Program) -> None:
    told = robot.call("/api")
    assert console.serve is not None
    served = {r.path for r in console.serve.site.app(console.serve.listener)._app.routes} - PAGES  # type: ignore[attr-defined]
    assert set(told["paths"]) == served == {call.path for call in CALLS}
    goal = told["components"]["schemas"]["Goal"]
    assert goal["required"] == ["x", "y"]
    assert goal["properties"]["x"]["description"] == "[m]"


def test_a_program_sends_the_robot_and_stops_it(console: Console, robot: Program) -> None:
    plan = robot.call("/api/ask", {"x": 2.0, "y": 0.0})
    assert plan["ok"], plan["words"]
    assert plan["found"]["length"] == pytest.approx(2.0, abs=0.1)
    said = robot.call("/api/goal", {"x": 2.0, "y": 0.0, "name": "there"})
    assert (said["ok"], said["words"]) == (True, "goal moving")
    goal = console.robot.goals[-1]
    assert goal.id == said["found"]["id"]
    assert "(program " in goal.owner
    until(lambda: robot.call("/api/state")["goal"]["id"] == goal.id)
    state = robot.call("/api/state")
    assert state["operator"] == state["program"]
    assert state["ages"]["/robot/state"] < 2.0
    assert robot.call("/api/cancel", {})["words"] == "goal cancelled"
    assert not robot.call("/api/goal", {"x": 1e7, "y": 0.0})["ok"]
    assert robot.call("/stop", {})["state"] == "sending"
    until(lambda: robot.call("/api/state")["stop"]["state"] == "confirmed")
    assert robot.call("/api/resume", {})["ok"]


def test_a_program_runs_missions_and_comes_home(console: Console, robot: Program) -> None:
    until(lambda: robot.call("/api/state")["mission"]["home"] is not None)
    assert robot.call("/api/mission", {"what": "run", "mission": {"name": "own", "steps": [{"wait": 60}]}})[
        "ok"
    ]
    until(lambda: robot.call("/api/state")["mission"]["name"] == "own")
    assert robot.call("/api/mission", {"what": "stop"})["ok"]
    refused = robot.call("/api/mission", {"what": "run", "mission": {"steps": [{"fly": 1}]}})
    assert "a step is one of" in refused["words"]
    assert "no mission 'a.yaml'" in robot.call("/api/mission", {"what": "run", "file": "a.yaml"})["words"]
    assert robot.call("/api/explore", {"area": [[0, 0], [4, 0], [4, 4]], "until": 0.9})["ok"]
    assert [s["step"] for s in robot.call("/api/state")["mission_order"]["steps"]] == ["explore", "home"]
    assert "corners" in robot.call("/api/explore", {"area": [[0, 0], [4, 0]]})["words"]
    assert robot.call("/api/mission", {"what": "stop"})["ok"]
    assert robot.call("/api/cover", {"area": [[0, 0], [4, 0], [4, 4]], "swath": 1.0, "back": False})["ok"]
    assert [s["step"] for s in robot.call("/api/state")["mission_order"]["steps"]] == ["cover"]
    assert robot.call("/api/mission", {"what": "stop"})["ok"]
    assert robot.call("/api/home", {})["ok"]
    assert math.hypot(console.robot.goals[-1].x, console.robot.goals[-1].y) < 0.1


def test_a_program_draws_areas_and_keeps_photos(console: Console, robot: Program) -> None:
    pond = {"name": "pond", "keep_out": True, "corners": [[1.0, 1.0], [2.0, 1.0], [2.0, 2.0]]}
    assert robot.call("/api/areas", {"areas": [pond]})["words"] == "1 keep-out and 0 allowed areas are drawn"
    assert robot.call("/api/state")["areas"] == {"areas": [pond]}
    flat = pond | {"corners": [[1.0, 1.0], [2.0, 2.0], [3.0, 3.0]]}
    status, answer = robot.post("/api/areas", json.dumps({"areas": [flat]}).encode())
    assert (status, answer["words"]) == (409, "the geofence has no area")
    assert robot.call("/api/areas", {"areas": []})["ok"]
    assert robot.call("/api/photo", {})["words"].endswith(".jpg is in the log")
    folder = Path(console.config.log_dir).parent / "shots"
    folder.mkdir(parents=True)
    (folder / "config.yaml").touch()
    with LogWriter(folder / "log_0.mcap", {}) as writer:
        photo = msg.CompressedImage(header=header(5 * NS, ""), data=np.arange(3, dtype=np.uint8))
        writer.write(t.PHOTO, encode(photo), 1, 1, 1)
    assert robot.call("/runs/shots/photos") == [{"name": f"{5 * NS}.jpg", "stamp": 5.0}]
    path = f"{robot.robot.base}/runs/shots/photos/{5 * NS}.jpg"
    assert robot.robot.http.open(path).read() == bytes([0, 1, 2])


def test_a_picture_of_now(robot: Program) -> None:
    with robot.robot.http.open(f"{robot.robot.base}/api/photo", timeout=60) as answer:
        assert answer.read(2) == b"\xff\xd8"
        assert 0.0 <= float(answer.headers["x-age"]) < 5.0


def test_what_happens_is_a_stream_that_can_be_taken_up_again(console: Console, robot: Program) -> None:
    def stream(**headers: str) -> tuple[http.client.HTTPConnection, Any]:
        client = http.client.HTTPConnection(robot.robot.base.partition("//")[2], timeout=20)
        client.request("GET", "/api/events", headers={**robot.headers, **headers})
        return client, client.getresponse()

    def event(answer: Any) -> dict[str, Any]:
        while not (line := answer.readline()).startswith(b"data: "):
            assert line, "the stream ended"
        return dict(json.loads(line.removeprefix(b"data: ")))

    client, answer = stream()
    assert answer.getheader("content-type").startswith("text/event-stream")
    assert answer.readline() == b": alive\n"
    assert robot.call("/api/goal", {"x": 2.0, "y": 0.0})["ok"]
    first = event(answer)
    while first["kind"] != "goal":
        first = event(answer)
    assert first["severity"] == "info"
    client.close()
    robot.call("/stop", {})
    client, answer = stream(**{"Last-Event-ID": str(first["number"])})
    later = event(answer)
    while later["kind"] != "stop":
        assert later["number"] > first["number"]
        later = event(answer)
    assert (later["severity"], later["place"] is not None) == ("error", True)
    client.close()
    client, answer = stream(**{"Last-Event-ID": "-1"})
    assert answer.status == 400
    client.close()
    robot.call("/api/resume", {})


def test_events_are_posted_to_the_addresses_of_the_configuration_and_nowhere_else() -> None:
    asked: list[tuple[str, dict[str, Any]]] = []
    answers = {"/elsewhere": 200, "/moved": 302, "/shy": 500}
    done = threading.Event()

    class Handler(http.server.BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            body = json.loads(self.rfile.read(int(self.headers["content-length"])))
            asked.append((self.path, body))
            status = answers.get(self.path, 200)
            if self.path == "/shy":
                answers["/shy"] = 200
            self.send_response(status)
            self.send_header("Location", "/elsewhere")
            self.end_headers()
            if len({path for path, _ in asked}) == 2 and sum(path == "/shy" for path, _ in asked) == 2:
                done.set()

        do_GET = do_POST

        def log_message(self, *_: Any) -> None:
            """Quiet."""

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        threading.Thread(target=server.serve_forever).start()
        base = f"http://127.0.0.1:{server.server_port}"
        made = hooks((f"{base}/moved", f"{base}/shy"), "rex")
        for hook in made:
            hook(msg.Event(number=7, kind="stop", severity=2, text="e-stop: operator", has_place=True, x=1.0))
        assert done.wait(20.0)
        for hook in made:
            hook.close()
        server.shutdown()
    event = {"robot": "rex", "number": 7, "kind": "stop", "severity": "error", "text": "e-stop: operator"}
    assert all(event.items() <= body.items() for _, body in asked)
    assert "/elsewhere" not in {path for path, _ in asked}
    with pytest.raises(ConfigError, match="webhooks"):
        load(None, ["console.webhooks=[file:///etc/passwd]"])


def test_an_address_that_speaks_no_http_ends_no_webhook(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rbtrg_robot.console.webhooks.RETRY_TIMES", (0.0,))
    heard: list[bytes] = []

    class Handler(socketserver.BaseRequestHandler):
        def handle(self) -> None:
            words = b""
            while not words.endswith(b"}") and (more := self.request.recv(4096)):
                words += more  # head and body may come apart
            heard.append(words)
            self.request.sendall(b"what?\r\n")

    with socketserver.ThreadingTCPServer(("127.0.0.1", 0), Handler) as server:
        threading.Thread(target=server.serve_forever).start()
        (hook,) = hooks((f"http://127.0.0.1:{server.server_address[1]}",), "rex")
        for number in (7, 8):
            hook(msg.Event(number=number, kind="stop", severity=2, text="e-stop: operator"))
        until(lambda: any(b'"number": 8' in words for words in heard))
        hook.close()
        server.shutdown()


def test_one_operates_at_a_time(console: Console, robot: Program) -> None:
    other = Program(console)
    assert console.serve is not None
    assert other.call("/api/take_over", {})["ok"]
    assert other.call("/api/alive", {})["ok"]
    assert robot.call("/api/goal", {"x": 1.0, "y": 0.0})["words"] == TAKEN
    assert not robot.call("/api/alive", {})["ok"]
    assert robot.call("/api/take_over", {})["ok"]
    assert robot.call("/api/goal", {"x": 1.0, "y": 0.0})["ok"]
    page = Page(10_000, Role.OPERATOR, Slots(console.serve.feed))
    with pytest.raises(Exception, match="take over first"):
        console.serve.desk.do(page, {"do": "cancel"}, lambda *_: None)


def test_an_observer_may_look_and_stop(console: Console) -> None:
    robot = Program(console, "observer")
    bodies = {"/api/goal": b'{"x":1,"y":1}', "/api/ask": b'{"x":1,"y":1}', "/api/posture": b'{"what":"sit"}'}
    bodies |= {"/api/pose": b'{"x":1,"y":1,"yaw":0}', "/api/map": b'{"file":"a.npz"}'}
    bodies |= {"/api/mission": b'{"what":"pause"}', "/api/cover": b'{"area":[[0,0],[4,0],[4,4]]}'}
    bodies |= {"/api/areas": b'{"areas":[]}'}
    for path in ORDERS:
        status, answer = robot.post(path, bodies.get(path, b"{}"))
        assert (status, answer["words"]) == (403, ONLY_SEE), path
    assert robot.call("/api/state")["role"] == "observer"
    stops = console.robot.stops
    assert robot.post("/stop", b"junk")[0] == 202
    until(lambda: console.robot.stops > stops)
    assert not console.robot.goals


def test_who_shows_no_cookie_or_comes_from_another_page_is_told_so(console: Console) -> None:
    robot = Program(console)
    for path in ("/api/goal", "/api/nowhere"):
        status, answer = robot.post(path, b'{"x": 1, "y": 1}', Cookie="x=y")
        assert (status, answer["ok"]) == (401, False)
        assert "rbtrg-robot console" in answer["words"]
    assert robot.post("/api/goal", b"{}", Origin="http://evil.example")[0] == 403


NASTY = (
    *(b"not json", b"[]", b"null", b"7", b'"', b"[" * 50_000, b'{"x":' * 9000, b"\xff\xfe", b"\x00"),
    *(b'{"x": 1e999, "y": 0}', b'{"x": NaN, "y": 0}', b'{"x": "1", "y": 2}', b'{"x": true, "y": 2}'),
    *(b'{"x": 1' + b"0" * 5000 + b', "y": 0}', b'{"x": 1, "y": 1, "name": "\\ud800"}', b'{"extra": 1}'),
    *(b'{"what": "run", "mission": {"steps": ' + b'[{"loop": {"times": 2, "steps": ' * 60 + b"[]",),
    *(b'{"what": "run", "file": "../../etc/passwd"}', b'{"what": "run", "file": "\\u0000.yaml"}'),
    *(b'{"file": "\\u0000.npz"}', b'{"what": "skip", "step": -1}', b'{"what": ["run"]}'),
    *(b'{"area": [[1e300, 1e300], [0, 0], [1, 1]]}', b'{"area": ' + b"[" * 300 + b"]" * 300 + b"}"),
)


@pytest.mark.parametrize("path", ORDERS)
def test_whatever_is_sent_is_answered(robot: Program, path: str, caplog: pytest.LogCaptureFixture) -> None:
    for body in NASTY:
        status, answer = robot.post(path, body)
        assert status in (200, 400, 409), (body[:60], status)
        assert answer["words"] or answer["ok"]
        assert "Traceback" not in answer["words"]
        assert len(answer["words"]) < 1000
    assert robot.post(path, b" " * (LARGEST_MISSION + 1))[0] == 413
    assert not [r for r in caplog.records if r.exc_info], "a fault of ours"


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=20),
    lambda inner: (
        st.lists(inner, max_size=4)
        | st.dictionaries(
            st.sampled_from(["x", "y", "yaw", "what", "mission", "steps", "area"]), inner, max_size=4
        )
    ),
    max_leaves=8,
)


@settings(
    max_examples=60,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(st.sampled_from(sorted(ORDERS)), JSON)
def test_no_json_is_a_fault(robot: Program, caplog: pytest.LogCaptureFixture, path: str, value: Any) -> None:
    status, _ = robot.post(path, json.dumps(value).encode())
    assert status in (200, 400, 409)
    assert not [r for r in caplog.records if r.exc_info], "a fault of ours"
