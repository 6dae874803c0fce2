"""Per-cell terrain flags of the corrected graph: faces too high to drive over, ground that was not seen.

A ramp is a slope over the length of the robot, a step is a height difference over a hand's breadth. Steps are measured
between cells `STEP_BASE` apart, in four directions, averaged along the edge of the step (so noise averages out and a
wall one cell thick stays), less the slope that the ground has on BOTH sides of the step (so a ramp is no step, and a
ledge at the foot of a ramp keeps its height)."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from planning.graph.closing import closed, covered

HIGH, UNSEEN, LOW, UNSEEN_RAW, ASSUMED, HOLE, TIP, JUDGED, VIRTUAL, POSTS, FIELD, PLANTS = (
    1 << bit for bit in range(12)
)
FACE = HIGH | LOW
"""What is known of a cell, a bit each.

- `HIGH`, `LOW`: the upper and the lower side of a step above the limit. Only what covers both sides is on the step: a
  robot may stand right beside it.
- `UNSEEN`: part of an unseen patch wider than the gap limit; narrower slits count as seen, and so does assumed ground.
  `UNSEEN_RAW`: the same, assumed or not.
- `ASSUMED`: ground around the start that counts as seen anyway (`planning.graph.blind`).
- `HOLE`: below what it is bridged at by more than the step limit: driven across, not along (`planning.graph.edges`).
- `TIP`: bridged, but the tip of a wide pit's corner, or a hole that the map tells to be too wide
  (`ElevationGrid.holes`): nothing of the robot goes over it.
- `JUDGED`: trusted when it was looked at last: what it was found to be counts (`keep_step`).
- `VIRTUAL`: part of an unseen patch wider than the gap limit over which rays passed low (`ElevationGrid.virtual`):
  planned over at a price, driven on only when it was seen.
- `POSTS`: part of a stepfield whose posts are too high (`planning.graph.fields`).
- `FIELD`: part of a stepfield with posts of more than a third of what is driven through: planned over at a price
  (`planning.graph.edges`).
