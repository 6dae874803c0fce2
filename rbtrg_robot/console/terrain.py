"""The elevation map for pages: tiles of 64 x 64 cells, each sent again when it changed. Four bytes a cell.

A tile on the wire, little-endian: int32 row, int32 column of its first cell on the world lattice, float32 seconds since the map
changed there, uint32 of zero, int16[64, 64] height [mm] (-32768 unknown), uint8[64, 64] ground risk, uint8[64, 64] trust
(0 unknown, 1 seen but not trusted, 2 bridged, 3 LiDAR, 4 wheels).
Ground risk: slope or face as a share of what the robot drives over; 200 is its limit, 255 unknown.
"""

from __future__ import annotations

import math
import struct
import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hal.types import Capabilities
from mapping.elevation.exchange import MapMirror, MapPatch
from mapping.filling import slope_and_step

SIDE = 64
"""Cells of a tile's side; `MapMirror` grows in the same steps."""
HEADER = struct.Struct("<iifI")
LIMIT = 200
"""Ground risk of ground at the robot's limit."""
MOST = 40
"""Tiles of one message: 0.7 MB."""
Key = tuple[int, int]


@dataclass(slots=True)
class _Tile:
    version: int
    changed: float
    body: bytes | None = None


class Terrain:
    """What the map looks like now. Fed by one thread; times in s of a clock that never goes back."""

    def __init__(self, robot: Capabilities) -> None:
        self._slope, self._step = robot.max_slope, robot.max_step
        self._mirror = MapMirror()
        self._tiles: dict[Key, _Tile] = {}
        self._version = 0
        slope_and_step(np.zeros((2, 2), np.float32), 0.04)  # compiled now, not while somebody waits

    @property
    def empty(self) -> bool:
        """No map was heard of yet."""
        return not self._mirror.layers

    @property
    def resolution(self) -> float:
        """[m]"""
        return self._mirror.resolution

    def forget(self) -> None:
        """Nobody kept up: the next map is the first."""
        self._mirror = MapMirror()
        self._tiles.clear()

    def take(self, patch: MapPatch) -> None:
        """A patch of the map. Raises MapError."""
        if patch.epoch > self._mirror.epoch >= 0:
            self._tiles.clear()
        window = self._mirror.apply(patch)
        if not (window.rows and window.cols):
            return
        self._version += 1
        now = time.monotonic()
        for row in range(window.row // SIDE, (window.row + window.rows - 1) // SIDE + 1):
            for col in range(window.col // SIDE, (window.col + window.cols - 1) // SIDE + 1):
                self._tiles[row, col] = _Tile(self._version, now)

    def prepare(self) -> None:
        """Make some tiles ready to be sent. In the thread that feeds: sending waits for nothing."""
        for key in [key for key, tile in self._tiles.items() if tile.body is None][:MOST]:
            self._tiles[key].body = self._body(key)

    def newer(self, sent: dict[Key, int], x: float, y: float) -> bytes:
        """Tiles that changed since `sent` (which is brought up to date), the nearest to x, y [m] first; empty where none did."""
        gone = [key for key in sent if key not in self._tiles]
        for key in gone:
            del sent[key]
        due = [key for key, tile in self._tiles.items() if tile.body and sent.get(key) != tile.version]
        if not due:
            return b""
        size = SIDE * self._mirror.resolution
        due.sort(key=lambda key: (size * (key[0] + 0.5) - y) ** 2 + (size * (key[1] + 0.5) - x) ** 2)
        now = time.monotonic()
        parts = []
        for key in due[:MOST]:
            tile = self._tiles[key]
            sent[key] = tile.version
            parts += [HEADER.pack(key[0] * SIDE, key[1] * SIDE, now - tile.changed, 0), tile.body or b""]
        # A map that began anew is told as such: pages drop what they have.
        return struct.pack("<fI", self._mirror.resolution, bool(gone)) + b"".join(parts)

    def _body(self, key: Key) -> bytes:
        mirror = self._mirror
        row, col = key[0] * SIDE - mirror.row, key[1] * SIDE - mirror.col
        # A cell more on each side, so that slopes do not end at the tile.
        outer = tuple(slice(max(first - 1, 0), first + SIDE + 1) for first in (row, col))
        slope, step = slope_and_step(mirror.layers["elevation"][outer], mirror.resolution)
        inner = tuple(
            slice(first - part.start, first - part.start + SIDE)
            for first, part in zip((row, col), outer, strict=True)
        )
        where = (slice(row, row + SIDE), slice(col, col + SIDE))
        height = mirror.layers["elevation"][where]
        risk = ground_risk(slope[inner], step[inner], mirror.resolution, self._slope, self._step)
        known = np.isfinite(height)
        millimetres = np.where(known, np.clip(np.nan_to_num(height) * 1000.0, -32767, 32767), -32768)
        trust = trust_of(mirror.layers["trusted"][where], mirror.layers["source"][where])
        return millimetres.astype("<i2").tobytes() + risk.tobytes() + trust.tobytes()


def ground_risk(
    slope: NDArray[np.float32],
    step: NDArray[np.float32],
    resolution: float,
    max_slope: float,
    max_step: float,
) -> NDArray[np.uint8]:
    """Cells' risk 0..254, LIMIT at the robot's limits, 255 unknown. `slope` [rad], `step` [m] as in `slope_and_step`.

    A step higher than the steepest drivable slope makes between diagonal neighbours is a face, and no slope counts there.
    """
    with np.errstate(invalid="ignore"):
        face = step > math.sqrt(2.0) * resolution * math.tan(max_slope)
        share = np.where(face, step / max_step, slope / max_slope)
    return np.where(np.isfinite(share), np.clip(np.nan_to_num(share) * LIMIT, 0, 254), 255).astype(np.uint8)


def trust_of(trusted: NDArray[np.float32], source: NDArray[np.float32]) -> NDArray[np.uint8]:
    """0 unknown, 1 seen but not trusted, 2 bridged, 3 LiDAR, 4 wheels. `source` as in `MapPatch`."""
    kind = np.array([0, 4, 3, 2], np.uint8)[np.clip(np.nan_to_num(source), 0, 3).astype(int)]
    return np.where(kind == 0, 0, np.where(trusted > 0.5, kind, 1)).astype(np.uint8)
