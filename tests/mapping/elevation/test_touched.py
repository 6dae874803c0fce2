"""What was touched is a wall of the map that no ray erases; it fades, is forgotten on demand, and comes back from a
reader."""

from __future__ import annotations

import numpy as np
import pytest

from hal.types import NS
from mapping.elevation.config import ElevationConfig
from mapping.elevation.exchange import TOUCHED, MapError
from mapping.elevation.map import ElevationMap
from mapping.elevation.mirror import MapMirror
from mapping.elevation.touched import WALL_DEPTH, WALL_RISE
from tests.mapping.elevation.test_map import HEIGHT, LEVEL, flat_scan

FIRST = NS
FADE = round(ElevationConfig().touched_fade * NS)
"""[ns]"""


def touched_at(elevation: ElevationMap) -> np.ndarray:
    """(n, 2) x, y [m] of the cells that read as touched."""
    patch = elevation.window(0.0, 0.0, 2.0)
    row, col = np.nonzero(patch.layers["source"] == TOUCHED)
    assert np.isfinite(patch.layers["elevation"][row, col]).all()
    assert (patch.layers["trusted"][row, col] == 1.0).all()
    return np.column_stack([col, row]) * patch.resolution + patch.origin


def scanned(elevation: ElevationMap, stamp: int) -> None:
    elevation.fuse(flat_scan(np.random.default_rng(stamp)), (0.0, 0.0, HEIGHT), LEVEL, stamp)
    elevation.clean()


@pytest.mark.parametrize("yaw", [0.0, 0.5, -2.4])
def test_it_reads_as_a_wall_as_wide_as_the_body(yaw: float) -> None:
    elevation = ElevationMap()
    scanned(elevation, FIRST)
    elevation.touch(0.9, 0.3, HEIGHT, yaw, FIRST)
    cells = touched_at(elevation) - (0.9, 0.3)
    c, s = np.cos(yaw), np.sin(yaw)
    along, across = cells @ (c, s), cells @ (-s, c)
    assert -1e-6 <= along.min() <= along.max() <= WALL_DEPTH + 1e-6
    assert 0.35 < np.ptp(across) < 0.44
    assert abs(across.mean()) < 0.03
    top = elevation.window(0.9 + 0.05 * c, 0.3 + 0.05 * s, 0.0).layers["elevation"]
    assert top[0, 0] == pytest.approx(HEIGHT + WALL_RISE, abs=1e-4)


def test_rays_through_it_erase_nothing_and_it_fades() -> None:
    elevation, reader = ElevationMap(), MapMirror()
    for k in range(4):
        scanned(elevation, FIRST + k * NS // 10)
    before = elevation.window(1.0, 0.0, 0.5).layers["elevation"]
    elevation.touch(1.0, 0.0, HEIGHT, 0.0, FIRST + NS)
    for k in range(30):
        scanned(elevation, FIRST + NS + k * NS // 10)
        for patch in elevation.take_patches():
            reader.apply(patch)
    assert len(touched_at(elevation)) > 15
    assert elevation.touched == 1
    scanned(elevation, FIRST + NS + FADE + NS)
    assert not len(touched_at(elevation))
    assert elevation.touched == 0
    after = elevation.window(1.0, 0.0, 0.5).layers["elevation"]
    assert np.allclose(after, before, atol=0.02, equal_nan=True), "what was measured there is still known"
    assert (reader.patch().layers["source"] == TOUCHED).any()
    for patch in elevation.take_patches():
        reader.apply(patch)
    assert not (reader.patch().layers["source"] == TOUCHED).any(), "readers hear that it is gone"


def test_the_operator_forgets_it() -> None:
    elevation = ElevationMap()
    scanned(elevation, FIRST)
    elevation.touch(1.0, 0.0, HEIGHT, 0.0, FIRST)
    elevation.touch(1.0, 0.5, HEIGHT, 0.0, FIRST)
    assert elevation.forget_touched() == 2
    assert not len(touched_at(elevation))


def test_it_comes_back_from_a_reader_and_fades_later() -> None:
    first, again = ElevationMap(), ElevationMap()
    scanned(first, FIRST)
    first.touch(1.0, 0.0, HEIGHT, 0.3, FIRST)
    for patch in first.take_patches():
        again.restore(patch)
    assert {tuple(c) for c in touched_at(again).round(3)} == {tuple(c) for c in touched_at(first).round(3)}
    scanned(again, FIRST + FADE + NS)
    assert not len(touched_at(again))


def test_what_is_no_number_is_refused() -> None:
    with pytest.raises(MapError, match="touched at"):
        ElevationMap().touch(float("nan"), 0.0, 0.0, 0.0, FIRST)
