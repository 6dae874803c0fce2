"""Times of sweeps: strays cost themselves, units are recognised, what is none is told."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hal.safety.monitors import POINT_TIMES, taken_out
from hal.sweep_times import UNITS, TimesError, sweep_times
from hal.types import NS


@given(
    st.integers(30, 3000),
    st.sampled_from(list(UNITS)),
    st.sampled_from([0.0, 5.0, 1.7e9]),
    st.floats(0.02, 0.4),
    st.floats(0.5, 1e4),
    st.integers(0, 2**32 - 1),
)
@settings(max_examples=100, deadline=None)
def test_a_stray_moves_neither_end_by_more_than_a_hole(
    n: int, unit: float, begin: float, lasts: float, off: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    true = np.sort(rng.uniform(0.0, lasts, n))
    at = int(rng.integers(n))
    times = true.copy()
    times[at] = rng.choice([-off, 1.0 + off]) * lasts
    found = sweep_times((begin + times) / unit, np.ones(n, bool))
    assert found.unit == unit
    assert not found.inside[at]
    others = np.delete(np.arange(n), at)
    # a random sweep has holes of its own at its ends, rarely
    assert found.inside[others].mean() > 0.9
    assert found.first / NS == pytest.approx(begin, abs=0.35 * lasts)
    seconds = found.seconds(since_first=True)[found.inside]
    assert seconds.min() >= 0.0
    assert seconds.max() <= lasts + 1e-6


def test_without_the_monitor_one_stray_moves_the_end() -> None:
    times = np.linspace(0.0, 0.1, 500)
    times[3] = 0.4
    hit = np.ones(500, bool)
    assert sweep_times(times, hit).seconds(since_first=True)[
        sweep_times(times, hit).inside
    ].max() == pytest.approx(0.1)
    with taken_out(POINT_TIMES.name):
        assert sweep_times(times, hit).seconds(since_first=True).max() == pytest.approx(0.4)


@pytest.mark.parametrize(
    "times",
    [
        np.full(100, np.nan),
        np.where(np.arange(100) % 3, np.linspace(0.0, 0.1, 100), 20.0),
        np.linspace(0.0, 1e12, 100),
        np.linspace(0.0, 2.0, 100),
        np.linspace(1e300, 2e300, 100),
    ],
    ids=["nan", "two heaps", "too long", "two seconds", "huge"],
)
def test_what_is_no_sweep_is_told(times: np.ndarray) -> None:
    with pytest.raises(TimesError):
        sweep_times(times, np.ones(100, bool))


def test_a_known_unit_reads_a_few_points_right() -> None:
    few = np.array([5_000_000, 5_100_000, 5_200_000], np.uint32)
    hit = np.ones(3, bool)
    assert sweep_times(few, hit).unit == 1e-6, "0.2 ms of nanoseconds look like 0.2 s of microseconds"
    assert sweep_times(few, hit, 1e-9).seconds(since_first=True)[-1] == pytest.approx(0.0002)


@given(st.binary(min_size=8, max_size=400), st.sampled_from(["<f4", "<f8", "<u4", "<i4", "<u8", "u1"]))
@settings(max_examples=200, deadline=None)
def test_no_bytes_are_a_crash(data: bytes, kind: str) -> None:
    field = np.frombuffer(data[: len(data) // 8 * 8], kind)
    with np.errstate(all="ignore"):
        try:
            seconds = sweep_times(field, np.ones(len(field), bool)).seconds(since_first=True)
        except TimesError:
            return
    kept = seconds[np.isfinite(seconds)]
    assert (kept >= 0.0).all()
    assert (kept <= 1.0).all()
