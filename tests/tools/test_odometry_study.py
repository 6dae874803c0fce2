"""A recorded drive is scored as the run it was recorded from."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hal.lidar import LIDARS
from hal.types import GroundTruth
from tools.bench.perception.odometry import drive, errors
from tools.odometry_study import RecordedDrive
from tools.synthetic import arena_run


def test_a_recorded_drive_is_scored_like_the_synthetic_run_it_came_from() -> None:
    run = replace(arena_run("xt16", duration=4.0, seed=2), lidar=LIDARS["xt16"].decimated(8))
    samples = list(run.samples())
    truth = [s for s in samples if isinstance(s, GroundTruth)]
    recorded = RecordedDrive(
        run.extrinsics,
        [s for s in samples if not isinstance(s, GroundTruth)],
        np.array([s.stamp for s in truth]),
        np.array([s.position for s in truth]),
        np.array([s.orientation for s in truth]),
    )
    assert recorded.path_length() == pytest.approx(run.path_length(), rel=1e-3)
    stamps = run.start_stamp + np.array([1_234_567_890, 3_000_000_001])
    for got, want in zip(recorded.truth(stamps), run.truth(stamps), strict=True):
        assert np.abs(got - want).max() < 2e-3
    ours, theirs = (errors(r, drive(r, ["kiss_icp"])["kiss_icp"]) for r in (recorded, run))
    assert ours.rpe_mm == pytest.approx(theirs.rpe_mm, abs=0.5)
    assert 0.0 < theirs.rpe_mm < 12.0
    assert ours.drift_pct == pytest.approx(theirs.drift_pct, abs=0.1)
