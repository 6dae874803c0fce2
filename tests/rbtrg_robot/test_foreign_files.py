"""A pipe, a device, a folder or a socket in the place of a file: one line at once, whoever reads it."""

from __future__ import annotations

import os
import socket
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from hal.errors import OperatorError
from hal.regular import open_regular
from hal.robots.go2w.locomotion.torchfile import read_mlp
from hal.robots.go2w.locomotion.weights import load_weights
from hal.scenes import load_scene
from hal.scenes.files import read_scene
from mapping.elevation import ElevationMap
from rbtrg_robot import config
from rbtrg_robot.log.film import film
from rbtrg_robot.log.stats import summarize
from rbtrg_robot.missions import file, geojson
from rbtrg_robot.provenance import fingerprint
from tests.rbtrg_robot.conftest import Here

KINDS = ("pipe", "device", "folder", "socket")


def made(kind: str, path: Path) -> Path:
    """Nothing that can be read to its end, under this name."""
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "device":
        path.symlink_to("/dev/zero")
    elif kind == "folder":
        path.mkdir()
    else:
        os.chdir(path.parent)  # the name of a socket is short
        with socket.socket(socket.AF_UNIX) as bound:
            bound.bind(path.name)
    return path


READERS: list[tuple[str, Callable[[Path], Any]]] = [
    ("c.yaml", config.load),
    ("m.yaml", file.load),
    ("m.geojson", geojson.load),
    ("log.mcap", summarize),
    ("film.mcap", lambda path: film(path, path.with_name("x.png"), lambda *_: None)),
    ("map.npz", lambda path: ElevationMap().load_prior(path)),
    ("map.ply", lambda path: ElevationMap().load_prior(path)),
    ("scene.npz", lambda path: load_scene(str(path))),
    ("scene.png", lambda path: read_scene(path, resolution=0.1, height_range=(0.0, 1.0))),
    ("scene.obj", read_scene),
    ("policy.npz", load_weights),
    ("policy.pt", read_mlp),
]


@pytest.mark.timeout(20)
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("name", "reader"), READERS, ids=[name for name, _ in READERS])
def test_only_a_file_is_read(
    kind: str, name: str, reader: Callable[[Path], Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(OperatorError) as refused:
        reader(made(kind, tmp_path / name))
    assert name in str(refused.value)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("kind", KINDS)
def test_the_opener_says_what_it_is(kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    path = made(kind, tmp_path / "x")
    with pytest.raises(OSError, match=f"it is a {kind}, not a file"):
        open_regular(path)
    with pytest.raises(OSError, match="not a file"):
        fingerprint(str(path))


def test_a_file_and_a_link_to_one_are_read(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"words")
    (tmp_path / "b").symlink_to("a")
    with open_regular(tmp_path / "b") as found:
        assert found.read() == b"words"
    with pytest.raises(FileNotFoundError):
        open_regular(tmp_path / "c")


def test_what_becomes_a_pipe_between_two_looks_is_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "a").touch()
    pipe, look = tmp_path / "a", os.stat
    pipe.touch()
    before = os.stat(pipe)
    pipe.unlink()
    os.mkfifo(pipe)
    monkeypatch.setattr(
        "hal.regular.os.stat", lambda path, **how: before if path == pipe else look(path, **how)
    )
    with pytest.raises(OSError, match="a pipe"):
        open_regular(pipe)
    held = [Path("/proc/self/fd") / name for name in os.listdir("/proc/self/fd")]
    assert str(pipe) not in [os.readlink(link) for link in held if link.is_symlink()]


@pytest.mark.timeout(20)
@pytest.mark.parametrize(
    "words",
    [
        ("log", "info"), ("log", "check"), ("log", "recover"), ("replay",), ("mission", "run", "--check"),
        ("topic", "list", "--log"), ("calibrate", "lidar", "--log"), ("config", "show", "--config"), ("up", "--map"),
        ("up", "--scene"), ("up", "--controller", "policy", "--policy"),
    ],
)  # fmt: skip
def test_the_command_says_so_in_one_line(here: Here, words: tuple[str, ...], tmp_path: Path) -> None:
    ended = here(*words, str(made("pipe", tmp_path / "p.npz")))
    assert ended.returncode == 1
    assert "p.npz" in ended.stderr
    assert ended.stderr.count("\n") == 1
    assert "a fault in the program" not in ended.stderr
