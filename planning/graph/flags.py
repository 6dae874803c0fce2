"""Per-cell terrain flags of the corrected graph: faces too high to drive over, ground that was not seen.

A ramp is a slope over the length of the robot, a step is a height difference over a hand's breadth. Steps are measured
between cells `BASE` apart, in four directions, averaged along the edge of the step (so noise averages out and a wall one
cell thick stays), less the slope that the ground has on BOTH sides of the step (so a ramp is no step, and a ledge at the
foot of a ramp keeps its height).
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

HIGH = 1
"""The cell is the upper side of a step above the limit."""
LOW = 4
"""The cell is the lower side of one. Only what covers both sides is on the step: a robot may stand right beside it."""
FACE = HIGH | LOW
UNSEEN = 2
"""Part of an unseen patch wider than the gap limit; narrower slits count as seen, and so does assumed ground."""
UNSEEN_RAW = 8
"""The same, assumed or not."""
ASSUMED = 16
"""Ground around the start that counts as seen anyway (`planning.graph.blind`)."""
HOLE = 32
"""Below what it is bridged at by more than the step limit: driven across, not along (`planning.graph.edges`)."""
TIP = 64
"""Bridged, but the tip of a wide pit's corner: nothing of the robot goes over it."""
JUDGED = 128
"""The cell was trusted when it was looked at last: what it was found to be counts (`keep_step`)."""
VIRTUAL = 256
"""Part of an unseen patch wider than the gap limit over which rays passed low (`ElevationGrid.virtual`): planned over at a
price, driven on only when it was seen."""
POSTS = 512
"""Part of a stepfield whose posts are too high (`planning.graph.fields`)."""

BASE = 0.12
"""Distance over which a step is measured [m]: a face smeared over two 5 cm cells is still one step."""
LATERAL = 0.10
"""Length along the step over which it is averaged [m]."""
STEP_TOLERANCE = 0.015
"""A step this much above the limit is still within it [m]: three sigma of an averaged step on a 1 cm noise map, so that a
kerb of exactly the limit is not blocked here and there."""
OUTLIER = 0.06
"""One cell alone may be this far off [m] (scan returns at edges are, by 3-5 cm)."""
WIDE = 2.4
"""A pit in which a square of so many times the gap limit fits is wide: at 0.1 m more than two posts of a stepfield."""
UNSEEN_STEP = 0.40
"""Steps between two cells that are both not trusted count from here [m]: filled-in heights meet in false steps."""
BLOCK = 256


