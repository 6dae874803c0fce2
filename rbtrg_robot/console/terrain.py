"""The elevation map for pages: tiles of 64 x 64 cells, each sent again when it changed. Four bytes a cell.

A tile on the wire, little-endian: int32 row, int32 column of its first cell on the world lattice, int16[64, 64] height
[mm] (-32768 unknown), uint8[64, 64] ground risk, uint8[64, 64] trust (0 unknown, 1 seen but not trusted, 2 bridged, 3
LiDAR, 4 wheels, 5 assumed: nobody saw it). Ground risk: slope or face as a share of what the robot drives over; 200 is
its limit, 255 unknown. Ages go by themselves, to pages that show them: row, column, uint8[64, 64] seconds since the
cell was seen (254 and more, 255 never).
"""

from __future__ import annotations

import math
import struct
import time
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hal.rotation import rotation
from hal.types import Capabilities
from mapping.elevation.exchange import PATCH_LAYERS, MapPatch
from mapping.elevation.mirror import TILE_SIDE, CellWindow, MapMirror
from mapping.filling import slope_and_step

SHOWN = ("elevation", "trusted", "source")
HEIGHT = PATCH_LAYERS.index("elevation")
HEADER = struct.Struct("<ii")
RISK_LIMIT = 200
"""Ground risk of ground at the robot's limit."""
MOST_TILES = 40
"""Tiles of one message: 0.7 MB."""
UNKNOWN_HEIGHT = -32768
KINDS = np.array([0, 4, 3, 2, 5, 2, 4, 0], np.uint8)
"""Trust on the wire by the map's `source`: unknown, wheels, LiDAR, bridged, assumed, plants: as bridged, touched: as
felt by the wheels, holes: as unknown."""
MEASURED = (1, 2)
"""Sources of a height that was seen: wheels, LiDAR."""
HEIGHT_AGREES = 0.1
"""[m] between a point and the height of its cell, where the point shows that the cell is still there."""
Key = tuple[int, int]


@dataclass(slots=True)
class _Tile:
    version: int
    seen: NDArray[np.float64]
    """Time of the newest look at each cell; -inf where there was none."""
    heights: NDArray[np.int16] = field(
        default_factory=lambda: np.full((TILE_SIDE, TILE_SIDE), UNKNOWN_HEIGHT, np.int16)
    )
    told: bool = False
    """When its cells were seen was told with their heights."""
    body: bytes | None = None
    looks: int = 0
    """Version of `seen`."""


