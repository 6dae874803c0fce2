"""Rates and paired differences, with resamples of whole queries: the draws of one query hardly differ."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

RESAMPLE_COUNT = 10_000
Record = dict[str, Any]
Value = Callable[[Record], float]
Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Difference:
    """Of a method against another, on the same trials."""

    value: float
    low: float
    high: float
    """95 % interval."""
    least: float
    """Lower bound at 80 % confidence."""
    trials: int


def end_to_end(record: Record) -> float:
    """Success among all trials."""
    return float(record["success"])


def by_trial(records: Sequence[Record], method: str) -> dict[tuple[Any, ...], Record]:
    """Records of a method by what they share with those of another method."""
    mine = [r for r in records if r["method"] == method]
    return {(r["scene"], r["query"], r["draw"], r["controller"], r["colliders"]): r for r in mine}


def sums(
    trials: Sequence[tuple[Any, ...]], records: dict[tuple[Any, ...], Record], value: Value
) -> dict[str, Array]:
    """Per scene (queries, 2): sum of the values of a query's trials and their number."""
    out: dict[str, dict[int, list[float]]] = {}
    for trial in trials:
        cell = out.setdefault(trial[0], {}).setdefault(trial[1], [0.0, 0.0])
        cell[0] += value(records[trial])
        cell[1] += 1.0
    return {scene: np.array([cells[q] for q in sorted(cells)]) for scene, cells in out.items()}


def resampled(scenes: dict[str, Array], seed: int = 0) -> Array:
    """(RESAMPLE_COUNT,) ratio of summed values to summed numbers; queries are drawn within their scene, the same for
    the same seed."""
    rng = np.random.default_rng(seed)
    total = np.zeros((RESAMPLE_COUNT, 2))
    for scene in sorted(scenes):
        cells = scenes[scene]
        total += cells[rng.integers(0, len(cells), (RESAMPLE_COUNT, len(cells)))].sum(axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(total[:, 0] / total[:, 1])


def mean(scenes: dict[str, Array]) -> float:
    """The same ratio of the trials as they are."""
    total = sum((c.sum(axis=0) for c in scenes.values()), np.zeros(2))
    return float(total[0] / total[1]) if total[1] else float("nan")


def interval(records: Sequence[Record], value: Value = end_to_end) -> tuple[float, float]:
    """95 % interval of the mean value of trials of one method."""
    if not records:
        return float("nan"), float("nan")
    keyed = {(r["scene"], r["query"], k): r for k, r in enumerate(records)}
    low, high = np.nanpercentile(resampled(sums(list(keyed), keyed, value)), [2.5, 97.5])
    return float(low), float(high)


def difference(
    records: Sequence[Record],
    method: str,
    base: str,
    value: Value = end_to_end,
    counts: Callable[[Record], bool] = lambda r: True,
) -> Difference | None:
    """`method` minus `base` on the trials that count for both; None without any."""
    mine, theirs = by_trial(records, method), by_trial(records, base)
    both = sorted(t for t in mine.keys() & theirs.keys() if counts(mine[t]) and counts(theirs[t]))
    if not both:
        return None
    a, b = sums(both, mine, value), sums(both, theirs, value)
    spread = resampled(a) - resampled(b)
    low, least, high = np.nanpercentile(spread, [2.5, 20.0, 97.5])
    return Difference(mean(a) - mean(b), float(low), float(high), float(least), len(both))
