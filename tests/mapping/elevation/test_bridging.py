"""The compiled bridges against the same rules in plain Python, on ground with steps, ramps, walls, gaps and rays of all
heights."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mapping.elevation.bridging import (
    ASSUMED,
    BEFORE_WALL,
    BESIDE,
    OVER,
    RIM_WIDTH,
    WALL_HEIGHT,
    WHEELS,
    bridge,
    bridge_rule,
)
from mapping.elevation.tiles import CONTACT, LIDAR, UNKNOWN

RESOLUTION, GAP, STEP, SLOPE, BOUND, HOLE, BLIND, TRUSTED = 0.04, 0.64, 0.03, 0.47, 0.12, 0.04, 1.4, 0.2


def seen(height, r, c):
    """Whether (r, c) is a cell of the map."""
    return 0 <= r < height.shape[0] and 0 <= c < height.shape[1]


class Bridges:
    """One map, bridged twice."""

    def __init__(self, height, source, trusted, upper) -> None:
        self.height, self.source, self.trusted = height.copy(), source.copy(), trusted.copy()
        self.upper, self.holes = upper, set()

    def beyond(self, r, c, dr, dc, reach, widest):
        for k in range(reach, widest + 1):
            a, b = r + k * dr, c + k * dc
            if not seen(self.height, a, b):
                return 0
            if self.source[a, b]:
                return k if self.trusted[a, b] else 0
        return 0

    def before_wall(self, r, c):
        around = self.height[
            max(r - BEFORE_WALL, 0) : r + BEFORE_WALL + 1, max(c - BEFORE_WALL, 0) : c + BEFORE_WALL + 1
        ]
        return bool((around > float(self.height[r, c]) + WALL_HEIGHT).any())

    def ends_at_wall(self, r, c, dr, dc):
        ahead = [(r + k * dr, c + k * dc) for k in range(1, BEFORE_WALL + 1)]
        return any(
            seen(self.height, *p) and self.height[p] > float(self.height[r, c]) + WALL_HEIGHT for p in ahead
        )

    def goes_on(self, ra, ca, r, c, dr, dc, n, step, slope):
        reach, widest = max(3, (n + 1) // 2), int(GAP / step + 1e-9)
        ha, hb = float(self.height[ra, ca]), float(self.height[r, c])
        k = self.beyond(ra, ca, -dr, -dc, reach, widest)
        if (
            k
            and abs(ha - float(self.height[ra - k * dr, ca - k * dc]) - slope * k * step)
            <= 0.5 * STEP + 1e-12
        ):
            return True
        k = self.beyond(r, c, dr, dc, reach, widest)
        return (
            bool(k)
            and abs(float(self.height[r + k * dr, c + k * dc]) - hb - slope * k * step) <= 0.5 * STEP + 1e-12
        )

    def span(self, r, c, dr, dc, n):
        """(cells, heights, length, kind) of the bridge back from (r, c), None where there is none."""
        step = RESOLUTION * math.sqrt(dr * dr + dc * dc)
        d, ra, ca = n * step, r - n * dr, c - n * dc
        ends = {int(self.source[ra, ca]), int(self.source[r, c])}
        blind = bool(ends & {WHEELS, BESIDE})
        if not blind and d > GAP:
            return None
        ha, hb = float(self.height[ra, ca]), float(self.height[r, c])
        slope = (hb - ha) / d
        if abs(slope) > SLOPE:
            return None
        small = n <= 3
        if abs(hb - ha) > (2.0 if small else 1.0) * STEP and not self.goes_on(
            ra, ca, r, c, dr, dc, n, step, slope
        ):
            return None
        cells = [(ra + k * dr, ca + k * dc) for k in range(1, n)]
        heights = [ha + slope * k * step for k in range(1, n)]
        low = [self.upper[p] < z - HOLE for p, z in zip(cells, heights, strict=True)]
        self.holes |= {p for p, hole in zip(cells, low, strict=True) if hole}
        proven = [self.upper[p] <= z + BOUND for p, z in zip(cells, heights, strict=True)]
        if any(low) or not (small or blind or all(proven)):
            return None
        walls = self.ends_at_wall(r, c, dr, dc) or self.ends_at_wall(ra, ca, -dr, -dc)
        if walls and self.before_wall(ra, ca) and self.before_wall(r, c):
            return None
        return (
            cells,
            heights,
            d,
            BESIDE if blind else (ASSUMED if ASSUMED in ends or d > TRUSTED else OVER),
        )

    def round(self):
        known = self.source != UNKNOWN
        best: dict[tuple[int, int], tuple[float, float, int]] = {}
        for r, c in zip(*map(np.ndarray.tolist, np.nonzero(self.trusted & known)), strict=True):
            for dr, dc in ((0, 1), (1, 1), (1, -1), (1, 0)):
                step = RESOLUTION * math.sqrt(dr * dr + dc * dc)
                back = ((n, r - n * dr, c - n * dc) for n in range(1, 99) if n * step <= BLIND)
                end = next((p for p in back if not seen(known, *p[1:]) or known[p[1:]]), None)
                if end is None or end[0] == 1 or not seen(known, *end[1:]) or not self.trusted[end[1:]]:
                    continue
                span = self.span(r, c, dr, dc, end[0])
                for cell, z in zip(*span[:2], strict=True) if span else ():
                    if cell not in best or span[2] < best[cell][0]:
                        best[cell] = float(np.float32(span[2])), z, span[3]
        wide = {
            (r, c)
            for r, c in best
            if sum(
                seen(known, a, b) and (known[a, b] or (a, b) in best)
                for a in (r - 1, r, r + 1)
                for b in (c - 1, c, c + 1)
            )
            >= 6
        }
        for cell in wide:
            self.height[cell], self.source[cell], self.trusted[cell] = best[cell][1], best[cell][2], True
        self.drop_rims()
        return len(wide), len(best) - len(wide)

    def drop_rims(self):
        level = dict.fromkeys(self.holes, 1)
        queue = list(level)
        for r, c in queue:
            if self.source[r, c] >= OVER:
                self.source[r, c], self.height[r, c], self.trusted[r, c] = UNKNOWN, np.nan, False
            if level[r, c] > int(RIM_WIDTH / RESOLUTION):
                continue
            for cell in ((r - 1, c), (r + 1, c), (r, c - 1), (r, c + 1)):
                free = seen(self.height, *cell) and (
                    self.source[cell] == UNKNOWN or self.source[cell] >= OVER
                )
                if free and cell not in level:
                    level[cell] = level[r, c] + 1
                    queue.append(cell)


@pytest.mark.parametrize("seed", range(6))
def test_bridges_equal_plain_python(seed: int) -> None:
    rng = np.random.default_rng(seed)
    rows, cols = shape = 40, 52
    x, y = np.meshgrid(np.arange(cols), np.arange(rows))
    ground = 0.004 * x * rng.integers(0, 4) + 0.025 * (x // 9) * rng.integers(0, 2)
    ground += np.where(np.hypot(x - rng.integers(cols), y - rng.integers(rows)) < 5, 0.4, 0.0)  # a pillar
    ground += rng.normal(0.0, 0.004, shape)
    rings = np.hypot(x - 10, y - 20) % rng.integers(5, 14) < 2
    known = (rings & (rng.random(shape) < 0.8)) | (rng.random(shape) < 0.03)
    source = np.where(known, np.where(np.hypot(x - 10, y - 20) < 5, CONTACT, LIDAR), UNKNOWN).astype(np.uint8)
    height = np.where(known, ground, np.nan).astype(np.float32)
    trusted = known & (rng.random(shape) < 0.95)
    above = rng.choice([0.05, 0.3, np.inf], shape, p=[0.85, 0.1, 0.05])
    above[rows // 3 : rows // 3 + 2, cols // 2 : cols // 2 + 2] = -0.2  # a pit
    upper = np.where(known, np.inf, ground + above).astype(np.float32)

    want = Bridges(height, source, trusted, upper)
    first, second = want.round(), want.round()
    want.trusted[want.source == ASSUMED] = False
    assert first[0] > 100
    assert second[0] > 10
    assert first[1] > 0, "a bridge of one cell in width"

    rule = bridge_rule(RESOLUTION, GAP, STEP, SLOPE, BOUND, HOLE, BLIND, TRUSTED)
    out, gap = np.empty((2, *shape), np.float32)
    bridge(height, source, trusted, upper, rule, out, gap, np.empty((3, *shape), np.uint8))
    assert np.array_equal(source, want.source)
    assert np.array_equal(trusted, want.trusted)
    np.testing.assert_allclose(height, want.height, atol=1e-6)
    assert {BESIDE, ASSUMED, OVER} <= set(np.unique(source).tolist())
