"""A remote clock: never is a sample taken for younger than it is, and what is over is over."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hal.safety.monitors import CLOCK_DRIFT, CLOCK_STEP, taken_out
from hal.types import NS
from hal.unitree.clock import ON_TIME, SUPPORT_COUNT, RemoteClock

HOST = 1_700_000_000 * NS
MS = NS // 1000


def hear(
    clock: RemoteClock, host: int, delay: int, base: int = 0, drift: float = 0.0, gap: int = 1
) -> float | None:
    """A message of host time `host` comes `delay` later; by how much [s] it is taken for younger than it is, None where
    it is refused."""
    stamp = round((host - HOST) * (1.0 + drift)) + base
    if not clock.hear(stamp, host + delay, gap=gap):
        return None
    return (clock.date(stamp, host + delay) - host) / NS


@pytest.mark.parametrize("base", [0, -1_700_000_000 * NS, 55 * NS])
def test_offset_is_found_within_the_smallest_delay(base: int) -> None:
    rng = np.random.default_rng(2)
    clock = RemoteClock()
    errors = []
    for k in range(2000):
        errors.append(hear(clock, HOST + k * 20 * MS, MS + int(rng.exponential(8 * MS)), base))
    late = [e for e in errors[100:] if e is not None]
    assert len(late) == 1900
    assert max(late) < 0.003
    assert min(late) > 0.0009
    assert clock.steps == 0


@pytest.mark.parametrize("drift", [50e-6, -90e-6])
def test_slow_drift_is_followed(drift: float) -> None:
    clock = RemoteClock()
    errors = [hear(clock, HOST + k * NS // 100, MS, drift=drift) for k in range(30_000)]
    assert all(e is not None and abs(e) < 0.002 for e in errors)


@pytest.mark.parametrize("delay", [0.1, 0.6, 1.2, 30.0])
def test_a_delay_stays_a_delay_for_as_long_as_it_lasts_and_is_gone_at_once(delay: float) -> None:
    clock = RemoteClock()
    for k in range(500):
        hear(clock, HOST + k * 10 * MS, MS)
    younger = [hear(clock, HOST + 5 * NS + k * 10 * MS, MS + round(delay * NS)) for k in range(60_000)]
    assert max(e for e in younger if e is not None) < 0.002
    assert clock.late() == pytest.approx(delay, abs=0.001)
    assert not clock.doubtful
    assert clock.steps == 0
    last = HOST + 605 * NS + round(delay * NS)
    assert hear(clock, last, MS) == pytest.approx(0.001, abs=0.001)
    assert clock.late() < 0.001


def test_without_the_monitor_a_delay_becomes_the_offset() -> None:
    clock = RemoteClock()
    with taken_out(CLOCK_DRIFT.name):
        younger = [hear(clock, HOST + k * 10 * MS, MS if k < 500 else 600 * MS) for k in range(1000)]
    assert younger[-1] is not None
    assert younger[-1] > 0.5


@pytest.mark.parametrize("late", [1, 2, 30])
def test_the_first_messages_may_be_late(late: int) -> None:
    clock = RemoteClock()
    errors = [hear(clock, HOST + k * 100 * MS, 600 * MS if k < late else MS) for k in range(late + 10)]
    refused = [e for e in errors[late:] if e is None]
    assert len(refused) < SUPPORT_COUNT
    assert errors[-1] == pytest.approx(0.001, abs=0.0001)


@pytest.mark.parametrize("at", [0, 1, 30])
@pytest.mark.parametrize("ahead", [0.02, 0.3, 3.0, 1e9, -0.08, -0.3, -3.0, -1e8])
def test_one_wrong_stamp_changes_nothing(ahead: float, at: int) -> None:
    clock = RemoteClock()
    for k in range(60):
        base = round(ahead * NS) if k == at else 0
        younger = hear(clock, HOST + k * 100 * MS, MS, base, gap=50 * MS)
        if k == at > SUPPORT_COUNT and abs(ahead) > 0.1:
            assert younger is None
        elif k > at + SUPPORT_COUNT + 1:
            assert younger == pytest.approx(0.001, abs=0.0001)
    assert clock.steps == 0


@pytest.mark.parametrize("step", [-0.07, -0.3, -0.9, -5.0, -1.6e9, 0.07, 0.3, 0.9, 5.0, 1.6e9])
def test_a_step_of_the_clock_is_followed_named_and_never_makes_a_sample_younger(step: float) -> None:
    clock = RemoteClock()
    errors = []
    for k in range(100):
        base = round(step * NS) if k >= 50 else 0
        errors.append(hear(clock, HOST + k * 100 * MS, MS, base, gap=50 * MS))
    assert all(e is not None for e in errors[:50])
    assert sum(e is None for e in errors[50:]) <= SUPPORT_COUNT
    assert all(e is None or abs(e - 0.001) < 0.0001 for e in errors[50:])
    assert clock.steps == 1
    assert clock.step / NS == pytest.approx(step, abs=0.002)


@pytest.mark.parametrize("without", [False, True])
def test_stamps_that_went_back_once_are_refused(*, without: bool) -> None:
    """One message of another clock, which no step of this one explains."""
    clock = RemoteClock()
    with taken_out(*([CLOCK_STEP.name] if without else [])):
        for k in range(60):
            younger = hear(clock, HOST + k * 100 * MS, MS, -40 * MS if k == 50 else 0, gap=95 * MS)
            assert k != 50 or (younger is None) is not without


def test_a_source_that_answers_is_asked_before_a_step_back_is_believed() -> None:
    clock = RemoteClock(answers=True)
    for k in range(200):
        younger = hear(clock, HOST + k * 20 * MS, MS, -600 * MS if k >= 100 else 0)
    assert younger is None
    assert clock.doubtful
    assert clock.back == pytest.approx(0.6, abs=0.01)
    clock.restart(HOST + 4 * NS)
    assert hear(clock, HOST + 4 * NS, MS, -600 * MS) == pytest.approx(0.001, abs=0.0001)
    assert not clock.doubtful
    assert clock.step == -600 * MS


@pytest.mark.parametrize(("silent", "doubtful"), [(0.6, False), (5.0, True)])
def test_a_step_while_nothing_came_is_doubtful_and_a_queue_that_lost_nothing_is_not(
    silent: float, doubtful: bool
) -> None:
    """Both come 0.6 s late after it: the one has a hole in its stamps."""
    clock = RemoteClock(answers=True)
    for k in range(100):
        hear(clock, HOST + k * 20 * MS, MS)
    at = HOST + 2 * NS + round((silent - 0.6) * NS)
    assert hear(clock, at, 600 * MS) is not None
    assert clock.doubtful == doubtful


@st.composite
def _ways(draw: st.DrawFn) -> list[tuple[int, int, float]]:
    """Pieces of a way: messages, delay [ns], share of jitter."""
    piece = st.tuples(
        st.integers(5, 200), st.sampled_from([0, 0, 0, 100, 300, 600, 1200]), st.floats(0.0, 1.0)
    )
    return [(n, delay * MS, jitter) for n, delay, jitter in draw(st.lists(piece, min_size=1, max_size=8))]


@given(_ways(), st.floats(-100e-6, 100e-6), st.sampled_from([20, 100]), st.integers(0, 2**32 - 1))
@settings(max_examples=60, deadline=None)
def test_no_sample_is_taken_for_younger_than_it_is(
    ways: list[tuple[int, int, float]], drift: float, period: int, seed: int
) -> None:
    """Whatever the way does once the first messages came on time, in order: at most jitter and drift; and it is well
    again when the way is."""
    rng = np.random.default_rng(seed)
    clock = RemoteClock()
    host, came, older = HOST, 0, []
    for n, delay, jitter in [(30, 0, 0.3), *ways, (30, 0, 0.3)]:
        host = host if delay else max(host, came)  # the queue has emptied
        for _ in range(n):
            host += period * MS
            came = max(came + 1, host + MS + delay + int(rng.exponential(8 * MS * jitter + 1)))
            older.append(hear(clock, host, came - host, 123 * NS, drift))
    taken = [e for e in older if e is not None]
    # what the clock learnt while on time, in three of ten readings, and what it may have drifted since
    assert max(taken) < 0.02 + 2 * CLOCK_DRIFT.high * 1e-6 * (host - HOST) / NS
    assert len(taken) > 0.9 * len(older)
    assert abs(clock.late()) < ON_TIME / NS + 0.1
