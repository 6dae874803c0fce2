"""Bridging the gaps between LiDAR rings.

A 16-ring LiDAR at 0.5 m height draws rings 0.3 m apart at 2 m and 0.6 m apart at 3 m; a robot that stands still would
live in a world of thin trusted circles. A gap along a row, a column or a diagonal is bridged when its two ends are
trusted and fit one slope, and every cell in it carries a certificate: a ray passed low over it (so nothing tall stands
there) and none passed below the bridge (that would be a hole). Shadows, which no ray crossed, stay unknown.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

RIM = 0.2
"""Bridged cells this near to a proven hole [m] stay unknown."""


@njit(cache=True)
def _line(height, source, trusted, upper, r, c, dr, dc, rule, pos, out, gap, holes, kind):  # pragma: no cover
    """Bridge along one line of cells starting at (r, c); see `bridge`."""
    rows, cols = height.shape
    n = 0
    k = 0
    while 0 <= r + k * dr < rows and 0 <= c + k * dc < cols:
        if source[r + k * dr, c + k * dc] != 0:
            pos[n] = k
            n += 1
        k += 1
    step = rule[0] * np.sqrt(float(dr * dr + dc * dc))
    for q in range(n - 1):
        a, b = pos[q], pos[q + 1]
        d = (b - a) * step
        if b - a < 2 or d > rule[6]:
            continue
        ra, ca, rb, cb = r + a * dr, c + a * dc, r + b * dr, c + b * dc
        if not (trusted[ra, ca] and trusted[rb, cb]):
            continue
        blind = source[ra, ca] == 1 or source[rb, cb] == 1
        if not blind and d > rule[1]:
            continue
        ha, hb = np.float64(height[ra, ca]), np.float64(height[rb, cb])
        slope = (hb - ha) / d
        if abs(slope) > rule[3]:
            continue
        small = b - a <= 3
        fits = abs(hb - ha) <= rule[2] or (small and abs(hb - ha) <= 2.0 * rule[2])
        if not fits:
            # the same slope goes on before or behind the gap, over at least half its width: a ramp, not a step
            reach = max(3, (b - a + 1) // 2)
            p = q - 1
            while p >= 0 and a - pos[p] < reach:
                p -= 1
            if p >= 0 and (a - pos[p]) * step <= rule[1] and trusted[r + pos[p] * dr, c + pos[p] * dc]:
                rest = ha - height[r + pos[p] * dr, c + pos[p] * dc] - slope * (a - pos[p]) * step
                fits = abs(rest) <= 0.5 * rule[2]
            p = q + 2
            while p < n and pos[p] - b < reach:
                p += 1
            if (
                not fits
                and p < n
                and (pos[p] - b) * step <= rule[1]
                and trusted[r + pos[p] * dr, c + pos[p] * dc]
            ):
                rest = height[r + pos[p] * dr, c + pos[p] * dc] - hb - slope * (pos[p] - b) * step
                fits = abs(rest) <= 0.5 * rule[2]
        if not fits:
            continue
        for k in range(a + 1, b):
            z = ha + slope * (k - a) * step
            u = upper[r + k * dr, c + k * dc]
            if u < z - rule[5]:
                holes[r + k * dr, c + k * dc] = 1
                fits = False
            elif not (small or blind or u <= z + rule[4]):
                fits = False
        if not fits:
            continue
        for k in range(a + 1, b):
            rk, ck = r + k * dr, c + k * dc
            if d < gap[rk, ck]:
                gap[rk, ck] = d
                kind[rk, ck] = 1 if blind else 2
                out[rk, ck] = ha + slope * (k - a) * step


@njit(cache=True)
def trust(height, variance, count, source, v_max, settled, agree):  # pragma: no cover
    """Which cells to believe (rows, cols) bool: wheel cells, and LiDAR cells certain enough (`v_max` [m^2]).

    A LiDAR cell of fewer than `settled` points needs two settled neighbours within `agree` [m]: far rings hit each cell
    once, but so do mixed pixels, which hang in the air behind edges. Those are erased from `height` and `source`.
    """
    rows, cols = height.shape
    out = np.zeros((rows, cols), dtype=np.bool_)
    for r in range(rows):
        for c in range(cols):
            if source[r, c] == 1:
                out[r, c] = True
            elif source[r, c] == 2:
                n = 2
                if count[r, c] < settled:
                    n = 0
                    for a in range(max(r - 1, 0), min(r + 2, rows)):
                        for b in range(max(c - 1, 0), min(c + 2, cols)):
                            if count[a, b] >= settled and abs(height[a, b] - height[r, c]) <= agree:
                                n += 1
                if n < 2:
                    source[r, c] = 3
                else:
                    out[r, c] = variance[r, c] < v_max
    for r in range(rows):
        for c in range(cols):
            if source[r, c] == 3:
                source[r, c] = 0
                height[r, c] = np.nan
                variance[r, c] = np.nan
    return out


@njit(cache=True)
def _all_lines(height, source, trusted, upper, rule, out, gap, holes, kind):  # pragma: no cover
    rows, cols = height.shape
    pos = np.empty(rows + cols, dtype=np.int64)
    for r in range(rows):
        _line(height, source, trusted, upper, r, 0, 0, 1, rule, pos, out, gap, holes, kind)
        _line(height, source, trusted, upper, r, 0, 1, 1, rule, pos, out, gap, holes, kind)
        _line(height, source, trusted, upper, r, cols - 1, 1, -1, rule, pos, out, gap, holes, kind)
    for c in range(cols):
        _line(height, source, trusted, upper, 0, c, 1, 0, rule, pos, out, gap, holes, kind)
        if c > 0:
            _line(height, source, trusted, upper, 0, c, 1, 1, rule, pos, out, gap, holes, kind)
        if c < cols - 1:
            _line(height, source, trusted, upper, 0, c, 1, -1, rule, pos, out, gap, holes, kind)


@njit(cache=True)
def _drop_rims(result, source, level, depth):  # pragma: no cover
    """Unbridge what lies within `depth` unknown cells of a proven hole (`level` 1, scratch): beside its near edge no ray
    comes low enough to tell."""
    rows, cols = result.shape
    queue = np.empty((result.size, 2), np.int64)
    n = 0
    for r in range(rows):
        for c in range(cols):
            if level[r, c] == 1:
                queue[n, 0], queue[n, 1] = r, c
                n += 1
    head = 0
    while head < n:
        i, j = queue[head]
        head += 1
        result[i, j] = np.nan
        if level[i, j] > depth:
            continue
        for a, b in ((i - 1, j), (i + 1, j), (i, j - 1), (i, j + 1)):
            if 0 <= a < rows and 0 <= b < cols and level[a, b] == 0 and source[a, b] == 0:
                level[a, b] = level[i, j] + 1
                queue[n, 0], queue[n, 1] = a, b
                n += 1


@njit(cache=True)
def bridge(height, source, trusted, upper, rule):  # pragma: no cover
    """Heights of bridged cells.

    height, upper (rows, cols) f32 [m] (upper: inf where no ray passed), source u8 (0 unknown, 1 wheels, 2 LiDAR),
    trusted bool. rule: resolution, widest gap, step, slope, bound, hole, widest gap beside a wheel cell (all metres).
    Returns out (rows, cols) f32, NaN where nothing was bridged. Of several bridges over a cell the shortest wins; a
    bridge one or two cells wide is a coincidence between unlike surfaces and dropped. A second round from the bridged
    cells closes what the eight directions left open.
    """
    rows, cols = height.shape
    result = np.full((rows, cols), np.nan, dtype=np.float32)
    h, s, t = height.copy(), source.copy(), trusted.copy()
    holes = np.zeros((rows, cols), dtype=np.uint8)
    kind = np.zeros((rows, cols), dtype=np.uint8)
    for _ in range(2):
        out = np.full((rows, cols), np.nan, dtype=np.float32)
        gap = np.full((rows, cols), np.inf, dtype=np.float32)
        _all_lines(h, s, t, upper, rule, out, gap, holes, kind)
        for r in range(rows):
            for c in range(cols):
                if gap[r, c] == np.inf:
                    continue
                n = 0
                for a in range(max(r - 1, 0), min(r + 2, rows)):
                    for b in range(max(c - 1, 0), min(c + 2, cols)):
                        n += s[a, b] != 0 or gap[a, b] < np.inf
                if n >= 6:  # itself included
                    result[r, c] = out[r, c]
        _drop_rims(result, source, holes.copy(), int(RIM / rule[0]))
        for r in range(rows):
            for c in range(cols):
                if s[r, c] == 0 and result[r, c] == result[r, c]:
                    h[r, c] = result[r, c]
                    t[r, c] = True
                    # beside the wheels no ray comes low: keep the looser rule there
                    s[r, c] = kind[r, c]
    return result


def bridge_rule(
    resolution: float, gap: float, step: float, slope: float, bound: float, hole: float, blind: float
) -> NDArray[np.float64]:
    """The `rule` array of `bridge`."""
    return np.array([resolution, gap, step, slope, bound, hole, blind], dtype=np.float64)
