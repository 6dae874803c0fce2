"""Fetching a public policy from a server of this computer: whole and checked, or nothing and one line."""

from __future__ import annotations

import hashlib
import threading
from collections.abc import Iterator
from dataclasses import replace
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest
from typer.testing import CliRunner

from hal.robots.go2w.locomotion import public
from hal.robots.go2w.locomotion.controllers import OURS, controller_of, policy_of
from hal.robots.go2w.locomotion.policy import PolicyError
from rbtrg_robot.cli.main import app
from tests.places import POLICY, needs_shared

FILES = {"LICENSE": b"Do what is right.", "a/config.yaml": b"x: 1\n", "a/policy.pt": b"weights" * 1000}


class Server:
    """Serves `files`; `cut` is sent only in part."""

    def __init__(self) -> None:
        self.files = dict(FILES)
        self.cut = ""
        self.asked: list[str] = []
        outer = self

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                path = self.path.lstrip("/")
                outer.asked.append(path)
                if path not in outer.files:
                    self.send_error(404)
                    return
                data = outer.files[path]
                self.send_response(200)
                self.send_header("Content-Length", str(len(data)))
                self.end_headers()
                self.wfile.write(data[:100] if path == outer.cut else data)

            def log_message(self, *args: object) -> None:
                pass

        self.http = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.url = f"http://127.0.0.1:{self.http.server_port}"


@pytest.fixture
def server(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[Server]:
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    monkeypatch.setenv("no_proxy", "127.0.0.1")
    made = Server()
    files = tuple(
        (path, path.split("/")[-1], hashlib.sha256(data).hexdigest()) for path, data in FILES.items()
    )
    policy = replace(public.POLICIES["go2w_rl_sar"], source=made.url, files=files)
    monkeypatch.setitem(public.POLICIES, "go2w_rl_sar", policy)
    thread = threading.Thread(target=made.http.serve_forever, kwargs={"poll_interval": 0.01})
    thread.start()
    yield made
    made.http.shutdown()
    made.http.server_close()
    thread.join()


def left(tmp_path: Path) -> list[str]:
    return sorted(
        str(p.relative_to(tmp_path / "rbtrg" / "policies"))
        for p in (tmp_path / "rbtrg" / "policies").rglob("*")
    )


def test_a_policy_is_fetched_once_and_its_licence_is_shown(server: Server, tmp_path: Path) -> None:
    run = CliRunner().invoke(app, ["policy", "get", "go2w_rl_sar"])
    assert run.exit_code == 0, run.output
    assert "licence: Apache-2.0, Copyright (c) 2024-2025 Ziqi Fan" in run.output
    folder = tmp_path / "rbtrg" / "policies" / "go2w_rl_sar"
    assert {f.name: f.read_bytes() for f in folder.iterdir()} == {
        p.split("/")[-1]: d for p, d in FILES.items()
    }
    assert public.stored("go2w_rl_sar") == folder
    asked = len(server.asked)
    again = CliRunner().invoke(app, ["policy", "get", "go2w_rl_sar"])
    assert "already there, checked" in again.output
    assert len(server.asked) == asked
    (folder / "config.yaml").write_text("y: 2\n")
    assert public.get("go2w_rl_sar") == (folder, True), "what was changed is fetched again"
    assert (folder / "config.yaml").read_bytes() == FILES["a/config.yaml"]
    assert left(tmp_path) == [
        "go2w_rl_sar",
        *(f"go2w_rl_sar/{n}" for n in ("LICENSE", "config.yaml", "policy.pt")),
    ]


@pytest.mark.parametrize(
    ("harm", "told"),
    [
        ("wrong", "is not the file that was published: SHA-256"),
        ("cut", "was cut off after 100 of 7000 bytes"),
        ("missing", "the server answers 404"),
        ("gone", "cannot be fetched"),
    ],
)
def test_what_goes_wrong_is_told_in_one_line_and_nothing_is_kept(
    server: Server, tmp_path: Path, harm: str, told: str
) -> None:
    source = ""
    if harm == "wrong":
        server.files["a/policy.pt"] = b"other weights"
    elif harm == "cut":
        server.cut = "a/policy.pt"
    elif harm == "missing":
        del server.files["a/policy.pt"]
    else:
        source = "http://127.0.0.1:1"
    with pytest.raises(PolicyError, match=told) as error:
        public.get("go2w_rl_sar", source)
    assert "\n" not in str(error.value)
    assert "nothing was kept" in str(error.value)
    assert left(tmp_path) == []
    with pytest.raises(PolicyError, match="rbtrg-robot policy get go2w_rl_sar"):
        public.stored("go2w_rl_sar")


def test_an_interrupt_leaves_nothing(server: Server, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(url: str) -> bytes:
        if url.endswith("policy.pt"):
            raise KeyboardInterrupt
        return FILES[url.removeprefix(server.url + "/")]

    monkeypatch.setattr(public, "_fetch", interrupted)
    with pytest.raises(KeyboardInterrupt):
        public.get("go2w_rl_sar")
    assert left(tmp_path) == []


def test_an_unknown_name_is_refused() -> None:
    with pytest.raises(PolicyError, match="there is go2w_rl_sar"):
        public.get("best")


@needs_shared
def test_the_sums_are_those_of_the_policy_that_was_measured_and_the_controller_finds_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    for _, local, wanted in public.POLICIES["go2w_rl_sar"].files:
        assert hashlib.sha256((POLICY / local).read_bytes()).hexdigest() == wanted
    with pytest.raises(PolicyError, match="fetch it with"):
        controller_of("policy")
    (tmp_path / "rbtrg" / "policies").mkdir(parents=True)
    (tmp_path / "rbtrg" / "policies" / "go2w_rl_sar").symlink_to(POLICY)
    assert controller_of("policy").period == 0.005
    assert policy_of("hybrid", "go2w_rl_sar") == policy_of("policy")
    assert policy_of("hybrid") == OURS
