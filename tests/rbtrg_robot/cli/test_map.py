"""`rbtrg-robot map save`: the file is written by who asks for it, never by the stack."""

from __future__ import annotations

import threading
from pathlib import Path

import numpy as np
import pytest

from mapping.elevation import ElevationMap, MapError
from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.cli.inspect import map_save
from rbtrg_robot.process.runfiles import RunLock
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