class Terrain:
    """What the map looks like now. Fed by one thread; times in s of a clock that never goes back."""

    def __init__(self, robot: Capabilities, folder: Path | None = None) -> None:
        """folder: on whose disk the map far from the robot is put; None: it stays in memory."""
        self._slope, self._step = robot.max_slope, robot.max_step
        self._folder = folder
        self._mirror = MapMirror(folder)
        self._tiles: dict[Key, _Tile] = {}
        self._version = 0
        slope_and_step(np.zeros((2, 2), np.float32), 0.04)  # compiled now, not while somebody waits
        rotation(np.array([0.0, 0.0, 0.0, 1.0]))

    @property
    def empty(self) -> bool:
        """No map was heard of yet."""
        return not self._mirror.known

    @property
    def resolution(self) -> float:
        """[m]"""
        return self._mirror.resolution

    def forget(self) -> None:
        """Nobody kept up: the next map is the first."""
        self._mirror = MapMirror(self._folder)
        self._tiles.clear()

    def take(self, patch: MapPatch) -> None:
        """A patch of the map. Raises MapError."""
        if patch.epoch > self._mirror.epoch >= 0:
            self._tiles.clear()
        window = self._mirror.apply(patch)
        if not (window.rows and window.cols):
            return
        self._mirror.stay_within(self._mirror.view(patch.middle))
        self._version += 1
        age = patch.layers.get("age")
        for row in range(window.row // TILE_SIDE, (window.row + window.rows - 1) // TILE_SIDE + 1):
            for col in range(window.col // TILE_SIDE, (window.col + window.cols - 1) // TILE_SIDE + 1):
                tile = self._tiles.setdefault((row, col), _Tile(0, np.full((TILE_SIDE, TILE_SIDE), -np.inf)))
                tile.version, tile.body = self._version, None
                if age is not None:
                    self._take_age(tile, row, col, window, age)

    def _take_age(
        self, tile: _Tile, row: int, col: int, window: CellWindow, age: NDArray[np.float32]
    ) -> None:
        """The map's own word on when cells were seen."""
        r0, r1 = max(row * TILE_SIDE, window.row), min((row + 1) * TILE_SIDE, window.row + window.rows)
        c0, c1 = max(col * TILE_SIDE, window.col), min((col + 1) * TILE_SIDE, window.col + window.cols)
        part = age[r0 - window.row : r1 - window.row, c0 - window.col : c1 - window.col]
        here = (
            slice(r0 - row * TILE_SIDE, r1 - row * TILE_SIDE),
            slice(c0 - col * TILE_SIDE, c1 - col * TILE_SIDE),
        )
        tile.seen[here] = np.where(np.isfinite(part), time.monotonic() - part, -np.inf)
        tile.told = True
        tile.looks += 1

    def look(
        self, points: NDArray[np.float32], position: NDArray[np.float64], turn: NDArray[np.float64]
    ) -> None:
        """Points (n, 3) [m] of a LiDAR at a pose in `map`: the cells that they agree with were seen now."""
        mirror = self._mirror
        if self.empty:
            return
        places = points[np.isfinite(points).all(axis=1)] @ rotation(turn).T + position
        row, col = (np.rint(places[:, k] / mirror.resolution).astype(np.int64) for k in (1, 0))
        now = time.monotonic()
        number = (row // TILE_SIDE << 32) + (col // TILE_SIDE)
        order = np.argsort(number)
        _, first = np.unique(number[order], return_index=True)
        for mine in np.split(order, first[1:]):
            if not len(mine):
                continue
            key = int(row[mine[0]]) // TILE_SIDE, int(col[mine[0]]) // TILE_SIDE
            layers, tile = mirror.tile(key), self._tiles.get(key)
            if layers is None or tile is None:
                continue
            r, c = row[mine] % TILE_SIDE, col[mine] % TILE_SIDE
            agrees = np.abs(places[mine, 2] - layers[HEIGHT][r, c]) < HEIGHT_AGREES
            if agrees.any():
                tile.seen[r[agrees], c[agrees]] = now
                tile.looks += 1

    def prepare(self) -> None:
        """Make some tiles ready to be sent. In the thread that feeds: sending waits for nothing."""
        for key in [key for key, tile in self._tiles.items() if tile.body is None][:MOST_TILES]:
            self._tiles[key].body = self._body(key, self._tiles[key])

    def newer(self, sent: dict[Key, int], x: float, y: float) -> bytes:
        """Tiles that changed since `sent` (which is brought up to date), the nearest to x, y [m] first; empty where
        none did."""
        gone = [key for key in sent if key not in self._tiles]
        for key in gone:
            del sent[key]
        parts = []
        for key in self._nearest((k for k, tile in self._tiles.items() if tile.body), sent, x, y, "version"):
            tile = self._tiles[key]
            sent[key] = tile.version
            parts += [HEADER.pack(key[0] * TILE_SIDE, key[1] * TILE_SIDE), tile.body or b""]
        if not parts:
            return b""
        # A map that began anew is told as such: pages drop what they have.
        return struct.pack("<fI", self._mirror.resolution, bool(gone)) + b"".join(parts)

    def ages(self, sent: dict[Key, int], known: Iterable[Key], x: float, y: float) -> bytes:
        """Ages of the `known` tiles that were looked at since `sent` (which is brought up to date), as `newer`."""
        now = time.monotonic()
        parts = []
        for key in self._nearest((k for k in known if k in self._tiles), sent, x, y, "looks"):
            tile = self._tiles[key]
            sent[key] = tile.looks
            age = np.minimum(now - tile.seen, 254.0)
            age[np.isinf(tile.seen)] = 255.0
            parts += [HEADER.pack(key[0] * TILE_SIDE, key[1] * TILE_SIDE), age.astype(np.uint8).tobytes()]
        return b"".join(parts)

    def _nearest(
        self, keys: Iterable[Key], sent: dict[Key, int], x: float, y: float, version: str
    ) -> list[Key]:
        """Those of which a newer version is there, the nearest first, at most MOST_TILES."""
        size = TILE_SIDE * self._mirror.resolution
        due = [key for key in keys if sent.get(key) != getattr(self._tiles[key], version)]
        due.sort(key=lambda key: (size * (key[0] + 0.5) - y) ** 2 + (size * (key[1] + 0.5) - x) ** 2)
        return due[:MOST_TILES]

    def _body(self, key: Key, tile: _Tile) -> bytes:
        mirror = self._mirror
        # A cell more on each side, so that slopes do not end at the tile.
        outer = mirror.read(
            CellWindow(key[0] * TILE_SIDE - 1, key[1] * TILE_SIDE - 1, TILE_SIDE + 2, TILE_SIDE + 2), SHOWN
        ).layers
        inner = (slice(1, 1 + TILE_SIDE), slice(1, 1 + TILE_SIDE))
        slope, step = slope_and_step(outer["elevation"], mirror.resolution)
        height, trusted, source = (outer[name][inner] for name in SHOWN)
        risk = ground_risk(slope[inner], step[inner], mirror.resolution, self._slope, self._step)
        known = np.isfinite(height)
        millimetres = np.where(known, np.clip(np.nan_to_num(height) * 1000.0, -32767, 32767), UNKNOWN_HEIGHT)
        millimetres = millimetres.astype("<i2")
        measured = np.isin(source, MEASURED)
        if not tile.told:  # a height that is new was seen now
            tile.seen[measured & (millimetres != tile.heights)] = time.monotonic()
        tile.seen[~measured] = -np.inf
        tile.heights, tile.told = millimetres, False
        tile.looks += 1
        trust = trust_of(trusted, source)
        return millimetres.tobytes() + risk.tobytes() + trust.tobytes()


def ground_risk(
    slope: NDArray[np.float32],
    step: NDArray[np.float32],
    resolution: float,
    max_slope: float,
    max_step: float,
) -> NDArray[np.uint8]:
    """Cells' risk 0..254, RISK_LIMIT at the robot's limits, 255 unknown. `slope` [rad], `step` [m] as in
    `slope_and_step`.

    A step higher than the steepest drivable slope makes between diagonal neighbours is a face, and no slope counts
    there.
    """
    with np.errstate(invalid="ignore"):
        face = step > math.sqrt(2.0) * resolution * math.tan(max_slope)
        share = np.where(face, step / max_step, slope / max_slope)
    return np.where(np.isfinite(share), np.clip(np.nan_to_num(share) * RISK_LIMIT, 0, 254), 255).astype(
        np.uint8
    )


def trust_of(trusted: NDArray[np.float32], source: NDArray[np.float32]) -> NDArray[np.uint8]:
    """0 unknown, 1 seen but not trusted, 2 bridged, 3 LiDAR, 4 wheels, 5 assumed. `source` as in `MapPatch`."""
    kind = KINDS[np.clip(np.nan_to_num(source), 0, len(KINDS) - 1).astype(int)]
    return np.where(np.isin(kind, (0, 5)) | (trusted > 0.5), kind, 1).astype(np.uint8)
