"""Bridging the gaps between LiDAR rings.

A 16-ring LiDAR at 0.5 m height draws rings 0.3 m apart at 2 m and 0.6 m apart at 3 m. A robot that stands still would
know only thin trusted circles. A gap along a row, a column or a diagonal is bridged if its two ends are trusted and
fit one slope. Every cell in it needs two certificates. A ray passed low over it, so nothing tall stands there. No ray
passed below the bridge, which would be a hole. Shadows, which no ray crossed, stay unknown.

A wall that one ring meets far away scatters into the cells before it, at the ring's height. Where the ground was
never seen these cells look like ground. So nothing that ends at a wall is bridged from the cells before another wall:
in a corner that would be a floor in the air."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from hal.kernels import borrows, inlined

WHEELS, PLANTS, OVER, BESIDE, ASSUMED = 1, 5, 6, 7, 8
"""`source` of cells: stood on by wheels; ground under leaves; bridged; bridged beside the wheels; bridged over a gap
that may hide a pit. No ray comes low beside the wheels, so bridges that start there keep the looser rule."""
RIM_WIDTH = 0.2
"""Bridged cells this near to a proven hole [m] stay unknown."""
WALL_HEIGHT, BEFORE_WALL = 0.2, 2
"""A cell with another one this much higher [m] within so many cells stands before a wall."""
POINT_SIGMAS = 3.0
"""Standard deviations by which a single point may be off."""


@borrows
def _beyond(source, trusted, r, c, dr, dc, reach, widest):  # pragma: no cover
    """Steps from (r, c) along (dr, dc) to the first known cell at least `reach` steps away; 0 if none within `widest`
    steps is trusted."""
    rows, cols = source.shape
    for k in range(reach, widest + 1):
        a, b = r + k * dr, c + k * dc
        if a < 0 or b < 0 or a >= rows or b >= cols:
            return 0
        if source[a, b] != 0:
            return k if trusted[a, b] else 0
    return 0


@borrows
def _before_wall(height, r, c):  # pragma: no cover
    """Whether a wall stands beside cell (r, c)."""
    rows, cols = height.shape
    for a in range(max(r - BEFORE_WALL, 0), min(r + BEFORE_WALL + 1, rows)):
        for b in range(max(c - BEFORE_WALL, 0), min(c + BEFORE_WALL + 1, cols)):
            if height[a, b] > height[r, c] + WALL_HEIGHT:
                return True
    return False


@borrows
def _ends_at_wall(height, r, c, dr, dc):  # pragma: no cover
    """Whether a wall stands beyond cell (r, c) along (dr, dc)."""
    rows, cols = height.shape
    for k in range(1, BEFORE_WALL + 1):
        a, b = r + k * dr, c + k * dc
        if 0 <= a < rows and 0 <= b < cols and height[a, b] > height[r, c] + WALL_HEIGHT:
            return True
    return False


@inlined
def _stray(height, count, r, c, r0, r1, c0, c1, settled, alone, agree):  # pragma: no cover
    """Whether the LiDAR cell (r, c) of few points is stray; its neighbours are rows r0 to r1 - 1, columns c0 to c1 -
    1. See `trust`."""
    h = height[r, c]
    # No processor can predict how neighbours compare: no branches, and no test for negative indices.
    if count[r, c] < settled:
        like = sure = lower = 0
        for a in range(np.uint64(r0), np.uint64(r1)):
            for b in range(np.uint64(c0), np.uint64(c1)):
                apart = height[a, b] - h
                level = (count[a, b] >= settled) & (abs(apart) <= agree)
                like += level
                sure += level & (count[a, b] >= alone)
                lower += apart < -agree
        return like < 2 or like < lower or (sure < 2 and _before_wall(height, r, c))
    reach = under = above = 0
    for a in range(np.uint64(r0), np.uint64(r1)):
        for b in range(np.uint64(c0), np.uint64(c1)):
            apart = height[a, b] - h
            known = count[a, b] >= settled
            reach += known & (apart >= -agree)
            under += known & (apart < -agree)
            above += apart >= -agree
    # one of these is the cell itself
    return reach < 2 and (under > 0 or above == reach)


@njit(cache=True)
def trust(
    height, variance, upper, count, source, v_max, settled, alone, agree, hole, bound
):  # pragma: no cover
    """Cells to trust (rows, cols) bool: wheel cells, ground under leaves, and LiDAR cells certain enough (`v_max`
    [m^2]).

    A wheel cell under which a ray passed by `hole` [m] is not trusted and is erased: the support plane went on over
    an edge.

    A LiDAR cell of fewer than `settled` points needs two settled neighbours within `agree` [m]. Far rings hit each
    cell once, but so do mixed pixels, which hang in the air behind edges. So more neighbours must agree than lie
    lower. Before a wall the neighbours need `alone` points themselves.

    A cell of fewer than `alone` points is stray if all its settled neighbours lie lower, or if no neighbour reaches
    it. A robot that looks at an edge for long collects mixed pixels one by one; a post gives several in each scan.

    Stray cells are erased from `height` and `source`. The ground is not above such a point by more than `POINT_SIGMAS`
    standard deviations: `bound` is `upper` with these bounds, for `bridge`."""
    rows, cols = height.shape
    out = np.zeros((rows, cols), dtype=np.bool_)
    none = np.empty(
        source.size, dtype=np.int32
    )  # flat indices of cells that are erased: the first pass still looks at them
    n_none = 0
    for r in range(rows):
        for c in range(cols):
            bound[r, c] = upper[r, c]
    for r in range(rows):
        for c in range(cols):
            if source[r, c] == 1:
                if upper[r, c] < height[r, c] - hole:
                    none[n_none] = r * cols + c
                    n_none += 1
                else:
                    out[r, c] = True
            elif source[r, c] == PLANTS:
                out[r, c] = True
            elif source[r, c] == 2:
                stray = count[r, c] < settled
                if count[r, c] < alone:
                    if 0 < r < rows - 1 and 0 < c < cols - 1:
                        stray = _stray(height, count, r, c, r - 1, r + 2, c - 1, c + 2, settled, alone, agree)
                    else:
                        r0, r1, c0, c1 = max(r - 1, 0), min(r + 2, rows), max(c - 1, 0), min(c + 2, cols)
                        stray = _stray(height, count, r, c, r0, r1, c0, c1, settled, alone, agree)
                if stray:
                    none[n_none] = r * cols + c
                    n_none += 1
                else:
                    out[r, c] = variance[r, c] < v_max
    for at in none[:n_none]:
        r, c = at // cols, at % cols
        bound[r, c] = min(upper[r, c], height[r, c] + POINT_SIGMAS * np.sqrt(variance[r, c]))
        source[r, c] = 0
        height[r, c] = np.nan
        variance[r, c] = np.nan
    return out


@njit(cache=True)
def _most(rule, squared):  # pragma: no cover
    """Steps that the widest gap of all takes; a step is the root of `squared` cells long."""
    step = rule[0] * np.sqrt(squared)
    widest = max(rule[1], rule[6])
    n = int(widest / step) + 1
    while n * step > widest:
        n -= 1
    return n


@njit(cache=True)
def _all_spans(height, source, trusted, upper, rule, out, gap, holes, kind, found):  # pragma: no cover
    """One pass over the cells in memory order. Each trusted cell looks back along its row, its column and both
    diagonals to the last known cell. If that is trusted too, the unknown cells between are bridged; see `bridge`."""
    rows, cols = source.shape
    resolution, widest_gap, rise, steepest, bound, hole, beside, widest_trusted = (
        rule[0], rule[1], rule[2], rule[3], rule[4], rule[5], rule[6] > 0.0, rule[7],
    )  # fmt: skip
    far = -(1 << 30)
    column = np.full(cols, far, dtype=np.int32)  # row of the last known cell
    falling = np.full(rows + cols, far, dtype=np.int32)
    rising = np.full(rows + cols, far, dtype=np.int32)
    straight, oblique = _most(rule, 1.0), _most(rule, 2.0)
    # Pairs of a row: column, steps back, step in rows and in columns. A loop of their own is faster than a call for
    # each pair.
    pairs = np.empty((4 * cols, 4), np.int32)
    for r in range(rows):
        last = far
        row = np.uint64(r)
        met = 0
        for c in range(cols):
            at = np.uint64(c)  # unsigned indices spare the test for negative ones
            if source[row, at] == 0:
                continue
            f, g = np.uint64(c - r + rows), np.uint64(c + r)
            across, down, right, left = c - last, r - column[at], r - falling[f], r - rising[g]
            last = c
            column[at] = falling[f] = rising[g] = r
            if (across == 1 and down == 1 and right == 1 and left == 1) or not trusted[row, at]:
                continue
            if 1 < across <= straight and trusted[r, c - across]:
                pairs[met, 0], pairs[met, 1], pairs[met, 2], pairs[met, 3] = c, across, 0, 1
                met += 1
            if 1 < right <= oblique and trusted[r - right, c - right]:
                pairs[met, 0], pairs[met, 1], pairs[met, 2], pairs[met, 3] = c, right, 1, 1
                met += 1
            if 1 < left <= oblique and trusted[r - left, c + left]:
                pairs[met, 0], pairs[met, 1], pairs[met, 2], pairs[met, 3] = c, left, 1, -1
                met += 1
            if 1 < down <= straight and trusted[r - down, c]:
                pairs[met, 0], pairs[met, 1], pairs[met, 2], pairs[met, 3] = c, down, 1, 0
                met += 1
        for pair in range(np.uint64(met)):
            cb, n = np.int64(pairs[pair, 0]), np.int64(pairs[pair, 1])
            dr, dc = np.int64(pairs[pair, 2]), np.int64(pairs[pair, 3])
            step = resolution * np.sqrt(float(dr * dr + dc * dc))
            d = n * step
            ra, ca = r - n * dr, cb - n * dc
            one, other = source[ra, ca], source[r, cb]
            blind = beside and (WHEELS in (one, other) or BESIDE in (one, other))
            if not blind and d > widest_gap:
                continue
            ha, hb = np.float64(height[ra, ca]), np.float64(height[r, cb])
            slope = (hb - ha) / d
            if abs(slope) > steepest:
                continue
            small = n <= 3
            fits = abs(hb - ha) <= rise or (small and abs(hb - ha) <= 2.0 * rise)
            if not fits:
                # the same slope goes on before or behind the gap, over at least half its width: a ramp, not a step
                reach, widest = max(3, (n + 1) // 2), int(widest_gap / step + 1e-9)
                k = _beyond(source, trusted, ra, ca, -dr, -dc, reach, widest)
                if k > 0:
                    rest = ha - height[ra - k * dr, ca - k * dc] - slope * k * step
                    fits = abs(rest) <= 0.5 * rise
                if not fits:
                    k = _beyond(source, trusted, r, cb, dr, dc, reach, widest)
                    if k > 0:
                        rest = height[r + k * dr, cb + k * dc] - hb - slope * k * step
                        fits = abs(rest) <= 0.5 * rise
            if not fits:
                continue
            for k in range(1, n):
                z = ha + slope * k * step
                rk, ck = ra + k * dr, ca + k * dc
                u = upper[rk, ck]
                if u < z - hole:
                    if holes[rk, ck] == 0:
                        holes[rk, ck] = 1
                        found[1, 1 + found[1, 0]] = rk * cols + ck
                        found[1, 0] += 1
                    fits = False
                elif not (small or blind or u <= z + bound):
                    fits = False
            if not fits:
                continue
            at_wall = _ends_at_wall(height, r, cb, dr, dc) or _ends_at_wall(height, ra, ca, -dr, -dc)
            if at_wall and _before_wall(height, ra, ca) and _before_wall(height, r, cb):
                continue
            hides = ASSUMED in (one, other) or d > widest_trusted
            what = BESIDE if blind else (ASSUMED if hides else OVER)
            for k in range(1, n):
                rk, ck = ra + k * dr, ca + k * dc
                if d < gap[rk, ck]:
                    if gap[rk, ck] == np.inf:
                        found[0, 1 + found[0, 0]] = rk * cols + ck
                        found[0, 0] += 1
                    gap[rk, ck] = d
                    kind[rk, ck] = what
                    out[rk, ck] = ha + slope * k * step


@njit(cache=True)
def _drop_rims(height, source, trusted, level, holes, depth):  # pragma: no cover
    """Remove bridges within `depth` unknown cells of the proven `holes` (n,), flat indices: near the edge of a hole
    no ray comes low enough to prove it. `level` (rows, cols) is scratch."""
    rows, cols = source.shape
    level[:] = 0
    queue = np.empty(source.size, np.int32)
    n = 0
    for at in holes:
        level[at // cols, at % cols] = 1
        queue[n] = at
        n += 1
    head = 0
    while head < n:
        i, j = np.int64(queue[head] // cols), np.int64(queue[head] % cols)
        head += 1
        if source[i, j] >= OVER:
            source[i, j] = 0
            height[i, j] = np.nan
            trusted[i, j] = False
        if level[i, j] > depth:
            continue
        for a, b in ((i - 1, j), (i + 1, j), (i, j - 1), (i, j + 1)):
            inside = 0 <= a < rows and 0 <= b < cols
            if inside and level[a, b] == 0 and (source[a, b] == 0 or source[a, b] >= OVER):
                level[a, b] = level[i, j] + 1
                queue[n] = a * cols + b
                n += 1


@njit(cache=True)
def bridge(height, source, trusted, upper, rule, out, gap, marks):  # pragma: no cover
    """Bridge in place: height, source (OVER, BESIDE or ASSUMED) and trusted of bridged cells.

    height, upper (rows, cols) f32 [m] (upper: inf where no ray passed), source u8 (0 unknown, 1 wheels, 2 LiDAR, 5
    plants), trusted bool.

    rule, all metres: resolution, widest gap, step, slope, bound, hole, widest gap beside a wheel cell (0: as
    everywhere), widest trusted gap. A wider gap over which rays pass low gets a height but no trust.

    out, gap (rows, cols) f32 and marks (3, rows, cols) u8 are scratch.

    Of several bridges over a cell the shortest wins. A bridge one or two cells wide is a coincidence between unlike
    surfaces and is dropped. A second round from the bridged cells closes what the eight directions left open."""
    rows, cols = height.shape
    kind, holes, level = marks[0], marks[1], marks[2]
    holes[:] = 0
    # Flat indices, their number in front: cells that a bridge leads over in this round, proven holes of both.
    found = np.empty((2, source.size + 1), np.int32)
    found[1, 0] = 0
    wide = np.uint32(cols)  # a division of 64 bits takes three times as long
    for _ in range(2):
        gap[:] = np.inf
        found[0, 0] = 0
        _all_spans(height, source, trusted, upper, rule, out, gap, holes, kind, found)
        over = found[0, 1 : 1 + found[0, 0]]
        for at in over:
            r, c = np.int64(np.uint32(at) // wide), np.int64(np.uint32(at) % wide)
            n = 0
            top, bottom = (r - 1 if r > 0 else r), (r + 2 if r + 2 < rows else rows)
            first, end = (c - 1 if c > 0 else c), (c + 2 if c + 2 < cols else cols)
            for a in range(top, bottom):
                for b in range(first, end):
                    i, j = np.uint64(a), np.uint64(b)
                    n += (source[i, j] != 0) | (gap[i, j] < np.inf)
            if n < 6:  # itself included
                kind[r, c] = 0
        for at in over:
            i, j = np.uint64(np.uint32(at) // wide), np.uint64(np.uint32(at) % wide)
            if kind[i, j] != 0:
                height[i, j] = out[i, j]
                source[i, j] = kind[i, j]
                trusted[i, j] = True
        if found[1, 0] > 0:
            _drop_rims(
                height, source, trusted, level, found[1, 1 : 1 + found[1, 0]], int(RIM_WIDTH / rule[0])
            )
    for row in range(rows):
        for col in range(cols):
            if source[row, col] == ASSUMED:
                trusted[row, col] = False


def bridge_rule(
    resolution: float,
    gap: float,
    step: float,
    slope: float,
    bound: float,
    hole: float,
    blind: float,
    trusted: float,
) -> NDArray[np.float64]:
    """The `rule` array of `bridge`."""
    return np.array([resolution, gap, step, slope, bound, hole, blind, trusted], dtype=np.float64)
