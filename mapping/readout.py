"""Reading the map out: dense layers with bridged gaps, and the deltas since the last read."""

from __future__ import annotations

import numpy as np

from mapping.bridging import bridge, bridge_rule, trust
from mapping.elevation_params import ElevationParams
from mapping.patch import MapPatch
from mapping.tiles import BRIDGED, SENT, UNKNOWN, TileStore

_BLOCK = 8
"""Tiles per side of the blocks that deltas are worked out in: bounds the memory of one step."""

Box = tuple[int, int, int, int]
"""Lattice row and column of the first cell, rows, columns."""


class MapReader:
    """Turns the tiles of one store into patches."""

    def __init__(self, store: TileStore, params: ElevationParams) -> None:
        self.store = store
        self.params = p = params
        self._rule = bridge_rule(
            p.resolution, p.bridge_gap, p.bridge_step, p.bridge_slope, p.bridge_bound, p.hole, p.blind_gap
        )
        self._pad = int(np.ceil((max(p.bridge_gap, p.blind_gap) + 2 * p.bridge_gap) / p.resolution)) + 1

    def read(self, box: Box, stamp: int, epoch: int) -> MapPatch:
        """Cells of `box`, bridged. The margin around it covers a bridge and what its slope is judged by."""
        p, s = self.params, self.store
        i0, j0, rows, cols = box
        pad = self._pad
        wide = (i0 - pad, j0 - pad, rows + 2 * pad, cols + 2 * pad)
        cells = s.read(*wide)
        height, variance, source, upper = (
            np.ascontiguousarray(cells[n]) for n in ("height", "variance", "source", "upper")
        )
        trusted = trust(height, variance, cells["count"], source, p.trust_sigma**2, p.trust_count, p.gate_min)
        bridged = bridge(height, source, trusted, upper, self._rule)
        inner = (slice(pad, pad + rows), slice(pad, pad + cols))
        height, variance, source, upper = height[inner], variance[inner], source[inner], upper[inner]
        trusted, bridged = trusted[inner], bridged[inner]
        new = (source == UNKNOWN) & np.isfinite(bridged)
        height = np.where(new, bridged, height)
        bound = np.where(np.isfinite(upper), upper, np.float32(np.nan))
        layers = {
            "elevation": height,
            "variance": np.where(new, np.float32(p.trust_sigma**2), variance),
            "trusted": (trusted | new).astype(np.float32),
            "upper_bound": np.where(np.isfinite(height), height, bound),
            "source": np.where(new, BRIDGED, source).astype(np.float32),
        }
        return MapPatch((j0 * p.resolution, i0 * p.resolution), p.resolution, stamp, epoch, layers)

    def take_changes(self, stamp: int, epoch: int) -> list[MapPatch]:
        """Patches of what reads differently from what the last ones said; at most one per row of tiles and block."""
        s = self.store
        slots = np.flatnonzero(s.touched[: s.used])
        if slots.size == 0:
            return []
        s.touched[:] = 0
        # bridging carries a change into the neighbour tiles
        k = -(-self._pad // s.size)
        around = [(a, b) for a in range(-k, k + 1) for b in range(-k, k + 1)]
        near = {(int(r) + a, int(c) + b) for r, c in s.tiles[slots] for a, b in around}
        dirty = sorted(t for t in near if s.slot(*t) >= 0)
        patches = []
        for block in sorted({(r // _BLOCK, c // _BLOCK) for r, c in dirty}):
            tiles = np.array([t for t in dirty if (t[0] // _BLOCK, t[1] // _BLOCK) == block])
            lo, hi = tiles.min(axis=0) * s.size, (tiles.max(axis=0) + 1) * s.size
            patches += self._changes(
                (int(lo[0]), int(lo[1]), int(hi[0] - lo[0]), int(hi[1] - lo[1])), stamp, epoch
            )
        return patches

    def _changes(self, box: Box, stamp: int, epoch: int) -> list[MapPatch]:
        """Patches of what differs from the last ones sent, within a box of whole tiles."""
        s, step = self.store, self.params.patch_step
        whole = self.read(box, stamp, epoch)
        height, upper = whole.layers["elevation"], whole.layers["upper_bound"]
        now = np.empty(whole.shape, dtype=SENT)
        now["height"], now["upper"] = height, upper
        now["state"] = whole.layers["source"] + 16 * whole.layers["trusted"]
        sent = s.swap_sent(box[0], box[1], None, whole.shape)
        changed = (now["state"] != sent["state"]) | (np.abs(height - sent["height"]) > step)
        moved = (np.isfinite(upper) != np.isfinite(sent["upper"])) | (
            np.abs(upper - sent["upper"]) > 10 * step
        )
        changed |= np.isnan(height) & moved
        patches = []
        for a in range(0, box[2], s.size):
            r, c = np.nonzero(changed[a : a + s.size])
            if r.size == 0:
                continue
            where = (slice(a + int(r.min()), a + int(r.max()) + 1), slice(int(c.min()), int(c.max()) + 1))
            top, left = box[0] + where[0].start, box[1] + where[1].start
            s.swap_sent(top, left, now[where], now[where].shape)
            layers = {name: np.ascontiguousarray(layer[where]) for name, layer in whole.layers.items()}
            origin = (left * whole.resolution, top * whole.resolution)
            patches.append(MapPatch(origin, whole.resolution, stamp, epoch, layers))
        return patches
