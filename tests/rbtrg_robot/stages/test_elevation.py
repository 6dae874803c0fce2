"""The elevation stage beside an odometry that has lost its place."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from hal.lidar.config import LidarConfig
from hal.robots import describe
from hal.robots.go2w.facts import MOTORS
from hal.types import JointSample
from mapping.elevation.export import Limits
from mapping.elevation.map import ElevationMap
from mapping.elevation.tiles import LIDAR
from rbtrg_robot import topics as t
from rbtrg_robot.stage_config import ElevationStageConfig
from rbtrg_robot.stages.elevation import ElevationStage
from rbtrg_robot.topics import Topic
from rbtrg_robot.wire.convert import (
    BASE,
    MAP,
    ODOM,
    cloud_msg,
    joint_msg,
    odometry_msg,
    patch_msg,
    transform_msg,
)
from rbtrg_robot.wire.messages import time_msg

LEVEL = (0.0, 0.0, 0.0, 1.0)
SWEEP = 100_000_000
"""[ns]"""


class Fed:
    """A stage on flat ground, one sweep each 0.1 s from where the odometry says it is."""

    def __init__(self, lidars: tuple[LidarConfig, ...] = (LidarConfig(),)) -> None:
        mounted = tuple(lidar.mounted() for lidar in lidars)
        self.stage = ElevationStage(
            ElevationMap(), ElevationStageConfig(), mounted, limits=Limits(max_step=0.15, max_slope=0.5)
        )
        self.now = SWEEP
        x, y = np.meshgrid(np.linspace(-6.0, 6.0, 90), np.linspace(-6.0, 6.0, 90))
        self.ground = np.stack([x, y, np.full_like(x, -0.4)], -1).reshape(-1, 3).astype(np.float32)
        self.set_pose(0.0)

    def set_pose(self, x: float) -> None:
        offset = transform_msg(0, MAP, ODOM, np.array([x, 0.0, 0.0]), LEVEL)
        self.stage.on(t.TF_STATIC, t.TF_STATIC.kind(transforms=[offset]))

    def sweep(
        self, x: float, y: float, head: slice | None = None, covariance: np.ndarray | None = None
    ) -> list[tuple[Topic, Any]]:
        """`head`: which points the head's LiDAR sees, where there is one. covariance (6, 6): of the odometry."""
        self.now += SWEEP
        if head is not None:
            self.stage.on(t.CLOUDS["head"], cloud_msg(self.now, BASE, self.ground[head]))
        still = np.zeros(len(MOTORS))
        place = np.array([x, y, 0.4])
        self.stage.on(t.CLOUD, cloud_msg(self.now, BASE, self.ground))
        self.stage.on(t.JOINTS, joint_msg(JointSample(self.now, still, still, still)))
        return self.stage.on(
            t.ODOM, odometry_msg(self.now, place, LEVEL, np.zeros(3), np.zeros(3), covariance)
        )

    @property
    def status(self) -> Any:
        ((_, status),) = self.stage.tick(self.now + 10**9 * self.now)
        return status


def test_poses_that_jump_are_refused_and_cost_no_memory() -> None:
    fed = Fed()
    fed.sweep(0.0, 0.0)
    fed.sweep(0.1, 0.0)
    tiles, seen = fed.status.tiles, fed.stage.map.stamp
    rng = np.random.default_rng(12)
    for x, y in rng.choice([-1, 1], (60, 2)) * rng.uniform(10.0, 2000.0, (60, 2)):
        assert fed.sweep(x, y) == [], "without a window the guard allows nothing"
    status = fed.status
    assert (status.tiles, status.refused, fed.stage.map.stamp) == (tiles, 60, seen)
    assert "set it while the robot stands" in status.warning
    assert fed.sweep(0.3, 0.1) != []
    assert "jumped" not in fed.status.warning


@pytest.mark.parametrize(("silence", "reach"), [(0, 3.5), (2, 13.5)])
def test_the_robot_may_be_as_far_as_it_can_drive_and_no_further(silence: int, reach: float) -> None:
    """3 m at once, and 5 m/s since the sweep before."""
    fed = Fed()
    fed.sweep(0.0, 0.0)
    fed.now += silence * 10**9
    assert fed.sweep(reach + 0.1, 0.0) == []
    fed.now -= SWEEP
    assert fed.sweep(reach - 0.1, 0.0) != []


