"""Hostile input: counted, reported, survived."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from hal.lidar import LIDARS
from hal.safety.monitors import (
    GRAVITY_SIDE,
    GRAVITY_SIZE,
    IMPOSSIBLE_SPEED,
    POINT_TIMES,
    STAMP_AHEAD,
    SWEEP_CLOCK,
    taken_out,
)
from hal.types import NS, POINT_DTYPE, GroundTruth, ImuSample, JointSample, LidarScan, Sample
from mapping.odometry.health import Health
from mapping.odometry.intake import SampleBuffer, SweepClock, TopicClock, clean_scan
from mapping.odometry.pipeline import LidarInertialOdometry, OdometryConfig
from mapping.odometry.types import ScanOdometry
from tools.synthetic import arena_run


@pytest.fixture(scope="module")
def samples() -> list[Sample]:
    """Three seconds, the last two in motion, a sparse XT16."""
    run = replace(arena_run("xt16", duration=3.0, seed=5), lidar=LIDARS["xt16"].decimated(8))
    return [s for s in run.samples() if not isinstance(s, GroundTruth)]


def feed(odometry: LidarInertialOdometry, samples: list[Sample]) -> list[ScanOdometry]:
    out = []
    for sample in samples:
        if isinstance(sample, ImuSample):
            odometry.add_imu(sample)
        elif isinstance(sample, JointSample):
            odometry.add_joints(sample)
        elif isinstance(sample, LidarScan):
            odometry.add_scan(sample)
        out += odometry.poll()
    return out


def sane(results: list) -> bool:
    """Finite, upright, within the arena, in stamp order."""
    stamps = [r.stamp for r in results]
    numbers = [np.concatenate([r.position, r.orientation, r.linear, r.covariance.ravel()]) for r in results]
    return (
        stamps == sorted(set(stamps))
        and bool(np.isfinite(numbers).all())
        and all(np.abs(r.position).max() < 2.0 for r in results)
    )


def with_points(scan: LidarScan, points: np.ndarray) -> LidarScan:
    return LidarScan(scan.stamp, points)


def poison(scan: LidarScan, field: str, value: float) -> LidarScan:
    points = scan.points.copy()
    points[field][::3] = value
    return LidarScan(scan.stamp, points)


def stray(scan: LidarScan, late: float) -> LidarScan:
    points = scan.points.copy()
    points["time"][5] += late
    return LidarScan(scan.stamp, points)


def all_at_once(scan: LidarScan, time: float) -> LidarScan:
    points = scan.points.copy()
    points["time"] = time
    return LidarScan(scan.stamp, points)


SPOILED = {
    "scan_empty": lambda s: with_points(s, s.points[:0]),
    "scan_points_not_finite": lambda s: poison(s, "y", np.nan),
    "scan_points_out_of_time": lambda s: stray(s, 20.0),
    "scan_times": lambda s: poison(s, "time", -3.0),
    "scan_too_many_points": lambda s: with_points(s, np.repeat(s.points, 60)),
    "scan_layout": lambda s: with_points(s, np.zeros((500, 3), np.float32)),  # type: ignore[arg-type]
    "scan_no_usable_points": lambda s: poison(with_points(s, s.points[:1]), "x", np.inf),
}


@pytest.mark.parametrize("kind", SPOILED)
def test_spoiled_scans_are_counted_and_survived(samples: list[Sample], kind: str) -> None:
    scans = [s for s in samples if isinstance(s, LidarScan)]
    bad = {id(s) for s in scans[12:15]}
    odometry = LidarInertialOdometry()
    results = feed(odometry, [SPOILED[kind](s) if id(s) in bad else s for s in samples])
    assert odometry.counters[kind] >= 3
    assert sane(results)
    assert results[-1].health is Health.GOOD


def test_what_was_amiss_beside_a_spoiled_scan_is_told_with_it_and_not_with_the_next(
    samples: list[Sample],
) -> None:
    scans = [s for s in samples if isinstance(s, LidarScan)]
    bad = scans[14]
    kept = [
        with_points(s, s.points[:0]) if s is bad else s
        for s in samples
        if not (isinstance(s, JointSample) and bad.stamp - NS // 2 < s.stamp <= bad.stamp + NS // 100)
    ]
    results = feed(LidarInertialOdometry(), kept)
    (told,) = [k for k, r in enumerate(results) if "scan is empty" in r.reason]
    assert results[told].reason.startswith("scan is empty; no joint data; dead reckoning")
    assert (results[told + 1].health, results[told + 1].reason) == (Health.GOOD, "")


@pytest.mark.parametrize("time", [0.0, 0.05])
def test_equal_point_times_never_abort(samples: list[Sample], time: float) -> None:
    spoiled = [all_at_once(s, time) if isinstance(s, LidarScan) else s for s in samples]
    for engine in ("kiss_icp", "small_gicp"):
        results = feed(LidarInertialOdometry(OdometryConfig(engine=engine)), spoiled)
        assert len(results) > 20
        assert sane(results)


def test_duplicated_and_backward_samples_change_nothing(samples: list[Sample]) -> None:
    clean = feed(LidarInertialOdometry(), samples)
    repeated: list[Sample] = []
    for k, s in enumerate(samples):
        repeated.append(s)
        if k > 40 and k % 7 == 0:
            repeated.append(s)
            repeated.append(samples[k - 30])
    odometry = LidarInertialOdometry()
    results = feed(odometry, repeated)
    assert [r.position.tobytes() for r in results] == [r.position.tobytes() for r in clean]
    assert odometry.counters["imu_duplicate"] > 10
    assert odometry.counters["imu_backward"] > 10


def test_bad_inertial_and_joint_values_are_dropped(samples: list[Sample]) -> None:
    odometry = LidarInertialOdometry()
    spoiled: list[Sample] = []
    for k, s in enumerate(samples):
        if isinstance(s, ImuSample) and k % 10 == 3:
            s = ImuSample(s.stamp, np.array([np.nan, 0, 0]), s.accel)
        elif isinstance(s, ImuSample) and k % 10 == 5:
            s = ImuSample(s.stamp, np.zeros(2), s.accel)
        elif isinstance(s, JointSample) and k % 4 == 1:
            s = JointSample(s.stamp, s.position, np.full(16, np.inf), s.effort)
        spoiled.append(s)
    results = feed(odometry, spoiled)
    assert odometry.counters["imu_impossible"] > 20
    assert odometry.counters["joints_impossible"] > 10
    assert sane(results)
    assert results[-1].health is Health.DEGRADED
    assert "IMU: a turn rate of nan rad/s, possible are -35 to 35" in results[-1].reason


@pytest.mark.parametrize("offset", [1_700_000_000 * NS, -5 * NS])
def test_a_clock_that_is_set_while_running_is_followed(samples: list[Sample], offset: int) -> None:
    """A 1970 boot clock corrected by time synchronisation, and one put back by five seconds."""
    odometry = LidarInertialOdometry()
    when = samples[0].stamp + 3 * NS // 2
    moved = [replace(s, stamp=s.stamp + offset) if s.stamp > when else s for s in samples]
    results = feed(odometry, moved)
    assert 1 <= sum(odometry.counters[f"{t}_clock_jump"] for t in ("imu", "joints", "scan")) <= 2
    assert any("clock was set" in r.reason for r in results)
    assert results[-1].stamp > when + offset
    assert np.isfinite([r.position for r in results]).all()
    assert np.linalg.norm(results[-1].position - results[0].position) < 1.0
    assert results[-1].health is not Health.LOST


def test_one_wrong_stamp_is_not_a_new_clock(samples: list[Sample]) -> None:
    odometry = LidarInertialOdometry()
    clean = feed(LidarInertialOdometry(), samples)
    wrong: list[Sample] = []
    for k, s in enumerate(samples):
        wrong.append(s)
        if k % 50 == 20:
            wrong.append(replace(s, stamp=s.stamp + 10**18 if k % 100 == 20 else 5))
    results = feed(odometry, wrong)
    assert [r.position.tobytes() for r in results] == [r.position.tobytes() for r in clean]
    assert sum(odometry.counters[f"{t}_strange_stamp"] for t in ("imu", "joints", "scan")) > 10
    assert not any("jump" in name for name in odometry.counters)


@given(data=st.data())
@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_random_garbage_never_raises(samples: list[Sample], data: st.DataObject) -> None:
    rng = np.random.default_rng(data.draw(st.integers(0, 2**31)))
    odometry = LidarInertialOdometry()
    stream: list[Sample] = []
    for s in samples[:400]:
        dice = rng.random()
        stamp = s.stamp
        if dice < 0.05:
            stamp = int(rng.choice([0, -1, 5, s.stamp - NS, s.stamp + NS, 2**61, 2**63 - 1]))
        if isinstance(s, ImuSample) and dice < 0.1:
            stream.append(
                ImuSample(stamp, rng.normal(size=3) * 10 ** rng.uniform(0, 6), s.accel * rng.normal())
            )
        elif isinstance(s, JointSample) and dice < 0.1:
            junk = rng.normal(size=16) * 10 ** rng.uniform(0, 6)
            stream.append(JointSample(stamp, junk, junk, rng.choice([0.0, np.nan, 1e30]) * junk))
        elif isinstance(s, LidarScan) and dice < 0.3:
            points = np.frombuffer(rng.bytes(POINT_DTYPE.itemsize * int(rng.integers(0, 300))), POINT_DTYPE)
            stream.append(LidarScan(stamp, points))
        else:
            stream.append(replace(s, stamp=stamp))
    with np.errstate(all="ignore"):
        results = feed(odometry, stream)
    assert np.isfinite([np.concatenate([r.position, r.orientation]) for r in results]).all()


def test_topic_clock_follows_only_a_confirmed_jump() -> None:
    from collections import Counter

    counters: Counter[str] = Counter()
    clock = TopicClock("imu", 3, counters)
    stamps = [round(t * NS) for t in (100, 100.1, 100.1, 100)]
    assert [clock.admit(t) for t in stamps] == ["ok", "ok", "drop", "drop"]
    assert [clock.admit(round(t * NS)) for t in (5000, 100.2)] == ["drop", "ok"]
    assert [clock.admit(5000 * NS + k) for k in range(3)] == ["drop", "drop", "jump"]
    assert clock.newest == 5000 * NS + 2
    assert clock.admit("now") == "drop"
    assert [clock.admit(5003 * NS + k) for k in range(4)] == ["ahead", "ahead", "ok", "ok"]
    assert counters == {
        "imu_duplicate": 1,
        "imu_backward": 1,
        "imu_strange_stamp": 5,
        "imu_clock_jump": 1,
        "imu_stamp": 1,
    }


def test_sample_buffer_cuts_by_stamp() -> None:
    buffer = SampleBuffer(1, 5)
    for k in range(8):
        buffer.append(k, np.array([10.0 * k]))
    stamps, rows = buffer.between(3, 5)
    assert stamps.tolist() == [4, 5]
    assert rows.tolist() == [[40.0], [50.0]]
    assert buffer.between(3, 5, beyond=1)[0].tolist() == [4, 5, 6]
    assert buffer.between(0, 9)[0].tolist() == [3, 4, 5, 6, 7]
    buffer.forget(6)
    assert buffer.between(0, 9)[0].tolist() == [7]
    assert buffer.between(7, 9)[0].shape == (0,)


def test_scan_end_is_the_last_point_in_time() -> None:
    from collections import Counter

    points = np.zeros(4, POINT_DTYPE)
    points["x"] = (1.0, 2.0, 100.0, 3.0)
    points["time"] = (0.01, 0.02, 0.09, 7.0)
    sweep = clean_scan(LidarScan(NS, points), 0.4, 20.0, 1000, Counter())
    assert sweep is not None
    assert sweep.end == pytest.approx(NS + 90_000_000, abs=10)
    assert sweep.xyz[:, 0].tolist() == [1.0, 2.0]


def test_warm_up_goes_through_every_step(monkeypatch: pytest.MonkeyPatch) -> None:
    results: list = []
    poll = LidarInertialOdometry.poll
    monkeypatch.setattr(LidarInertialOdometry, "poll", lambda self: results.extend(poll(self)) or results)
    odometry = LidarInertialOdometry()
    odometry.warm_up()
    assert len(results) >= 3
    assert all(r.health is Health.GOOD for r in results)
    assert not odometry.initialised
    assert not odometry.counters


@pytest.mark.parametrize("before", [0.0, -0.4])
def test_usable_points_equal_numpy(before: float) -> None:
    """Stamped at the begin, or at the end."""
    rng = np.random.default_rng(4)
    points = np.zeros(4000, POINT_DTYPE)
    for axis in "xyz":
        points[axis] = rng.uniform(-8.0, 8.0, len(points))
        points[axis][rng.integers(0, len(points), 40)] = rng.choice([np.nan, np.inf, -np.inf], 40)
    points["time"] = before + rng.uniform(0.0, 0.4, len(points))
    points["time"][rng.integers(0, len(points), 40)] = np.nan
    points["time"][rng.integers(0, len(points), 40)] = rng.uniform(2.0, 9.0, 40)
    counters: Counter[str] = Counter()
    sweep = clean_scan(LidarScan(7 * NS, points), 1.0, 10.0, 100_000, counters)
    assert sweep is not None

    xyz = np.stack([points[axis] for axis in "xyz"], axis=1)
    time = points["time"].astype(np.float64)
    finite = np.isfinite(xyz).all(axis=1) & np.isfinite(time)
    in_time = finite & (time <= 0.4)
    square = (xyz[:, 0] * xyz[:, 0] + xyz[:, 1] * xyz[:, 1]) + xyz[:, 2] * xyz[:, 2]
    keep = in_time & (square >= np.float32(1.0)) & (square <= np.float32(100.0))
    assert 0 < keep.sum() < in_time.sum() < finite.sum() < len(points)
    shift = time[in_time].min() if before else 0.0
    np.testing.assert_array_equal(sweep.xyz, xyz[keep])
    np.testing.assert_allclose(sweep.time, time[keep] - shift, rtol=0.0, atol=0.0 if not before else 1e-12)
    assert sweep.start == 7 * NS + round(float(shift) * NS)
    assert sweep.end == sweep.start + round(float((time - shift)[in_time].max()) * NS)
    assert counters["scan_points_not_finite"] == (~finite).sum()
    assert counters["scan_points_out_of_time"] == (finite & ~in_time).sum()


@pytest.mark.parametrize("miss", [0.0, np.nan])
def test_points_that_hit_nothing_have_no_time(miss: float) -> None:
    points = np.zeros(1000, POINT_DTYPE)
    points["x"], points["time"] = 5.0, np.linspace(0.0, 0.1, 1000)
    points["x"][::2], points["time"][::2] = miss, -7.0
    counters: Counter[str] = Counter()
    sweep = clean_scan(LidarScan(NS, points), 0.4, 20.0, 10_000, counters)
    assert sweep is not None
    assert (len(sweep.xyz), sweep.problem) == (500, "")
    assert sweep.end == pytest.approx(1.1 * NS, abs=100)
    assert counters["scan_points_not_finite"] == (0 if miss == 0.0 else 500), "0, 0, 0 is a sound miss"


def test_times_of_no_sweep_are_refused_with_what_the_field_held() -> None:
    points = np.zeros(1000, POINT_DTYPE)
    points["x"], points["time"] = 5.0, np.linspace(0.0, 0.1, 1000)
    points["time"][::3] = -3.0
    sweep = clean_scan(LidarScan(NS, points), 0.4, 20.0, 10_000, Counter())
    assert sweep is not None
    assert len(sweep.xyz) == 0
    assert sweep.problem.startswith("point field 'time' holds -3 to 0.09")


def moved(results: list[ScanOdometry], clean: list[ScanOdometry]) -> float:
    """How far results came off those of the same stamp without a fault [m]."""
    true = {r.stamp: r.position for r in clean}
    return max(float(np.linalg.norm(r.position - true[r.stamp])) for r in results if r.stamp in true)


@pytest.mark.parametrize("ahead", [0.3, pytest.param(3.0, marks=pytest.mark.campaign)])
def test_one_imu_stamp_ahead_costs_its_sample_and_is_told(samples: list[Sample], ahead: float) -> None:
    def run() -> tuple[float, list[str]]:
        at = [k for k, s in enumerate(samples) if isinstance(s, ImuSample)][420]
        wrong = [
            replace(s, stamp=s.stamp + round(ahead * NS)) if k == at else s for k, s in enumerate(samples)
        ]
        results = feed(LidarInertialOdometry(), wrong)
        return moved(results, feed(LidarInertialOdometry(), samples)), [r.reason for r in results]

    off, reasons = run()
    assert off < 0.005
    assert sum(f"IMU: a stamp {ahead:.1f} s ahead of the one before" in r for r in reasons) == 1
    with taken_out(STAMP_AHEAD.name):
        assert not any("ahead" in r for r in run()[1])


@pytest.mark.parametrize(
    "step",
    [
        -0.08,
        0.08,
        0.9,
        -7.0,
        *(pytest.param(step, marks=pytest.mark.campaign) for step in (-0.3, 0.15, 0.25, 50.0)),
    ],
)
def test_a_lidar_whose_clock_steps_alone_is_not_used_and_the_text_names_its_clock(
    samples: list[Sample], step: float
) -> None:
    when = samples[0].stamp + 2 * NS
    wrong = [
        replace(s, stamp=s.stamp + round(step * NS)) if isinstance(s, LidarScan) and s.stamp > when else s
        for s in samples
    ]
    odometry = LidarInertialOdometry()
    results = feed(odometry, wrong)
    assert results[-1].stamp <= when + NS // 5, "no sweep of the wrong clock is registered"
    told = odometry._inbox.refused()
    assert told == [f"the clock of the main LiDAR is {step:+.2f} s off the IMU's, its sweeps are not used"]
    with taken_out(SWEEP_CLOCK.name):
        odometry = LidarInertialOdometry()
        feed(odometry, wrong)
        assert not odometry._inbox.refused()


def test_sweeps_that_go_on_while_the_next_ones_come_are_refused_by_their_times(samples: list[Sample]) -> None:
    """A tenth of the points is told 0.15 s late: too many for strays, too near for another sweep."""
    when = samples[0].stamp + 2 * NS

    def spoiled(scan: LidarScan) -> LidarScan:
        points = scan.points.copy()
        points["time"][::10] += 0.15
        return replace(scan, points=points)

    wrong = [spoiled(s) if isinstance(s, LidarScan) and s.stamp > when else s for s in samples]
    odometry = LidarInertialOdometry()
    results = feed(odometry, wrong)
    assert results[-1].stamp <= when + NS // 5
    (told,) = odometry._inbox.refused()
    assert told.startswith("point field 'time' holds 0.25 s of a sweep that comes every 0.10 s")
    with taken_out(POINT_TIMES.name):
        assert feed(LidarInertialOdometry(), wrong)[-1].stamp > when + NS // 2


def test_a_lidar_that_loses_sweeps_beside_an_imu_whose_samples_wait_is_used_again(
    samples: list[Sample],
) -> None:
    """A hole in its stamps and an early sweep together tell a step of its clock, each of the two alone tells none."""
    clock, period, told = SweepClock(), NS // 10, {}
    early = {20: 0.08, 40: 0.08}
    for k in range(60):
        if k in (29, 39):
            continue
        start = NS + k * period
        imu = start + period + round((0.02 - early.get(k, 0.0)) * NS)
        told[k] = clock.off(start, start + period, imu, 20 * k)
    assert {k: off for k, off in told.items() if off} == {40: pytest.approx(0.08)}


@pytest.mark.parametrize("late", [0.1, 0.3])
def test_sweeps_that_are_late_agree_with_the_imu(samples: list[Sample], late: float) -> None:
    """Their stamps are right: they are used, and the pose is the same."""
    when = samples[0].stamp + 2 * NS
    late_ns = round(late * NS)
    order = sorted(
        samples,
        key=lambda s: (
            s.stamp
            + (late_ns if isinstance(s, LidarScan) and s.stamp > when else 0)
            + (NS // 10 if isinstance(s, LidarScan) else 0)
        ),
    )
    odometry = LidarInertialOdometry()
    results = feed(odometry, order)
    assert results[-1].stamp > when + NS // 2
    assert moved(results, feed(LidarInertialOdometry(), samples)) < 0.01
    assert not any("clock" in r.reason for r in results)


@pytest.mark.parametrize(
    ("scale", "words"), [(1 / 9.81, "its unit is wrong"), (-1.0, "signs or units are wrong")]
)
def test_an_imu_of_another_unit_or_side_is_refused_and_told(
    samples: list[Sample], scale: float, words: str
) -> None:
    when = samples[0].stamp + 3 * NS // 2
    wrong = [
        replace(s, accel=scale * s.accel) if isinstance(s, ImuSample) and s.stamp > when else s
        for s in samples
    ]
    results = feed(LidarInertialOdometry(), wrong)
    assert any(words in r.reason for r in results)
    assert results[-1].health is not Health.GOOD
    off = moved(results, feed(LidarInertialOdometry(), samples))
    assert off < 0.3, "it is dead reckoned, and degraded"
    from_the_start = feed(
        LidarInertialOdometry(),
        [replace(s, accel=scale * s.accel) if isinstance(s, ImuSample) else s for s in samples],
    )
    assert not any(r.health is Health.GOOD for r in from_the_start)
    with taken_out(GRAVITY_SIZE.name, GRAVITY_SIDE.name, IMPOSSIBLE_SPEED.name):
        assert moved(feed(LidarInertialOdometry(), wrong), feed(LidarInertialOdometry(), samples)) > 1.0
