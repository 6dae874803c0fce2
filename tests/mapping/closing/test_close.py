"""Short made-up drives with an odometry that drifts: the loop closes, the drift goes, and what looks alike is
refused."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import pytest

from hal.types import Array
from mapping.closing import Closed, Closing, Recording, corrected, fuse
from mapping.closing.close import ODOMETRY_GATE
from mapping.closing.fuse import ElevationConfig
from mapping.closing.graph import after, back, between, levelled
from mapping.closing.verify import ENOUGH_CERTAINTY, Match, pose_of, rivals
from tools.closing import HEIGHT, Drift, Drive, drifted, record, ring, twins, way_through

PARAMS = ElevationConfig(resolution=0.08)
STRONG = Drift(bend=math.radians(0.02), climb=0.004)
"""Some times what the odometry has: a drive of 50 m says enough then."""
MORE = 6.0
"""Times the drift that is expected of it."""


def errors(poses: Array, truth: Array) -> tuple[float, float]:
    """Largest error of poses (n, 4, 4): place [m], heading [deg]."""
    place = np.linalg.norm(poses[:, :3, 3] - truth[:, :3, 3], axis=1).max()
    turned = np.einsum("nji,njk->nik", truth[:, :3, :3], poses[:, :3, :3])
    return float(place), float(np.degrees(np.abs(np.arctan2(turned[:, 1, 0], turned[:, 0, 0]))).max())


def true_loops(closed: Closed, truth: Array) -> Array:
    """(n,) how far off each closed loop is from the truth [m]."""
    grounds = [levelled(truth[frame.scan], HEIGHT) for frame in closed.keyframes]
    off = [
        loop.match.relative - between(grounds[loop.match.first], grounds[loop.match.second])
        for loop in closed.loops
    ]
    return np.linalg.norm(np.array(off).reshape(-1, 4)[:, :3], axis=1)


@pytest.fixture(scope="module")
def round_trip() -> Iterator[tuple[Recording, Array, Closed]]:
    scene, corners = ring(half=(5.0, 3.5))
    truth = way_through(scene, corners, step=0.7)
    recording = Recording()
    record(recording, 0, Drive(scene, truth, drifted(truth, STRONG, 3)))
    yield recording, truth, Closing(recording, PARAMS, levelled(truth[0], HEIGHT), MORE).close()
    recording.close()


def test_a_loop_that_closes_takes_the_drift_out(round_trip: tuple[Recording, Array, Closed]) -> None:
    recording, truth, closed = round_trip
    before = errors(corrected(recording.scans, closed.keyframes, closed.driven), truth)
    now = errors(corrected(recording.scans, closed.keyframes, closed.nodes), truth)
    assert len(closed.loops) >= 2
    assert true_loops(closed, truth).max() < 0.15
    assert before[0] > 0.3
    assert now[0] < 0.5 * before[0]
    assert now[0] < 0.15


def test_every_refusal_says_why(round_trip: tuple[Recording, Array, Closed]) -> None:
    closed = round_trip[2]
    assert all(
        refusal.why and refusal.first <= refusal.second < len(closed.keyframes) for refusal in closed.refused
    )


def test_the_map_along_the_corrected_way_is_the_ground(round_trip: tuple[Recording, Array, Closed]) -> None:
    recording, _truth, closed = round_trip
    scene, _ = ring(half=(5.0, 3.5))

    def off(nodes: Array) -> float:
        """Share of trusted cells that are more than 0.3 m off, walls where none are or none where they are."""
        grid = fuse(recording, corrected(recording.scans, closed.keyframes, nodes), PARAMS).grid()
        rows, cols = np.nonzero(grid.trusted)
        x, y = grid.origin[0] + cols * grid.resolution, grid.origin[1] + rows * grid.resolution
        z = np.array([scene.z(*at) for at in zip(x, y, strict=True)])
        return float((np.abs(grid.height[rows, cols] - z) > 0.3).mean())

    assert off(closed.nodes) < 0.7 * off(closed.driven)


def test_a_second_run_is_put_where_it_was(round_trip: tuple[Recording, Array, Closed]) -> None:
    scene, corners = ring(half=(5.0, 3.5))
    first = way_through(scene, corners[:4], step=0.7)
    second = way_through(scene, [corners[2], corners[1], corners[0]], step=0.7)
    recording = Recording()
    for run, truth in enumerate((first, second)):
        record(recording, run, Drive(scene, truth, drifted(truth, Drift(), run), seed=run))
    closed = Closing(recording, PARAMS, levelled(first[0], HEIGHT)).close()
    assert closed.lost == []
    assert true_loops(closed, np.concatenate([first, second])).max() < 0.15
    assert (
        errors(corrected(recording.scans, closed.keyframes, closed.nodes), np.concatenate([first, second]))[0]
        < 0.25
    )
    recording.close()


@pytest.mark.campaign
def test_a_corridor_that_looks_like_another_one_is_refused() -> None:
    scene, corners = twins()
    truth = way_through(scene, corners, step=0.5)
    recording = Recording()
    record(recording, 0, Drive(scene, truth, drifted(truth, Drift(), 1)))
    closing = Closing(recording, PARAMS, levelled(truth[0], HEIGHT))
    closed = closing.close()
    assert true_loops(closed, truth).max(initial=0.0) < 0.15
    # the scans alone are sure of the wrong corridor: it is the odometry that knows better
    places = np.array([truth[frame.scan][:2, 3] for frame in closed.keyframes])
    sure = []
    for second in np.flatnonzero((np.abs(places[:, 1] - 9.0) < 0.1) & (np.abs(places[:, 0]) < 6.0)):
        first = int(np.abs(places[:second] - (places[second] - (0.0, 9.0))).sum(axis=1).argmin())
        for found in closing._verifier.search(first, int(second), np.zeros(4), 3.0, 0.5) or ():
            if found.certainty > ENOUGH_CERTAINTY:
                sure.append(Match(first, int(second), pose_of(found.place), found.certainty))
    assert sure
    assert all(closing._from_odometry(match) > ODOMETRY_GATE for match in sure)
    recording.close()


def test_the_rival_is_the_best_match_that_puts_it_elsewhere() -> None:
    nodes = np.array([[0.0, 0.0, 0.0, 0.0], [4.0, 0.0, 0.0, 1.0]])
    here = np.array([5.0, 1.0, 0.0, 0.3])
    same = [Match(k, 2, after(back(nodes[k]), here), c) for k, c in ((0, 0.9), (1, 0.8))]
    other = Match(1, 2, after(back(nodes[1]), here + np.array([0.0, 3.0, 0.0, 0.0])), 0.7)
    assert rivals(nodes, same)[1] is None
    assert rivals(nodes, [*same, other]) == (same[0], other)