- `PLANTS`: ground under leaves (`ElevationGrid.plants`): driven on slowly, at a price (`planning.graph.edges`).
"""

STEP_BASE = 0.12
"""Distance over which a step is measured [m]: a face smeared over two 5 cm cells is still one step."""
STEP_LATERAL = 0.10
"""Length along the step over which it is averaged [m]."""
STEP_TOLERANCE = 0.015
"""A step this much above the limit is still within it [m]: three sigma of an averaged step on a 1 cm noise map, so that
a kerb of exactly the limit is not blocked here and there."""
CELL_OUTLIER = 0.06
"""One cell alone may be this far off [m] (scan returns at edges are, by 3-5 cm)."""
WIDE_RATIO = 2.4
"""A pit in which a square of so many times the gap limit fits is wide: at 0.1 m more than two posts of a stepfield."""
UNSEEN_STEP = 0.40
"""Steps between two cells that are both not trusted count from here [m]: filled-in heights meet in false steps."""
BLOCK_CELLS = 256


def halo(res: float, max_gap: float) -> int:
    """Cells around a changed cell whose flags it may change."""
    gap = _gap_cells(res, max_gap)
    step = 2 * round(STEP_BASE / res) + round(0.5 * STEP_LATERAL / res) + 2 * gap + 3
    return max(step, 5 * gap + 2)


def _gap_cells(res: float, max_gap: float) -> int:
    """Side of the square that must not fit into what is to be bridged [cells]."""
    return math.floor(max_gap / res + 0.5) + 1


def update_flags(
    flags: NDArray[np.uint16],
    height: NDArray[np.float32],
    trusted: NDArray[np.bool_],
    virtual: NDArray[np.bool_],
    res: float,
    window: tuple[int, int, int, int],
    max_step: float,
    max_slope: float,
    max_gap: float,
    keep_step: float,
) -> None:
    """Recompute `flags` (rows, cols) inside `window` (row0, col0, row1, col1), block by block to stay in cache.

    Ground that was found drivable stays so up to a step of `max_step + keep_step`; what was found too high must come
    down to `max_step`. So the noise of the map does not open and close a way over a face near the limit.
    """
    rows, cols = height.shape
    pad = halo(res, max_gap)
    for r0 in range(window[0], window[2], BLOCK_CELLS):
        for c0 in range(window[1], window[3], BLOCK_CELLS):
            r1, c1 = min(r0 + BLOCK_CELLS, window[2]), min(c0 + BLOCK_CELLS, window[3])
            ra, ca = max(0, r0 - pad), max(0, c0 - pad)
            rb, cb = min(rows, r1 + pad), min(cols, c1 + pad)
            # Copies: a piece and a whole map would be two layouts, and the kernel would be compiled for both.
            piece = np.ascontiguousarray(height[ra:rb, ca:cb]), np.ascontiguousarray(trusted[ra:rb, ca:cb])
            ground = *piece, np.ascontiguousarray(virtual[ra:rb, ca:cb]), res
            rest = math.tan(max_slope), _gap_cells(res, max_gap), round(WIDE_RATIO * max_gap / res)
            inner = np.s_[r0 - ra : r1 - ra, c0 - ca : c1 - ca]
            enter, stay = (found[inner] for found in cell_flags(*ground, max_step, keep_step, *rest))
            _put(flags[r0:r1, c0:c1], enter, stay, ground[1][inner])


@njit(cache=True)
def _put(flags, enter, stay, trusted):
    """Write freshly computed flags: `stay` where the ground was found drivable, `enter` elsewhere; what was assumed
    stays so."""
    rows, cols = flags.shape
    for r in range(rows):
        for c in range(cols):
            was = flags[r, c]
            flag = stay[r, c] if was & JUDGED and not was & (FACE | HOLE | TIP) else enter[r, c]
            if trusted[r, c]:
                flag |= JUDGED
            if flag & UNSEEN:
                flag |= UNSEEN_RAW
            if flags[r, c] & ASSUMED:
                flag = (flag | ASSUMED) & ~UNSEEN
            flags[r, c] = flag


@njit(cache=True)
def cell_flags(height, trusted, virtual, res, max_step, keep_step, max_tan, gap, pit):
    """Flags (2, rows, cols) uint16 of a map or a piece of one: up to steps of `max_step`, and of `max_step + keep_step`
    [m].

    Cells nearer than `halo` to a cut border are not reliable.
    """
    rows, cols = height.shape
    flags = np.zeros((2, rows, cols), np.uint16)
    unmeasured = covered(trusted, gap)
    unseen = covered(trusted | virtual, gap)
    z = closed(height, gap)
    limits = (max_step + STEP_TOLERANCE, max_step + keep_step + STEP_TOLERANCE)
    levels = 2 if keep_step > 0.0 else 1
    holes = np.zeros(2, np.bool_)
    for r in range(rows):
        for c in range(cols):
            flag = UNSEEN if unseen[r, c] else VIRTUAL if unmeasured[r, c] else 0
            for k in range(levels):
                hole = z[r, c] - height[r, c] > limits[k]
                flags[k, r, c] = flag | (HOLE if hole else 0)
                holes[k] |= hole
    # A ray tells that virtual ground is not above its height: no face rises to it.
    below = virtual & ~trusted
    diff = np.empty((rows, cols), np.float32)
    for direction in range(4):
        dr = 0 if direction == 0 else 1
        dc = (1, 0, 1, -1)[direction]
        scale = res if direction < 2 else res * math.sqrt(2.0)
        n = max(1, round(STEP_BASE / scale))
        side = round(0.5 * STEP_LATERAL / scale) if res < 0.075 else 0
        # diff at c: from c to c + n; the largest decides whether there is anything to do in this direction
        most = np.float32(0.0)
        diff[:] = 0.0
        left = max(0, -n * dc)
        wide = max(0, cols - n * abs(dc))
        for r in range(rows - n * dr):
            ahead = z[r + n * dr, left + n * dc :]
            most = max(most, _rises(diff[r, left : left + wide], z[r, left : left + wide], ahead))
        for k in range(levels):
            if most > limits[k]:
                _mark_steps(
                    flags[k], z, diff, trusted, below, dr, dc, n, side, limits[k], max_tan * n * scale
                )
    floor = closed(height, pit) if holes.any() else z
    for k in range(levels):
        _complete_corners(z, trusted, below, flags[k], limits[k])
        if holes[k]:
            _mark_tips(z, floor, height, flags[k], gap, limits[k])
    if levels == 1:
        for r in range(rows):  # a level at once compiles for 3 s
            for c in range(cols):
                flags[1, r, c] = flags[0, r, c]
    return flags


@njit(cache=True)
def _mark_steps(flags, z, diff, trusted, below, dr, dc, n, side, limit, slope_cap):
    """Mark both sides of the steps above `limit` [m] along (dr, dc); `diff`: the rise over n cells from each; `below`:
    where heights are bounds from above."""
    rows, cols = z.shape
    lr = dc
    lc = -dr
    for r in range(rows - n * dr):
        for c in range(max(0, -n * dc), min(cols, cols - n * dc)):
            own = abs(diff[r, c])
            if own <= 0.5 * limit:
                continue
            mean = _mean(diff, r, c, lr, lc, side, limit)
            step = abs(mean)
            if step <= limit and own <= limit + CELL_OUTLIER:
                continue
            # slope common to both sides
            slope = 0.0
            ra = r - n * dr
            ca = c - n * dc
            rb = r + n * dr
            cb = c + n * dc
            if ra >= 0 and 0 <= ca < cols:
                before = _mean(diff, ra, ca, lr, lc, side, limit)
                after = _mean(diff, rb, cb, lr, lc, side, limit)
                common = min(before, after) if mean > 0.0 else -max(before, after)
                slope = min(max(common, 0.0), slope_cap)
            if step - slope <= limit and own - slope <= limit + CELL_OUTLIER:
                continue
            if not (trusted[r, c] or trusted[rb, cb]) and max(step, own) <= UNSEEN_STEP:
                continue
            if below[rb, cb] if mean > 0.0 else below[r, c]:
                continue
            # the face is where the height changes most on the way, over an unknown stretch if there is one
            last = 0
            low = 0
            high = n
            most = np.float32(-1.0)
            for k in range(1, n + 1):
                here = z[r + k * dr, c + k * dc]
                if here == here:
                    jump = abs(here - z[r + last * dr, c + last * dc])
                    if jump > most:
                        most = jump
                        low = last
                        high = k
                    last = k
            up = z[r + high * dr, c + high * dc] > z[r + low * dr, c + low * dc]
            way = 1 if up else -1
            at = low if up else high
            if below[r + at * dr, c + at * dc]:
                # A bound tells that it falls, not where: as the guard has it, behind the last ground that was seen.
                at += way
                while 0 < at < n and not trusted[r + at * dr, c + at * dc]:
                    at += way
                if trusted[r + at * dr, c + at * dc]:
                    low = min(at, at - way)
                    high = low + 1
            flags[r + low * dr, c + low * dc] |= LOW if up else HIGH
            flags[r + high * dr, c + high * dc] |= HIGH if up else LOW
            for k in range(low + 1, high):
                flags[r + k * dr, c + k * dc] |= FACE


@njit(cache=True)
def _rises(out, low, high):
    """`high` - `low` (n,), 0 where either is unknown; returns the largest size."""
    most = np.float32(0.0)
    for i in range(len(out)):
        d = high[i] - low[i]
        d = d if d == d else np.float32(0.0)
        out[i] = d
        most = max(most, abs(d))
    return most


@njit(cache=True)
def _mean(diff, r, c, lr, lc, side, limit):
    """Mean of the rises `diff` along the edge of a step, `side` cells to both sides along (lr, lc). A low rise counts
    by itself: averaged where the cell does not see a good part of the step, the face would be misplaced."""
    if abs(diff[r, c]) <= 0.5 * limit:
        return diff[r, c]
    rows, cols = diff.shape
    total = np.float32(0.0)
    count = 0
    for k in range(-side, side + 1):
        rr = r + k * lr
        cc = c + k * lc
        if 0 <= rr < rows and 0 <= cc < cols:
            total += diff[rr, cc]
            count += 1
    return total / np.float32(count)


@njit(cache=True)
def _mark_tips(z, wide, height, flags, gap, limit):
    """Mark the bridged tips of a wide pit's corners: the robot has to go around them, as around the pit.

    A pit is wide (`WIDE_RATIO`) when a larger closing, `wide`, leaves a floor in it; the holes of a stepfield are not,
    and their neighbours may be crossed. Of what is bridged, that within a gap's width of the floor is a tip; beyond it
    a crack leads away, which may be crossed too."""
    rows, cols = z.shape
    cells = [(0, 0) for _ in range(0)]
    for r in range(rows):
        for c in range(cols):
            if flags[r, c] & HOLE:
                cells.append((r, c))
    tip = np.zeros((rows, cols), np.bool_)
    reach = 2 * gap
    for k in range(gap):
        found = [(0, 0) for _ in range(0)]
        for r, c in cells:
            if tip[r, c]:
                continue
            level = z[r, c] - limit
            of_pit = False
            for i in range(max(0, r - 1), min(rows, r + 2)):
                for j in range(max(0, c - 1), min(cols, c + 2)):
                    if tip[i, j]:
                        of_pit = True
                    elif k == 0 and not flags[i, j] & HOLE and height[i, j] < level:
                        for a in range(max(0, i - reach), min(rows, i + reach + 1)):
                            for b in range(max(0, j - reach), min(cols, j + reach + 1)):
                                if wide[a, b] < level:
                                    of_pit = True
            if of_pit:
                found.append((r, c))
        if len(found) == 0:
            break
        for r, c in found:
            tip[r, c] = True
            flags[r, c] |= TIP


@njit(cache=True)
def _complete_corners(z, trusted, below, flags, limit):
    """Mark jumps between neighbours beside marked cells: averaging along the step loses the tips of corners."""
    rows, cols = z.shape
    marked = flags & FACE
    for r in range(1, rows - 2):
        for c in range(1, cols - 2):
            for k in range(2):
                rb = r + k
                cb = c + 1 - k
                jump = z[rb, cb] - z[r, c]
                if not abs(jump) > limit or not (trusted[r, c] or trusted[rb, cb] or abs(jump) > UNSEEN_STEP):
                    continue
                if below[rb, cb] if jump > 0.0 else below[r, c]:
                    continue
                near = np.uint16(0)
                for i in range(r - 1, rb + 2):
                    for j in range(c - 1, cb + 2):
                        near |= marked[i, j]
                if near:
                    flags[r, c] |= LOW if jump > 0.0 else HIGH
                    flags[rb, cb] |= HIGH if jump > 0.0 else LOW
