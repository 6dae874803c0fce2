"""When the points of a sweep were measured: unit and outliers of a driver's time field, judged by the points with a
return."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hal.safety.monitors import POINT_TIMES
from hal.types import NS, Array

SHORTEST, LONGEST = POINT_TIMES.low, POINT_TIMES.high
UNITS = {1.0: NS, 1e-3: NS // 10**3, 1e-6: NS // 10**6, 1e-9: 1}
"""Seconds, milli-, micro- and nanoseconds: each in [s] and in [ns]. Sweeps last 10 to 600 ms, so the spread tells
which."""
EDGE_PARTS = 20
"""One of so many points at either end may be a stray."""
HOLE_SHARE = 0.25
"""Share of the spread of the others without any point, beyond which those that follow are strays."""
FILLED_PARTS = 5
"""Of 20 equal parts of the spread so many have points, where it is not in seconds: two heaps are no sweep."""


class TimesError(ValueError):
    """The times are none of a sweep. The message tells what the field held."""


@dataclass(frozen=True, slots=True, eq=False)
class SweepTimes:
    """Times of the points of one sweep."""

    first: int
    """Of the first point [ns], from wherever the field counts."""
    unit: float
    """[s] of the field."""
    inside: NDArray[np.bool_]
    """(n,) False for strays and for points that hit nothing."""
    values: NDArray
    """(n,) in `unit`, float64 or int64."""
    begin: float
    """The value of the first point."""

    def seconds(self, *, since_first: bool) -> Array:
        """(n,) since the first point or else from where the field counts [s]; NaN for what is not inside."""
        out = np.full(len(self.values), np.nan)
        values = self.values[self.inside]
        out[self.inside] = (values - self.begin if since_first else values) * self.unit
        return out


def sweep_times(
    field: NDArray, hit: NDArray[np.bool_], unit: float | None = None, near: int = 0
) -> SweepTimes:
    """Read a time `field` (n,) of any numeric type; `hit` (n,): the points that are a return, the times of others may
    be anything.

    `unit` [s]: where it is known; otherwise it is recognised. `near` [ns]: about that time, for a field of one value.
    Raises TimesError."""
    whole = np.issubdtype(field.dtype, np.integer)
    values = np.clip(field, -(2**62), 2**62 - 1).astype(np.int64) if whole else field.astype(np.float64)
    good = hit if whole else hit & np.isfinite(values)
    n = int(np.count_nonzero(good))
    if n == 0:
        if hit.any():
            raise TimesError("no number")
        return SweepTimes(0, unit or 1.0, good, values, 0)
    if not POINT_TIMES.active:
        unit = unit or (1e-9 if whole else 1.0)
        begin = values[good].min()
        return SweepTimes(round(float(begin) * UNITS[unit]), unit, good, values, begin)
    edge = max(1, n // EDGE_PARTS) if n > 3 else 0
    ordered = np.partition(values[good], [edge, n - 1 - edge])
    low, high = ordered[edge], ordered[n - 1 - edge]
    core = ordered[edge : n - edge]
    if unit is None:
        unit = _unit(core, float(low), float(high - low), whole, near)
    if not (high - low) * unit <= LONGEST or not abs(float(low)) * unit < 2.0**33:
        raise TimesError(f"{low:g} to {high:g}")
    hole = max(HOLE_SHARE, 3.0 / len(core)) * float(high - low)
    begin = low - _reach(np.sort(low - ordered[:edge]), hole)
    end = high + _reach(np.sort(ordered[n - edge :] - high), hole)
    inside = good & (values >= begin) & (values <= end)
    first = int(begin) * UNITS[unit] if whole else round(float(begin) * UNITS[unit])
    return SweepTimes(first, unit, inside, values, begin)


def _reach(beyond: NDArray, hole: float) -> float:
    """How far the points that lie `beyond` (k,) ascending go on without a hole."""
    steps = np.diff(beyond, prepend=0)
    holes = np.flatnonzero(steps > hole)
    kept = beyond[: holes[0]] if len(holes) else beyond
    return kept[-1] if len(kept) else 0


def _unit(core: NDArray, low: float, spread: float, whole: bool, near: int) -> float:
    if not whole and spread <= LONGEST:
        if spread > 0.0 or abs(low) <= LONGEST:
            return 1.0
        return min(UNITS, key=lambda unit: abs(low * unit - near / NS))  # one value: told by its size
    for unit in UNITS:
        if (unit < 1.0 or not whole) and SHORTEST <= spread * unit <= LONGEST:
            parts = (core[:: 1 + len(core) // 2000] - low) * (20.0 / spread)
            if len(np.unique(np.minimum(parts.astype(np.int64), 19))) >= FILLED_PARTS or len(core) < 20:
                return unit
            break
    if whole and spread * 1e-9 < SHORTEST:
        return 1e-9
    raise TimesError(f"{low:g} to {low + spread:g}")