def test_a_head_lidar_without_points_is_told_after_half_a_second(monkeypatch: pytest.MonkeyPatch) -> None:
    fed = Fed(describe().lidars)
    for _ in range(3):
        fed.sweep(0.0, 0.0, slice(None))
    warnings, granted = [], []
    monkeypatch.setattr(fed.stage.map, "grant", granted.append)
    for _ in range(6):
        fed.sweep(0.0, 0.0, slice(0))
        warnings.append("nothing from the head LiDAR" in fed.status.warning)
    assert warnings == [False] * 4 + [True] * 2
    fed.sweep(0.0, 0.0, slice(None))
    assert "head" not in fed.status.warning
    assert granted == [True] * 4 + [False] * 2 + [True], "what nobody looks at is ground no longer"


@pytest.mark.parametrize("place", [40.0, -300.0])
def test_where_the_pose_was_set_the_map_begins_anew(place: float) -> None:
    fed = Fed()
    fed.sweep(0.0, 0.0)
    assert fed.sweep(place, 0.0) == []
    fed.set_pose(-place)
    assert fed.sweep(2 * place, 0.0) != []
    assert "jumped" not in fed.status.warning


@pytest.mark.parametrize("bad", [np.nan, np.inf, 3e38])
def test_a_prior_map_with_a_damaged_cloud_is_refused(bad: float) -> None:
    fed = Fed()
    fed.sweep(0.0, 0.0)
    cloud = np.array([[0.0, 0.0, 0.5], [1.0, 0.0, bad], [-bad, bad, 0.5]], np.float32)
    block = patch_msg(fed.stage.map.full())
    still = fed.stage.map.epoch
    prior = t.MAP_PRIOR.kind(id="x", map=[block], cloud=cloud_msg(1, MAP, cloud))
    fed.stage._stands = True
    assert fed.stage.on(t.MAP_PRIOR, prior) == []
    status = fed.status
    assert (status.refused, status.prior, status.epoch) == (1, "", still)


@pytest.mark.parametrize(
    ("lidars", "starts"), [(describe().lidars, [False, None]), ((LidarConfig(),), [None, None])]
)
def test_the_ground_around_the_start_is_entered_when_the_head_lidar_looks_at_it(
    lidars: tuple[LidarConfig, ...], starts: list[bool | None], monkeypatch: pytest.MonkeyPatch
) -> None:
    fed, entered = Fed(lidars), []
    monkeypatch.setattr(fed.stage.map, "fuse_ground", lambda *args: entered.append(args[-1]))
    fed.sweep(0.0, 0.0, slice(0) if len(lidars) > 1 else None)
    fed.sweep(0.0, 0.0, slice(None) if len(lidars) > 1 else None)
    assert entered == starts


@pytest.mark.parametrize(("axis", "sigma"), [(2, 0.1), (3, 0.05), (4, 0.05)])
def test_cells_are_as_uncertain_as_the_pose(axis: int, sigma: float) -> None:
    """Of an odometry that knows its height to 0.1 m, or roll or pitch to 0.05 rad; most cells are more than 4 m
    away."""
    covariance = np.zeros((6, 6))
    covariance[axis, axis] = sigma**2
    variances = []
    for known in (np.zeros((6, 6)), covariance):
        fed = Fed()
        fed.sweep(0.0, 0.0, covariance=known)
        cells = fed.stage.map.store.cells
        variances.append(np.median(cells["variance"][cells["source"] == LIDAR]))
    assert variances[0] < 0.001
    assert variances[1] > (sigma if axis == 2 else 4.0 * sigma) ** 2


def test_every_third_sweep_cleans_up(monkeypatch: pytest.MonkeyPatch) -> None:
    fed, cleaned = Fed(), []
    monkeypatch.setattr(fed.stage.map, "clean", lambda: cleaned.append(fed.now))
    begin = fed.now
    for _ in range(7):
        fed.sweep(0.0, 0.0)
    assert cleaned == [begin + 3 * SWEEP, begin + 6 * SWEEP]


def test_the_status_comes_twice_a_second_also_where_the_clock_is_set_back() -> None:
    fed = Fed()
    told = [len(fed.stage.tick(round(now * 1e9))) for now in (100.0, 100.2, 100.5, 50.0, 50.2, 50.6)]
    assert told == [1, 0, 1, 1, 0, 1]


def test_a_repeat_of_a_prior_map_changes_nothing() -> None:
    fed = Fed()
    fed.sweep(0.0, 0.0)
    block = patch_msg(fed.stage.map.full())
    prior = t.MAP_PRIOR.kind(id="x", map=[block], cloud=cloud_msg(1, MAP, np.zeros((3, 3), np.float32)))
    fed.stage._stands = True
    assert fed.stage.on(t.MAP_PRIOR, prior) != []
    epoch = fed.stage.map.epoch
    assert fed.stage.on(t.MAP_PRIOR, prior) == []
    assert fed.stage.map.epoch == epoch


