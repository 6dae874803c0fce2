"""A robot that was moved while no scan came: never `good` in a wrong place, and nothing mapped from there."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hal.rotation import rotation_rpy
from hal.safety.monitors import MOVED_WHILE_STILL
from mapping.odometry.health import Health, HealthConfig, HealthMonitor, Verdict
from mapping.odometry.registration.engines import Match
from mapping.odometry.registration.witness import KissConfig, Witness
from tools.bench.perception.basin import Moved, trials


@pytest.fixture(scope="module")
def moved() -> list[Moved]:
    return list(trials(3))


def test_a_wrong_basin_is_never_good(moved: list[Moved]) -> None:
    assert [m.gap for m in moved] == [0.2, 0.9, 2.0]
    assert all(m.far > 0.8 for m in moved)
    assert sum(m.good_while_wrong for m in moved) == 0


def test_nothing_is_mapped_from_a_wrong_place(moved: list[Moved]) -> None:
    assert sum(m.mapped_while_wrong for m in moved) == 0


def test_kiss_icp_finds_robots_that_were_moved(moved: list[Moved]) -> None:
    assert sum(m.health is Health.GOOD and m.off < 0.05 for m in moved) >= 2


def room(seed: int, pose: np.ndarray) -> np.ndarray:
    """Points (n, 3) of a room with an L-shaped wall as seen from `pose` (4, 4)."""
    rng = np.random.default_rng(seed)
    u, v = rng.uniform(-4.0, 4.0, (2, 3000)), rng.uniform(0.0, 2.0, 3000)
    floor = np.stack([u[0], u[1], np.zeros(3000)], axis=1)
    walls = [
        np.stack([u[0], np.full(3000, 4.0), v], axis=1),
        np.stack([np.full(3000, 4.0), u[1], v], axis=1),
        np.stack([np.full(3000, -4.0), u[0], v], axis=1)[u[0] > 0.0],
        np.stack([np.full(3000, -1.0), u[0], v], axis=1)[u[0] < -2.0],
    ]
    world = np.concatenate([floor, *walls])
    return (world - pose[:3, 3]) @ pose[:3, :3]


def at(x: float, yaw: float = 0.0) -> np.ndarray:
    out = np.eye(4)
    out[:3, :3] = rotation_rpy(0.0, 0.0, yaw)
    out[0, 3], out[2, 3] = x, 0.4
    return out


@pytest.mark.parametrize(("creep", "told"), [(0.0, False), (0.03, True)])
def test_kiss_icp_speaks_up_when_the_tracker_creeps_away(creep: float, told: bool) -> None:
    """The robot goes 0.1 m from look to look; the tracker believes `creep` [m] more each time, dead reckoning does
    not."""
    witness = Witness(KissConfig(), 20.0)
    words = []
    for k in range(20):
        if k:
            witness.moved(at(0.0), at(0.1))
        words.append(witness.look(room(k, at(0.1 * k - 1.0)), at((0.1 + creep) * k - 1.0)))
    assert any("KISS-ICP disagrees" in w for w in words) is told


def test_kiss_icp_finds_a_scan_two_metres_away() -> None:
    witness = Witness(KissConfig(), 20.0)
    for k in range(5):
        witness.look(room(k, at(0.0)), at(0.0))
    found = witness.search(room(9, at(1.8, 0.3)), at(0.0, 0.3))
    assert np.abs(found - at(1.8, 0.3)).max() < 0.1


def match(overlap: float, inliers: float, residual: float, pose: np.ndarray) -> Match:
    information = np.diag([0.2, 0.2, 0.6, 2.0, 2.0, 2.0])
    return Match(pose, 1000, overlap, 800, inliers, residual, information)


def test_after_a_strange_scan_others_must_fit_as_well_as_usual() -> None:
    monitor = HealthMonitor(HealthConfig())
    prior = 1e-4 * np.eye(6)
    stamp = 0
    monitor.start(stamp)

    def judged(overlap: float, inliers: float, residual: float, x: float):
        nonlocal stamp
        stamp += 100_000_000
        return monitor.judge(stamp, match(overlap, inliers, residual, at(x)), at(0.0), prior, 30, 0.008)

    for _ in range(20):
        assert judged(0.98, 0.99, 0.012, 0.0).health is Health.GOOD
    elsewhere = judged(0.5, 0.7, 0.06, 0.3)
    assert (elsewhere.use, elsewhere.insert, elsewhere.health) == (False, False, Health.DEGRADED)
    assert not judged(
        0.95, 0.91, 0.035, 0.0
    ).use  # good enough for a map that knows no better, not for this one
    again = [judged(0.98, 0.99, 0.013, 0.0) for _ in range(3)]
    assert [v.insert for v in again] == [False, False, True]
    assert [v.health for v in again] == [Health.DEGRADED, Health.DEGRADED, Health.GOOD]


def test_a_robot_that_fell_is_found_again_where_the_ground_is_rougher_than_level() -> None:
    """On level ground scans lie 7 mm off the map; after a fall of 5 m they fitted by 0.99, 18 mm off, and were refused
    for good."""
    monitor = HealthMonitor(HealthConfig())
    prior = 1e-4 * np.eye(6)
    monitor.start(0)

    def judged(k: int, residual: float, x: float) -> Verdict:
        return monitor.judge(k * 100_000_000, match(0.98, 0.99, residual, at(x)), at(0.0), prior, 30, 0.008)

    assert all(judged(k, 0.007, 0.0).insert for k in range(1, 41))
    assert not judged(41, 0.03, 0.3).use
    assert [judged(k, 0.018, 0.0).insert for k in range(42, 45)] == [False, False, True]


def test_only_scans_in_a_row_say_that_a_robot_moved_while_it_stood() -> None:
    monitor = HealthMonitor(HealthConfig())
    prior = 1e-6 * np.eye(6)
    monitor.start(0)
    off = at(0.0, math.radians(2.5))

    def judged(k: int, pose: np.ndarray, still: bool) -> Verdict:
        found = match(0.98, 0.99, 0.012, pose)
        return monitor.judge((k + 1) * 100_000_000, found, at(0.0), prior, 30, 0.008, still)

    most = round(MOVED_WHILE_STILL.high)
    stood = [judged(k, off, True) for k in range(most)]
    assert all(v.held and not v.strange for v in stood)
    assert not judged(most, off, False).strange, "it drives"
    assert not any(judged(most + 1 + k, off, True).strange for k in range(most))
    assert judged(2 * most + 1, off, True).strange


def test_a_robot_that_is_found_elsewhere_was_not_moved_while_it_stood() -> None:
    monitor = HealthMonitor(HealthConfig())
    prior = 1e-6 * np.eye(6)
    monitor.start(0)
    monitor.doubt("KISS-ICP disagrees")
    verdict = monitor.judge(100_000_000, match(0.98, 0.99, 0.012, at(0.5)), at(0.0), prior, 30, 0.008, True)
    assert verdict.strange
    assert verdict.reason.startswith("scan and dead reckoning disagree")


@pytest.mark.parametrize("tracked", [True, False])
def test_a_second_opinion_alone_does_not_lock_out_a_robot_that_has_just_come_somewhere(tracked: bool) -> None:
    """There scans fit by 0.93 instead of the usual 0.99; refused, they would for ever, because the map learns nothing
    new."""
    monitor = HealthMonitor(HealthConfig())
    prior = 1e-4 * np.eye(6)
    monitor.start(0)
    here = at(0.0)

    def judged(k: int, inliers: float) -> Verdict:
        return monitor.judge(k * 100_000_000, match(0.98, inliers, 0.02, here), here, prior, 30, 0.008)

    for k in range(1, 30):
        assert judged(k, 0.99 if k < 20 else 0.93).insert
    monitor.doubt("KISS-ICP disagrees", tracked=tracked)
    after = [judged(k, 0.93) for k in range(30, 34)]
    assert [v.use for v in after] == [tracked] * 4
    assert [v.insert for v in after] == [False, False, tracked, tracked]
    monitor.doubt("KISS-ICP disagrees", tracked=True)
    assert not judged(45, 0.93).use, "after a gap of more than a second it is no second opinion only"
