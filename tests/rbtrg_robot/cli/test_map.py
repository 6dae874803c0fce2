"""`rbtrg-robot map save`: the file is written by who asks for it, never by the stack."""

from __future__ import annotations

import contextlib
import errno
import threading
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import IO

import numpy as np
import pytest

from mapping.elevation import ElevationMap, MapError
from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.cli.inspect import map_save
from rbtrg_robot.orders.map import FetchMap, save
from rbtrg_robot.process.runfiles import NotRunning, RunLock
from rbtrg_robot.stages.elevation import ElevationStage
from rbtrg_robot.wire.bus import Bus
from rbtrg_robot.wire.convert import map_parts
from tools.bench.ports import free_endpoint


def seen_map() -> ElevationMap:
    """Flat ground under four wheels."""
    elevation = ElevationMap()
    wheels = np.array([[0.2, -0.2, 0.0], [0.2, 0.2, 0.0], [-0.2, -0.2, 0.0], [-0.2, 0.2, 0.0]])
    elevation.fuse_ground(wheels, np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]), 1)
    return elevation


@pytest.fixture
def endpoint(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    return free_endpoint()


def test_the_map_is_asked_for_and_saved(endpoint: str, tmp_path: Path) -> None:
    elevation = seen_map()
    lock = RunLock("go2w")
    done = threading.Event()

    def answer(bus: Bus) -> None:
        while not done.is_set():
            for received in bus.take(0.1):
                assert received.decode().action == "parts"
                i0, j0, rows, cols = elevation.boxes()[0]
                halves = [(i0, j0, rows // 2, cols), (i0 + rows // 2, j0, rows - rows // 2, cols)]
                for part in map_parts(halves, elevation.read, 1):
                    bus.publish(t.MAP_PARTS, part, 1)

    with Bus(endpoint, "elevation", router=True) as bus:
        bus.subscribe([t.MAP_REQUEST])
        bus.advertise(t.MAP_PARTS)
        lock.write_state(endpoint=endpoint, domain=0, ready=True)
        thread = threading.Thread(target=answer, args=(bus,))
        thread.start()
        try:
            map_save(tmp_path / "map.npz")
        finally:
            done.set()
            thread.join()
            lock.release()
    loaded = ElevationMap()
    assert loaded.load_prior(tmp_path / "map.npz") > 0
    want, got = elevation.full().layers, loaded.full().layers
    np.testing.assert_array_equal(got["trusted"], want["trusted"])
    np.testing.assert_allclose(got["elevation"], want["elevation"], atol=1e-6)


def refused(monkeypatch: pytest.MonkeyPatch, file: Path) -> str:
    """What `map save` says where it cannot write."""
    monkeypatch.setattr("rbtrg_robot.cli.link.connect", lambda _robot: contextlib.nullcontext())

    def fetched(_bus: object, order: FetchMap) -> None:
        order.patches = [seen_map().full()]

    monkeypatch.setattr("rbtrg_robot.orders.order.follow", fetched)
    with pytest.raises(MapError) as error:
        map_save(file, force=True)
    return str(error.value)


def test_what_cannot_be_written_is_one_line_and_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "folder.npz").mkdir()
    assert "Is a directory; make room or name another file" in refused(monkeypatch, tmp_path / "folder.npz")
    assert "File name too long" in refused(monkeypatch, tmp_path / f"{'x' * 300}.npz")
    for name in ("map", "map.ply", "..", "."):
        assert "must end in .npz" in refused(monkeypatch, tmp_path / name)

    def full(file: IO[bytes], **_: object) -> None:
        file.write(b"half a map")
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(np, "savez_compressed", full)
    (tmp_path / "map.npz").write_bytes(b"the map of before")
    assert "No space left on device; make room" in refused(monkeypatch, tmp_path / "map.npz")
    assert (tmp_path / "map.npz").read_bytes() == b"the map of before"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["folder.npz", "map.npz"]


def test_a_map_that_no_map_can_be_is_not_kept(tmp_path: Path) -> None:
    with pytest.raises(MapError, match="cells of 3 m"):
        save([replace(seen_map().full(), resolution=3.0)], np.empty((0, 3), np.float32), tmp_path / "a.npz")


def test_a_map_is_written_through_no_link(tmp_path: Path) -> None:
    """The name of the unfinished file could be known, and a link of that name led to any file."""
    (tmp_path / "secret").write_text("key")
    for name in ("map.npz.part", "map.npz"):
        (tmp_path / name).symlink_to("secret")
    seen_map().save(tmp_path / "map.npz")
    assert (tmp_path / "secret").read_text() == "key"
    assert not (tmp_path / "map.npz").is_symlink()
    assert ElevationMap().load_prior(tmp_path / "map.npz") > 0


def test_a_map_that_is_there_stays_unless_somebody_says_so(
    endpoint: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "map.npz").write_text("of before")
    with pytest.raises(MapError, match="--force"):
        map_save(tmp_path / "map.npz")
    monkeypatch.setattr("sys.stdin", SimpleNamespace(isatty=lambda: True))
    for answer, error in ((False, MapError), (True, NotRunning)):
        monkeypatch.setattr("typer.confirm", lambda _words, answer=answer: answer)
        with pytest.raises(error):
            map_save(tmp_path / "map.npz")
    with pytest.raises(NotRunning):  # it goes on to ask the stack
        map_save(tmp_path / "map.npz", force=True)
    assert (tmp_path / "map.npz").read_text() == "of before"


def test_a_folder_that_does_not_exist_is_told(tmp_path: Path) -> None:
    with pytest.raises(MapError, match="there is no folder"):
        map_save(tmp_path / "absent" / "map.npz")


def test_a_crafted_request_writes_no_file(tmp_path: Path) -> None:
    assert "path" not in msg.MapRequest.__dataclass_fields__
    stage = ElevationStage.__new__(ElevationStage)
    stage._detail = ""
    request = msg.MapRequest(action="save")
    assert stage._request(request) == []
    assert "unknown request 'save'" in stage._detail