def test_the_cost_of_the_ground_is_a_grid_as_ros_counts() -> None:
    fed = Fed()
    assert fed.stage.show() == [], "nothing was seen yet"
    x, y = np.meshgrid(np.arange(-3.0, 3.0, 0.03), np.arange(-3.0, 3.0, 0.03))
    fed.ground = np.stack([x, y, np.full_like(x, -0.4)], -1).reshape(-1, 3).astype(np.float32)
    fed.ground[np.hypot(fed.ground[:, 0] - 2.0, fed.ground[:, 1] - 1.0) < 0.4, 2] += 0.5
    for _ in range(4):
        fed.sweep(0.0, 0.0)
    ((topic, cost),) = fed.stage.show()
    assert topic is fed.stage.shown is t.MAP_COST
    assert cost.header.frame_id == MAP
    assert cost.info.width == cost.info.height == 501
    grid = cost.data.reshape(cost.info.height, cost.info.width)

    def at(x: float, y: float) -> int:
        corner = cost.info.origin.position
        return int(
            grid[int((y - corner.y) / cost.info.resolution), int((x - corner.x) / cost.info.resolution)]
        )

    assert at(1.5, -1.0) == 0, "level"
    assert at(9.0, 9.0) == -1, "not seen"
    near = [at(2.0 + 0.45 * np.cos(a), 1.0 + 0.45 * np.sin(a)) for a in np.linspace(0, 6.28, 40)]
    assert max(near) == 100, "a step of half a metre"
    assert [topic for topic, _ in fed.sweep(0.0, 0.0)] == [t.MAP_WINDOW], "showing changes nothing"


def closed_map(fed: Fed, x: float, lift: float = 0.0) -> Any:
    """The present map as one of this run, with `odom` at `x` [m]."""
    block = patch_msg(replace(fed.stage.map.full(), stamp=fed.now + 1))
    return t.MAP_PRIOR.kind(
        id="closed", map=[block], odom_in_map=np.array([x, 0.0, 0.0, lift]), until=time_msg(fed.now)
    )


def test_a_closed_map_waits_until_the_frames_have_come_to_it() -> None:
    fed = Fed()
    fed.sweep(0.0, 0.0)
    epoch, prior = fed.status.epoch, closed_map(fed, 0.12, lift=0.05)
    ((_, status),) = fed.stage.on(t.MAP_PRIOR, prior)
    assert (status.location, status.odom_in_map.tolist(), status.prior) == ("closing", [0.12, 0.0, 0.0], "")
    assert fed.stage.on(t.MAP_PRIOR, prior) == [], "a repeat"
    for x in (0.04, 0.08):
        fed.set_pose(x)
        assert fed.sweep(0.0, 0.0) != []
        assert fed.status.location == "closing"
    height = fed.stage.map.alignment.height
    fed.now += SWEEP
    fed.set_pose(0.12)
    status = fed.status
    assert (status.location, status.prior, status.epoch) == ("located", "closed", epoch)
    assert status.height_correction == pytest.approx(height + 0.05)
    assert status.detail.startswith("the loops of the map were closed")


def test_a_closed_map_that_moves_nothing_is_taken_at_once() -> None:
    fed = Fed()
    fed.sweep(0.0, 0.0)
    told = [message.location for _, message in fed.stage.on(t.MAP_PRIOR, closed_map(fed, 0.0))]
    assert told == ["closing", "located"]


def test_a_pose_that_is_set_meanwhile_ends_it() -> None:
    fed = Fed()
    fed.sweep(0.0, 0.0)
    epoch = fed.status.epoch
    fed.stage.on(t.MAP_PRIOR, closed_map(fed, 0.12))
    fed.set_pose(5.0)
    fed.now += SWEEP
    status = fed.status
    assert (status.location, status.prior, status.epoch) == ("", "", epoch + 1)


@pytest.mark.parametrize("told", [[1.0], [0.0, 0.0, np.nan, 0.0]])
def test_a_closed_map_that_does_not_tell_where_it_lies_is_refused(told: list[float]) -> None:
    fed = Fed()
    fed.sweep(0.0, 0.0)
    assert fed.stage.on(t.MAP_PRIOR, replace(closed_map(fed, 0.0), odom_in_map=np.array(told))) == []
    status = fed.status
    assert (status.location, status.refused) == ("", 1)