def halo(res: float, max_gap: float) -> int:
    """Cells around a changed cell whose flags it may change."""
    gap = _gap_cells(res, max_gap)
    step = 2 * round(BASE / res) + round(0.5 * LATERAL / res) + 2 * gap + 3
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

    Ground that was found drivable stays so up to a step of `max_step + keep_step`; what was found too high must come down
    to `max_step`. So the noise of the map does not open and close a way over a face near the limit.
    """
    rows, cols = height.shape
    pad = halo(res, max_gap)
    for r0 in range(window[0], window[2], BLOCK):
        for c0 in range(window[1], window[3], BLOCK):
            r1, c1 = min(r0 + BLOCK, window[2]), min(c0 + BLOCK, window[3])
            ra, ca = max(0, r0 - pad), max(0, c0 - pad)
            rb, cb = min(rows, r1 + pad), min(cols, c1 + pad)
            # Copies: a piece and a whole map would be two layouts, and the kernel would be compiled for both.
            piece = np.ascontiguousarray(height[ra:rb, ca:cb]), np.ascontiguousarray(trusted[ra:rb, ca:cb])
            ground = *piece, np.ascontiguousarray(virtual[ra:rb, ca:cb]), res
            rest = math.tan(max_slope), _gap_cells(res, max_gap), round(WIDE * max_gap / res)
            inner = np.s_[r0 - ra : r1 - ra, c0 - ca : c1 - ca]
            enter = cell_flags(*ground, max_step, *rest)[inner]
            stay = enter
            if keep_step > 0.0 and (enter & (FACE | HOLE | TIP)).any():
                stay = cell_flags(*ground, max_step + keep_step, *rest)[inner]
            _put(flags[r0:r1, c0:c1], enter, stay, ground[1][inner])


@njit(cache=True)
def _put(flags, enter, stay, trusted):
    """Write freshly computed flags: `stay` where the ground was found drivable, `enter` elsewhere; what was assumed stays so."""
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
def _running(values, m, largest, forward):
    """Running maximum or minimum over m cells per axis, starting (forward) or ending at each cell; NaN ignored."""
    rows, cols = values.shape
    out = values.copy()
    for axis in range(2):
        src = out.copy()
        for s in range(1, m):
            dr = s if axis == 0 else 0
            dc = s if axis == 1 else 0
            if forward:
                for r in range(rows - dr):
                    for c in range(cols - dc):
                        z = src[r + dr, c + dc]
                        o = out[r, c]
                        out[r, c] = z if (z > o if largest else z < o) else o
            else:
                for r in range(dr, rows):
                    for c in range(dc, cols):
                        z = src[r - dr, c - dc]
                        o = out[r, c]
                        out[r, c] = z if (z > o if largest else z < o) else o
    return out


@njit(cache=True)
def _unseen(trusted, m):
    """1.0 where an m x m square of untrusted cells covers the cell, else 0.0; none reaches over the border."""
    rows, cols = trusted.shape
    square = np.zeros((rows, cols), np.float32)
    side = np.zeros(cols + 1, np.int32)  # of the largest such square that ends at each cell of this row
    for r in range(rows):
        above_left = 0
        for c in range(cols):
            above = side[c + 1]
            side[c + 1] = 0 if trusted[r, c] else min(min(above, above_left), side[c]) + 1
            above_left = above
            square[r, c] = side[c + 1] >= m
    return _running(square, m, True, True)


@njit(cache=True)
def cell_flags(height, trusted, virtual, res, max_step, max_tan, gap, pit):
    """Flags (rows, cols) uint16 of a map or a piece of one. Cells nearer than `halo` to a cut border are not reliable."""
    rows, cols = height.shape
    flags = np.zeros((rows, cols), np.uint16)
    unmeasured = _unseen(trusted, gap)
    unseen = _unseen(trusted | virtual, gap)
    for r in range(rows):
        for c in range(cols):
            if unseen[r, c]:
                flags[r, c] = UNSEEN
            elif unmeasured[r, c]:
                flags[r, c] = VIRTUAL
    # Closing: what is narrower than the gap limit is bridged.
    z = _running(_running(height, gap, True, True), gap, False, False)
    limit = max_step + STEP_TOLERANCE
    holes = False
    for r in range(rows):
        for c in range(cols):
            if z[r, c] - height[r, c] > limit:
                flags[r, c] |= HOLE
                holes = True
    diff = np.empty((rows, cols), np.float32)
    mean = np.empty((rows, cols), np.float32)
    for direction in range(4):
        dr = 0 if direction == 0 else 1
        dc = (1, 0, 1, -1)[direction]
        scale = res if direction < 2 else res * math.sqrt(2.0)
        n = max(1, round(BASE / scale))
        side = round(0.5 * LATERAL / scale) if res < 0.075 else 0
        lr = dc
        lc = -dr
        slope_cap = max_tan * n * scale
        # diff at c: from c to c + n; the largest so far decides whether there is anything to do in this direction
        largest = np.float32(0.0)
        for r in range(rows):
            for c in range(cols):
                rb = r + n * dr
                cb = c + n * dc
                d = np.float32(0.0)
                if rb < rows and 0 <= cb < cols:
                    d = z[rb, cb] - z[r, c]
                    if d != d:
                        d = np.float32(0.0)
                diff[r, c] = d
                if abs(d) > largest:
                    largest = abs(d)
        if largest <= limit:
            continue
        for r in range(rows):
            for c in range(cols):
                if abs(diff[r, c]) <= 0.5 * limit:
                    # averaged only where the cell itself sees a good part of the step, or the face would be misplaced
                    mean[r, c] = diff[r, c]
                    continue
                total = np.float32(0.0)
                count = 0
                for k in range(-side, side + 1):
                    rr = r + k * lr
                    cc = c + k * lc
                    if 0 <= rr < rows and 0 <= cc < cols:
                        total += diff[rr, cc]
                        count += 1
                mean[r, c] = total / np.float32(count)
        for r in range(rows - n * dr):
            for c in range(max(0, -n * dc), min(cols, cols - n * dc)):
                step = abs(mean[r, c])
                own = abs(diff[r, c])
                if step <= limit and own <= limit + OUTLIER:
                    continue
                # slope common to both sides
                slope = 0.0
                ra = r - n * dr
                ca = c - n * dc
                rb = r + n * dr
                cb = c + n * dc
                if ra >= 0 and 0 <= ca < cols:
                    before = mean[ra, ca]
                    after = mean[rb, cb]
                    common = min(before, after) if mean[r, c] > 0.0 else -max(before, after)
                    slope = min(max(common, 0.0), slope_cap)
                if step - slope <= limit and own - slope <= limit + OUTLIER:
                    continue
                if not (trusted[r, c] or trusted[rb, cb]) and max(step, own) <= UNSEEN_STEP:
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
                flags[r + low * dr, c + low * dc] |= LOW if up else HIGH
                flags[r + high * dr, c + high * dc] |= HIGH if up else LOW
                for k in range(low + 1, high):
                    flags[r + k * dr, c + k * dc] |= FACE
    _complete_corners(z, trusted, flags, limit)
    if holes:
        wide = _running(_running(height, pit, True, True), pit, False, False)
        _mark_tips(z, wide, height, flags, gap, limit)
    return flags


@njit(cache=True)
def _mark_tips(z, wide, height, flags, gap, limit):
    """Mark the bridged tips of a wide pit's corners: the robot has to go around them, as around the pit.

    A pit is wide (`WIDE`) when a larger closing, `wide`, leaves a floor in it; the holes of a stepfield are not, and their
    neighbours may be crossed. Of what is bridged, that within a gap's width of the floor is a tip; beyond it a crack
    leads away, which may be crossed too.
    """
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
def _complete_corners(z, trusted, flags, limit):
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
                near = np.uint16(0)
                for i in range(r - 1, rb + 2):
                    for j in range(c - 1, cb + 2):
                        near |= marked[i, j]
                if near:
                    flags[r, c] |= LOW if jump > 0.0 else HIGH
                    flags[rb, cb] |= HIGH if jump > 0.0 else LOW
