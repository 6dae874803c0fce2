"""The console without a browser: the guard, the lease, terrain as it is sent, the planner's answer to a question."""

from __future__ import annotations

import asyncio
import http.client
import json
import ssl
import struct
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from hal.types import Capabilities
from mapping.elevation.exchange import MapPatch
from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.access.certificates import KeysError, make_authority
from rbtrg_robot.access.identity import CA, ROBOT, keys_dir
from rbtrg_robot.config import ConfigError, load
from rbtrg_robot.console import door, replays, server
from rbtrg_robot.console.desk import ONLY_SEE
from rbtrg_robot.console.lease import LEASE_TIME, Lease
from rbtrg_robot.console.server import ConsoleError, listening, serving
from rbtrg_robot.console.terrain import HEADER, RISK_LIMIT, TILE_SIDE, Terrain, ground_risk, trust_of
from rbtrg_robot.process.runfiles import RunLock, console_file
from rbtrg_robot.stages.planner import build
from rbtrg_robot.wire.bus import Bus
from rbtrg_robot.wire.convert import patch_msg
from rbtrg_robot.wire.messages import decode, encode
from tests.rbtrg_robot.strangers import until
from tools.bench.console.stack import Console, ground


def get(
    console: Console, path: str, method: str = "GET", **headers: str
) -> tuple[int, dict[str, str], bytes]:
    host = console.address().split("/")[2]
    client = http.client.HTTPConnection(host, timeout=20)
    client.request(method, path, headers={"Host": host, **headers})
    answer = client.getresponse()
    found = answer.status, dict(answer.getheaders()), answer.read()
    client.close()
    return found


def cookie(console: Console, role: str = "operator") -> str:
    status, headers, _ = get(console, "/enter" + console.address(role).partition("/enter")[2])
    assert status == 303
    words = headers["set-cookie"]
    assert "HttpOnly" in words
    assert "SameSite=strict" in words
    return words.partition(";")[0]


def test_an_address_lets_in_once_and_nobody_else_reads_it(console: Console) -> None:
    assert console_file(console.config.robot).stat().st_mode & 0o077 == 0
    path = "/enter" + console.address().partition("/enter")[2]
    assert get(console, path)[0] == 303
    status, _, words = get(console, path)
    assert status == 401
    assert b"was used before" in words
    assert get(console, "/enter?token=")[0] == 401


def test_a_token_that_nobody_used_ends_and_a_fresh_one_lies_ready(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    now = [1000.0]
    monkeypatch.setattr("rbtrg_robot.console.door.time.monotonic", lambda: now[0])
    own = door.Door("a", "http://127.0.0.1:1")

    def token(role: str) -> str:
        return str(json.loads(console_file("a").read_text())[role])

    first = token("operator")
    now[0] += 0.6 * door.TOKEN_LIFE
    own.renew()
    second = token("operator")
    assert second != first
    assert own.enter(token("observer"))
    assert own.enter(first), "its life is not over"
    assert not own.enter(first)
    now[0] += 0.5 * door.TOKEN_LIFE
    own.renew()
    third = token("operator")
    assert third != second, "whoever asks now has half a life"
    assert not own.enter(first)
    now[0] += 0.6 * door.TOKEN_LIFE
    assert not own.enter(second)
    assert own.enter(third)


def test_nothing_is_served_to_who_has_no_cookie(console: Console) -> None:
    for path in ("/", "/about", "/page/main.js", "/runs", "/maps", "/nowhere"):
        status, headers, words = get(console, path)
        assert status == 401, path
        assert b"rbtrg-robot console" in words
        assert "script-src 'self'" in headers["content-security-policy"]
    good = cookie(console)
    assert get(console, "/about", Cookie=good)[0] == 200
    for bad in (good[:-1] + ("0" if good[-1] != "0" else "1"), good.replace("operator", "observer"), "x=y"):
        assert get(console, "/about", Cookie=bad)[0] == 401
    late = good.partition("=")[0] + "=operator.1.00"
    assert get(console, "/about", Cookie=late)[0] == 401


def test_another_page_or_another_name_gets_nothing(console: Console) -> None:
    good = cookie(console)
    host = console.address().split("/")[2]
    ours = f"http://{host}"
    assert get(console, "/stop", "POST", Cookie=good)[0] == 403
    assert get(console, "/stop", "POST", Cookie=good, Origin="http://evil.example")[0] == 403
    assert get(console, "/about", Cookie=good, Origin="null")[0] == 403
    assert get(console, "/about", Cookie=good, Host="evil.example")[0] == 421
    assert get(console, "/stop", "POST", Cookie=good, Origin=ours)[0] == 202
    for headers, origin in (({"Cookie": good}, "http://evil.example"), ({}, ours), ({"Cookie": good}, None)):
        with (
            pytest.raises(InvalidStatus) as refused,
            connect(
                f"ws://{host}/live",
                origin=origin,
                additional_headers=headers,  # type: ignore[arg-type]
            ),
        ):
            pass
        assert refused.value.response.status_code == 403
    with connect(f"ws://{host}/live", origin=ours, additional_headers={"Cookie": good}) as socket:  # type: ignore[arg-type]
        assert json.loads(socket.recv()[4:])["role"] == "operator"
        for text in ("not json", "[]", "[" * 9000):
            socket.send(text)
            assert json.loads(socket.recv()[4:])["words"] == "not a message of this console"
        for text in (
            '{"do": "goal", "x": 1, "y": 1, "name": "\\ud800"}',  # half a character: nothing can send it
            '{"do": "drive", "v": 1' + "0" * 400 + ', "w": 0, "seen": "0"}',
            '{"do": "mission", "what": "skip", "step": 1' + "0" * 30 + "}",
        ):
            socket.send(text)
            assert json.loads(socket.recv()[4:])["words"] == "not a message of this console"
        socket.send('{"do": ["goal"], "n": {}}')
        assert "unknown wish" in json.loads(socket.recv()[4:])["words"]


def test_a_fault_of_the_console_is_told_and_logged(
    console: Console, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def fail(*_: object) -> None:
        raise KeyError("of our own")

    monkeypatch.setattr(console.serve.desk, "do", fail)
    host = console.address().split("/")[2]
    who = {"Cookie": cookie(console), "Origin": f"http://{host}"}
    with connect(f"ws://{host}/live", additional_headers=who) as socket:
        socket.recv()
        socket.send('{"do": "goal"}')
        assert json.loads(socket.recv()[4:])["words"] == "the console failed at this: see its log"
    assert "KeyError: 'of our own'" in caplog.text


def test_what_cannot_be_sent_ends_no_console(console: Console) -> None:
    """Each of these was tried again in the thread that serves STOP, and ended it."""
    who = {"Cookie": cookie(console), "Origin": f"http://{console.address().split('/')[2]}"}
    host = console.address().split("/")[2]
    with connect(
        f"ws://{host}/live", origin=who["Origin"], additional_headers={"Cookie": who["Cookie"]}
    ) as socket:  # type: ignore[arg-type]
        socket.recv()
        socket.send('{"do": "take over", "n": 0}')
        socket.recv()
        for step, words in (("1e999", "a number"), ("5000000000", "no step"), ("-1", "no step")):
            socket.send(f'{{"do": "mission", "what": "skip", "n": 1, "step": {step}}}')
            answer = json.loads(socket.recv()[4:])
            while answer.get("n") != 1:
                answer = json.loads(socket.recv()[4:])
            assert words in answer["words"]
    assert get(console, "/about", **who)[0] == 200


def test_a_long_or_deep_body_is_refused(console: Console) -> None:
    who = {"Cookie": cookie(console), "Origin": f"http://{console.address().split('/')[2]}"}
    folder = Path(console.config.log_dir).parent / "20260101"
    folder.mkdir(parents=True)
    (folder / "config.yaml").touch()
    for body, status in ((b"[" * 9000, 400), (b" " * 20_000, 403), (b'{"keep": true}', 200)):
        client = http.client.HTTPConnection(who["Origin"].partition("//")[2], timeout=20)
        client.request("POST", "/runs/20260101/keep", body, headers=who)
        assert client.getresponse().status == status
        client.close()


def test_an_observer_changes_nothing_on_the_disk(console: Console) -> None:
    who = {"Cookie": cookie(console, "observer"), "Origin": f"http://{console.address().split('/')[2]}"}
    assert get(console, "/maps/yard", "POST", **who)[0] == 403
    assert get(console, "/stop", "POST", **who)[0] == 202


def test_an_observer_is_refused_whatever_moves_the_robot_and_may_stop_it(console: Console) -> None:
    host = console.address().split("/")[2]
    who = cookie(console, "observer")
    with connect(f"ws://{host}/live", origin=f"http://{host}", additional_headers={"Cookie": who}) as socket:  # type: ignore[arg-type]
        socket.recv()
        assert console.serve is not None
        for number, what in enumerate((*console.serve.desk.wishes, "drive", "take over"), 1):
            socket.send(json.dumps({"do": what, "n": number, "x": 1, "y": 1, "v": 0.1, "w": 0, "seen": "0"}))
            answer = json.loads(socket.recv()[4:])
            while answer.get("n") != number:
                answer = json.loads(socket.recv()[4:])
            assert (answer["ok"], answer["words"]) == (False, ONLY_SEE), what
        desk, robot = console.serve.desk, console.robot
        until(lambda: desk.stop_state["state"] != "sending")  # one of before would be this one, too
        stops = robot.stops
        socket.send('{"do": "stop"}')
        until(lambda: robot.stops > stops)


def test_a_cookie_ends(console: Console, monkeypatch: pytest.MonkeyPatch) -> None:
    who = {"Cookie": cookie(console)}
    assert get(console, "/about", **who)[0] == 200
    later = time.time() + door.COOKIE_TIME + 1.0
    monkeypatch.setattr(door, "time", SimpleNamespace(time=lambda: later, monotonic=time.monotonic))
    assert get(console, "/about", **who)[0] == 401
    who["Origin"] = f"http://{console.address().split('/')[2]}"
    assert get(console, "/maps/yard", "POST", **who)[0] == 401
    assert get(console, "/stop", "POST", **who)[0] == 202, "a page that is open stops the robot"


@pytest.mark.parametrize("says", ['{"do": "alive"}', ""], ids=["speaks", "listens"])
def test_an_open_page_ends_with_its_cookie(
    console: Console, monkeypatch: pytest.MonkeyPatch, says: str
) -> None:
    host, who = console.address().split("/")[2], cookie(console)
    with connect(f"ws://{host}/live", origin=f"http://{host}", additional_headers={"Cookie": who}) as socket:  # type: ignore[arg-type]
        socket.recv()
        socket.send('{"do": "see"}')
        later = time.time() + door.COOKIE_TIME + 1.0
        monkeypatch.setattr(door, "time", SimpleNamespace(time=lambda: later, monotonic=time.monotonic))
        if says:
            socket.send(says)
        with pytest.raises(ConnectionClosed):
            list(socket)
        assert (socket.close_code, socket.close_reason) == (door.ENDED, door.OUTSIDE.strip())


@pytest.mark.parametrize("name", ["..", "%2e%2e%2fsecret", ".hidden", "a/b"])
def test_no_path_leads_out_of_the_folder(console: Console, name: str) -> None:
    good = cookie(console)
    for path in (f"/runs/{name}/config.yaml", f"/maps/{name}", f"/page/../{name}", f"/docs/{name}.md"):
        assert get(console, path, Cookie=good)[0] in (404, 405)


def test_no_link_leads_out_of_the_folder(console: Console, tmp_path: Path) -> None:
    """A folder of runs or maps that was unpacked may hold links: an observer would read what they lead to."""
    good = cookie(console, "observer")
    (tmp_path / "key").write_text("secret")
    base = Path(console.config.log_dir).parent
    for name in ("20260102/log_0.mcap", "maps/gone.npz", "maps/key.npz", "missions/key.yaml"):
        (base / name).parent.mkdir(parents=True, exist_ok=True)
        (base / name).symlink_to(tmp_path / ("gone" if "gone" in name else "key"))
    (base / "20260102" / "config.yaml").touch()
    for path in ("/runs/20260102/log_0.mcap", "/maps/key.npz", "/missions/key.yaml"):
        assert get(console, path, Cookie=good)[0] == 404, path
    assert get(console, "/maps", Cookie=good)[::2] == (200, b"[]")
    for name in ("gone", "key"):
        (base / f"maps/{name}.npz").unlink()


def test_a_map_is_saved_and_listed(console: Console) -> None:
    who = {"Cookie": cookie(console), "Origin": f"http://{console.address().split('/')[2]}"}
    status, _, words = get(console, "/maps/yard_1", "POST", **who)
    assert status == 200, words
    assert b"known cells" in words
    assert get(console, "/maps/yard_1", "POST", **who)[0] == 403
    (row,) = json.loads(get(console, "/maps", **who)[2])
    assert row["name"] == "yard_1.npz"
    assert len(get(console, "/maps/yard_1.npz", **who)[2]) > 1000


def test_another_address_needs_keys(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for address in ("0.0.0.0", "::"):
        with pytest.raises(ConfigError, match="name one address"):
            load(None, [f"console.address={address!r}"])
    with pytest.raises(ConsoleError, match=r"console\.address"):
        listening("192.0.2.1", 7480)
    with listening("127.0.0.1", 0) as first, listening("127.0.0.1", first.getsockname()[1]) as second:
        assert second.getsockname()[1] != first.getsockname()[1]


def test_elsewhere_it_serves_over_tls_with_the_keys_of_the_robot_and_not_without(
    console: Console, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    settings = {"console.port": "0", "console.address": "127.0.0.2"}
    config = load(None, [f"{key}={value}" for key, value in settings.items()], robot="tls")
    with pytest.raises(KeysError), serving(config, Bus.__new__(Bus)):
        pass
    make_authority(keys_dir(), 1)
    made = Console(console.robot, tmp_path, "tls", address="127.0.0.2")
    try:
        address = made.address()
        host = address.split("/")[2]
        assert address.startswith("https://127.0.0.2:")
        trust = ssl.create_default_context(cafile=str(keys_dir() / ROBOT / CA))
        trust.check_hostname = False  # the certificate names the robot

        def ask(path: str, **headers: str) -> http.client.HTTPResponse:
            client = http.client.HTTPSConnection(host, timeout=20, context=trust)
            client.request("GET", path, headers=headers)
            return client.getresponse()

        assert ask("/").status == 401
        assert ask("/enter?token=wrong").status == 401
        words = ask("/enter" + address.partition("/enter")[2]).headers["set-cookie"]
        assert {"Secure", "HttpOnly", "SameSite=strict"} <= set(words.split("; "))
        good = words.partition(";")[0]
        assert ask("/about", Cookie=good).status == 200
        way: Any = {"ssl": trust, "origin": f"https://{host}"}
        with pytest.raises(InvalidStatus), connect(f"wss://{host}/live", **way):
            pass
        with connect(f"wss://{host}/live", additional_headers={"Cookie": good}, **way) as socket:
            assert json.loads(socket.recv()[4:])["role"] == "operator"
        plain = http.client.HTTPConnection(host, timeout=20)
        plain.request("GET", "/about", headers={"Cookie": good})
        with pytest.raises((http.client.HTTPException, OSError)):
            plain.getresponse()
    finally:
        made.close()


def test_the_other_robots_of_the_computer_are_told(console: Console) -> None:
    who = {"Cookie": cookie(console), "Origin": f"http://{console.address().split('/')[2]}"}
    assert json.loads(get(console, "/robots", **who)[2]) == []
    lock = RunLock("b")
    try:
        lock.write_state(endpoint=console.config.endpoint, domain=0, ready=True, backend="sim", scene="")
        (row,) = json.loads(get(console, "/robots", **who)[2])
        assert (row["name"], row["console"]) == ("b", False)
        assert get(console, "/robots/b", **who)[0] == 404
        assert get(console, "/robots/b")[0] == 401
    finally:
        lock.release()


def test_the_lease_ends_by_itself_and_is_taken_over_only_on_purpose() -> None:
    lease = Lease()
    assert lease.holder(0.0) == 0
    assert lease.take(1, 10.0)
    assert not lease.take(2, 10.0 + 0.9 * LEASE_TIME)
    assert lease.take(1, 10.0 + 0.9 * LEASE_TIME)
    assert lease.holder(10.0 + 1.8 * LEASE_TIME) == 1
    assert lease.take(2, 11.0, confirmed=True)
    assert not lease.take(1, 11.1)
    lease.give_back(1)
    assert lease.holder(11.2) == 2
    lease.give_back(2)
    assert lease.take(1, 11.3)
    assert lease.holder(11.3 + 1.01 * LEASE_TIME) == 0


def tiles_of(data: bytes) -> dict[tuple[int, int], tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """By row and column: heights [mm], risk, trust."""
    size = HEADER.size + 4 * TILE_SIDE * TILE_SIDE
    found = {}
    for at in range(8, len(data), size):
        row, col = HEADER.unpack_from(data, at)
        body = data[at + HEADER.size : at + size]
        layers = np.frombuffer(body, np.uint8)[2 * TILE_SIDE * TILE_SIDE :].reshape(2, TILE_SIDE, TILE_SIDE)
        found[row, col] = (
            np.frombuffer(body, "<i2", TILE_SIDE * TILE_SIDE).reshape(TILE_SIDE, TILE_SIDE),
            layers[0],
            layers[1],
        )
    return found


def test_ground_that_is_assumed_is_told_apart_from_what_was_seen() -> None:
    source = np.array([[0, 1, 2, 3, 4, 5, np.nan]], np.float32)
    assert trust_of(np.ones_like(source), source).tolist() == [[0, 4, 3, 2, 5, 2, 0]]
    assert trust_of(np.zeros_like(source), source).tolist() == [[0, 1, 1, 1, 5, 1, 0]]


def test_terrain_travels_in_tiles_and_only_where_it_changed() -> None:
    terrain = Terrain(Capabilities("test"))
    patch = ground()
    terrain.take(patch)
    sent: dict[tuple[int, int], int] = {}
    assert terrain.newer(sent, 0.0, 0.0) == b""
    terrain.prepare()
    tiles = tiles_of(terrain.newer(sent, 0.0, 0.0))
    assert terrain.newer(sent, 0.0, 0.0) == b""
    row, col = patch.cell
    height = patch.layers["elevation"]
    for (r, c), (millimetres, _, trust) in tiles.items():
        for dr, dc in ((0, 0), (17, 40), (63, 63)):
            at = (r + dr - row, c + dc - col)
            inside = 0 <= at[0] < height.shape[0] and 0 <= at[1] < height.shape[1]
            want = height[at] if inside else np.nan
            assert millimetres[dr, dc] == (-32768 if np.isnan(want) else pytest.approx(1000 * want, abs=1.0))
            assert (trust[dr, dc] == 0) == np.isnan(want)
    small = {name: layer[:5, :5] for name, layer in patch.layers.items()}
    terrain.take(MapPatch(patch.origin, patch.resolution, 2, 1, small))
    terrain.prepare()
    again = tiles_of(terrain.newer(sent, 0.0, 0.0))
    assert list(again) == [(row // TILE_SIDE * TILE_SIDE, col // TILE_SIDE * TILE_SIDE)]
    terrain.take(MapPatch(patch.origin, patch.resolution, 3, 2, small))
    terrain.prepare()
    anew = terrain.newer(sent, 0.0, 0.0)
    assert struct.unpack_from("<fI", anew) == (pytest.approx(0.04), 1)


def ages_of(data: bytes) -> dict[tuple[int, int], np.ndarray]:
    """By row and column: seconds."""
    size = HEADER.size + TILE_SIDE * TILE_SIDE
    return {
        HEADER.unpack_from(data, at): np.frombuffer(
            data, np.uint8, TILE_SIDE * TILE_SIDE, at + HEADER.size
        ).reshape(TILE_SIDE, TILE_SIDE)
        for at in range(0, len(data), size)
    }


def age_at(tiles: dict[tuple[int, int], np.ndarray], x: float, y: float) -> int:
    row, col = round(y / 0.04), round(x / 0.04)
    return int(
        tiles[row // TILE_SIDE * TILE_SIDE, col // TILE_SIDE * TILE_SIDE][row % TILE_SIDE, col % TILE_SIDE]
    )


def test_every_cell_has_its_age(monkeypatch: pytest.MonkeyPatch) -> None:
    now = 1000.0
    monkeypatch.setattr("rbtrg_robot.console.terrain.time.monotonic", lambda: now)
    terrain = Terrain(Capabilities("test"))
    patch = ground()
    height = patch.layers["elevation"]
    age = np.where(np.isfinite(height), 40.0, np.nan).astype(np.float32)
    terrain.take(MapPatch(patch.origin, patch.resolution, 1, 1, patch.layers | {"age": age}))
    terrain.prepare()
    terrain.newer(known := {}, 0.0, 0.0)
    sent: dict[tuple[int, int], int] = {}
    assert terrain.ages(sent, (), 0.0, 0.0) == b""  # of tiles that the page has
    tiles = ages_of(terrain.ages(sent, known, 0.0, 0.0))
    assert [age_at(tiles, *at) for at in ((1.0, 0.0), (4.6, 0.2), (6.8, -2.6))] == [40, 40, 255]
    now += 5.0
    # The robot stands at (1, 0, 0.4), turned to the left. Of three points one agrees with the ground, one hangs over
    # it, one is beyond.
    points = np.array([[0.2, 0.0, -0.4], [0.6, 0.0, 0.2], [90.0, 0.0, 0.0]], np.float32)
    terrain.look(points, np.array([1.0, 0.0, 0.4]), np.array([0.0, 0.0, 2**-0.5, 2**-0.5]))
    tiles = ages_of(terrain.ages(sent, known, 0.0, 0.0))
    assert len(tiles) == 1
    assert [age_at(tiles, 1.0, 0.2), age_at(tiles, 1.0, 0.6)] == [0, 45]
    # A change that comes without ages: what is higher now was seen now.
    now += 5.0
    small = {name: layer[:5, :5].copy() for name, layer in patch.layers.items()}
    small["elevation"][2, 2] += 0.05
    terrain.take(MapPatch(patch.origin, patch.resolution, 2, 1, small))
    terrain.prepare()
    tiles = ages_of(terrain.ages(sent, known, 0.0, 0.0))
    x, y = patch.origin
    assert [age_at(tiles, x + 0.08, y + 0.08), age_at(tiles, x + 0.12, y + 0.08)] == [0, 50]


def test_ground_risk_is_the_share_of_what_the_robot_drives_over() -> None:
    slope = np.array([0.0, 0.2, 0.4, 0.9, np.nan], np.float32)
    step = np.array([0.0, 0.01, 0.02, 0.05, np.nan], np.float32)
    risk = ground_risk(slope, step, 0.04, 0.4, 0.1)
    assert risk.tolist() == [0, RISK_LIMIT // 2, RISK_LIMIT, RISK_LIMIT // 2, 255]


@pytest.fixture(scope="module")
def planner() -> Any:
    stage = build(load())
    stage.on(t.MAP_STATUS, msg.MapStatus(epoch=1))
    stage.on(t.MAP_UPDATE, patch_msg(ground()))
    return stage


def asked(planner: Any, **goal: Any) -> msg.RouteReport:
    ((topic, report),) = planner.on(t.ROUTE_QUESTION, msg.RouteQuestion(id="q", **goal))
    assert topic is t.ROUTE_REPORT
    again: msg.RouteReport = decode(encode(report), msg.RouteReport)
    return again


def test_a_question_is_answered_with_the_route_and_why(planner: Any) -> None:
    report = asked(planner, goal_x=5.0, goal_y=0.0)
    assert report.ok
    assert report.question
    assert report.length == pytest.approx(5.1, abs=0.3)
    assert report.duration > report.length / 0.6
    assert report.transition_length.sum() == pytest.approx(report.length)
    assert report.transition_cost.sum() == pytest.approx(report.cost)
    worst = int(report.transition_body.argmax())
    assert 1.5 < report.worst_x[worst] < 4.5  # on the ramp or at its edges
    assert report.d_fb[worst] == pytest.approx(0.14, abs=0.04)  # 0.25 of the slope over 0.55 m of the body
    assert np.hypot(report.x[-1] - 5.0, report.y[-1]) < 0.3
    assert np.hypot(np.diff(report.x), np.diff(report.y)).max() < 0.12
    assert report.native_length > 0


def test_a_question_that_has_no_answer_says_why(planner: Any) -> None:
    report = asked(planner, goal_x=3.0, goal_y=2.5)
    assert not report.ok
    assert report.reason == "goal_in_obstacle"


def test_a_question_changes_nothing_of_the_plan_that_is_driven(planner: Any) -> None:
    outputs = dict(
        planner.on(t.PLAN_REQUEST, msg.PlanRequest(goal_id="g", sequence=3, goal_x=1.5, goal_y=0.5))
    )
    assert outputs[t.PLAN].ok
    assert outputs[t.ROUTE_REPORT].id == "g"
    assert not outputs[t.ROUTE_REPORT].question
    path = planner._path
    asked(planner, goal_x=5.0, goal_y=0.0, graph=True)
    asked(planner, goal_x=3.0, goal_y=2.5)
    assert planner._path is path
    (status,) = [m for x, m in planner.tick(10**9) if x is t.ROUTE_STATUS]
    assert (status.goal_id, status.sequence, status.valid) == ("g", 3, True)


def test_the_graph_comes_with_the_answer_when_asked_for(planner: Any) -> None:
    report = asked(planner, goal_x=2.0, goal_y=0.0, graph=True)
    assert len(report.graph_x) > 100
    assert len(report.graph_from) == len(report.graph_to) == len(report.graph_risk)
    assert report.graph_from.max() < len(report.graph_x)
    assert (report.graph_from < report.graph_to).all()
    assert len(asked(planner, goal_x=2.0, goal_y=0.0).graph_x) == 0


def test_a_replay_that_cannot_be_shown_is_told(console: Console, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its thread ended, and the pages saw the last picture for ever."""
    told: list[tuple[str, Any]] = []

    def fails(*_: Any) -> None:
        raise KeyError("of a message that nobody foresaw")

    feed = SimpleNamespace(tick=fails, tell=lambda *what: told.append(what))
    monkeypatch.setattr(replays, "Feed", lambda *_, **__: feed)
    loop: Any = SimpleNamespace(call_soon_threadsafe=lambda call, *what: call(*what))
    playback = replays.Playback(console.config, loop, "yard")
    until(lambda: bool(told))
    playback.close()
    assert told[0][1]["wrong"] == "it cannot be shown; see the log of the console"


def test_a_job_whose_words_cannot_be_shown_is_ended_and_told(console: Console) -> None:
    """Its reader ended unseen, and the console said for ever that a run is being run again."""
    told: list[dict[str, Any]] = []

    def shows(line: dict[str, Any]) -> None:
        told.append(line)
        if "seconds" in line:
            raise KeyError("of a line that nobody foresaw")

    class Child:
        def __init__(self) -> None:
            self.stdout = asyncio.StreamReader()
            self.stdout.feed_data(b'{"seconds": 1.0}\n{"words": "done"}\n')
            self.ended = asyncio.Event()
            self.kill = self.ended.set

        async def wait(self) -> int:
            await self.ended.wait()
            return -9

    async def read() -> None:
        jobs = replays.Replays(
            console.config, SimpleNamespace(wishes={}), SimpleNamespace(), asyncio.get_running_loop()
        )  # type: ignore[arg-type]
        child = jobs._children["rerun"] = Child()  # type: ignore[assignment]
        await asyncio.wait_for(jobs._read("rerun", child, shows), 5.0)  # type: ignore[arg-type]
        assert not jobs._children

    asyncio.run(read())
    assert told[-1] == {"wrong": "what it says cannot be read or shown; see the log of the console"}


def test_a_supervisor_that_answers_nonsense_is_asked_again(
    console: Console, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Its asker ended unseen, and the pages showed what was last heard for ever."""
    monkeypatch.setattr(server, "STATUS_PERIOD", 0.05)
    host = console.address().split("/")[2]
    with connect(
        f"ws://{host}/live", origin=f"http://{host}", additional_headers={"Cookie": cookie(console)}
    ) as socket:  # type: ignore[arg-type]
        socket.send('{"do": "see"}')
        for nonsense in (b"[", b"[]", b'{"robot": 3}'):
            caplog.clear()
            console.robot.status = nonsense
            until(lambda: "the supervisor's status cannot be shown" in caplog.text)
        console.robot.status = b'{"mark": 17}'
        while b'"mark":17' not in socket.recv(5.0):  # type: ignore[operator]
            pass
    console.robot.status = b"{}"
