"""A prior map that fits is used in silence, one on another level is taken at it, a wrong one is reported."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hal.lidar import LIDARS, LidarConfig
from hal.rotation import quaternion, rotation
from mapping.elevation.config import ElevationConfig
from mapping.elevation.map import ElevationMap
from mapping.elevation.prior import FEW_CELLS, PriorCheck
from mapping.elevation.tiles import LIDAR, PRIOR, TileStore
from tools.bench.perception.map import Mapper, Registered, registered
from tools.synthetic import arena_run


def scans(seed: int, seconds: float) -> list[Registered]:
    run = replace(arena_run("xt16", seed=seed, duration=seconds), lidar=LIDARS["xt16"].decimated(2))
    return list(registered(run))


@pytest.fixture(scope="module")
def prior(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A map of the arena seen from its middle."""
    mapper = Mapper(arena_run("xt16", seed=1))
    for scan in scans(1, 4.0):
        mapper.take(scan)
    path = tmp_path_factory.mktemp("prior") / "map.npz"
    mapper.map.save(path)
    return path


@pytest.fixture(scope="module")
def later() -> list[Registered]:
    return scans(2, 2.0)


def started_at(
    prior: Path, later: list[Registered], x: float = 0.0, z: float = 0.0, yaw: float = 0.0
) -> ElevationMap:
    """A map begun from the prior one by a robot whose start pose is off by x, z [m] and yaw [deg]."""
    elevation = ElevationMap()
    elevation.load_prior(prior)
    c, s = np.cos(np.radians(yaw)), np.sin(np.radians(yaw))
    turned = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    for scan in later:
        place = turned @ scan.position + [x, 0.0, z]
        elevation.fuse(scan.cloud, place, quaternion(turned @ rotation(scan.orientation)), scan.stamp)
    return elevation


def test_a_prior_map_that_fits_is_used_in_silence(prior: Path, later: list[Registered]) -> None:
    elevation = started_at(prior, later)
    assert elevation.warning == ""
    assert abs(elevation.alignment.height) < 0.01


@pytest.mark.parametrize(
    ("x", "yaw"), [(0.1, 0.0), (0.3, 0.0), (-1.0, 0.0), (0.0, 5.0), (0.0, 90.0), (0.0, 180.0), (1.5, -40.0)]
)
def test_a_prior_map_that_does_not_fit_is_reported(
    prior: Path, later: list[Registered], x: float, yaw: float
) -> None:
    words = started_at(prior, later, x=x, yaw=yaw).warning
    assert "does not fit" in words
    assert "start pose" in words


@pytest.mark.parametrize("z", [0.5, -0.2])
def test_a_prior_map_from_another_start_is_taken_at_its_level(
    prior: Path, later: list[Registered], z: float
) -> None:
    elevation = started_at(prior, later, z=z)
    assert elevation.alignment.height == pytest.approx(-z, abs=0.01)
    assert elevation.warning == ""
    grid, before = elevation.grid(), ElevationMap()
    before.load_prior(prior)
    was = before.grid()
    both = grid.trusted[: was.shape[0], : was.shape[1]] & was.trusted
    assert grid.origin == was.origin
    assert both.sum() > 10_000
    assert np.median(np.abs(grid.height[: was.shape[0], : was.shape[1]] - was.height)[both]) < 0.01


def test_without_a_prior_map_there_is_nothing_to_say(later: list[Registered]) -> None:
    elevation = ElevationMap(ElevationConfig())
    for scan in later[:3]:
        elevation.fuse(scan.cloud, scan.position, scan.orientation, scan.stamp)
    assert elevation.warning == ""


def test_each_cell_counts_once_and_few_cells_say_nothing() -> None:
    store = TileStore(64)
    row, col = (a.reshape(-1) for a in np.meshgrid(np.arange(-30, 30), np.arange(-25, 25), indexing="ij"))
    index = store.locate(row, col)
    cells = store.cells
    cells["source"][index], cells["height"][index], cells["seen"][index] = LIDAR, 0.0, PRIOR
    cells["height"][index[(row == 3) & (col == 7)]] = 0.6  # a post: what is seen beside it may belong to it
    cells["height"][index[row > 20]] = np.nan  # what stands at the border of the known may have been there
    cells["source"][index[row > 20]] = 0
    sums = np.zeros((len(index), 8), np.float32)
    sums[:, 2] = 1.0
    high = (row % 5 == 0) | ((np.abs(row - 3) <= 1) & (np.abs(col - 7) <= 1))
    sums[high, 0] = 0.5
    check = PriorCheck()
    check.take(store, index[: FEW_CELLS - 1], sums[: FEW_CELLS - 1])
    assert check.warning == ""
    for _ in range(2):
        check.take(store, index, sums)
    # corners of the square and the lower border have too few neighbours, the upper one just enough
    inner = (
        (row <= 20) & ((row > -30) | ((col > -25) & (col < 24))) & ~((row == 20) & np.isin(col, (-25, 24)))
    )
    beside = (np.abs(row - 3) <= 1) & (np.abs(col - 7) <= 1)
    assert check.tested == inner.sum()
    assert check.higher == (inner & high & ~beside).sum()
    assert "on 21% of the ground" in check.warning
    assert not check.done


@pytest.mark.parametrize(("apart", "counted"), [(1, True), (2, True), (3, False)])
def test_single_points_in_the_air_behind_an_edge_do_not_contradict(apart: int, counted: bool) -> None:
    store = TileStore(64)
    row, col = (a.reshape(-1) for a in np.meshgrid(np.arange(-30, 30), np.arange(-30, 30), indexing="ij"))
    index = store.locate(row, col)
    store.cells["source"][index], store.cells["height"][index], store.cells["seen"][index] = LIDAR, 0.0, PRIOR
    high = (row % apart == 0) & (col % apart == 0)
    sums = np.zeros((len(index), 8), np.float32)
    sums[:, 2] = 1.0
    sums[high, 0] = 0.5
    check = PriorCheck()
    check.take(store, index, sums)
    inner = ~(np.isin(row, (-30, 29)) & np.isin(col, (-30, 29)))
    assert check.higher == (high & inner).sum() * counted
    assert check.tested == (inner & (~high | counted)).sum()
    check.take(store, index, np.where(np.arange(8) == 2, 1.0, np.zeros_like(sums)))
    assert check.tested == inner.sum(), "what told nothing is compared later"


def test_the_elevation_process_publishes_the_warning(prior: Path, later: list[Registered]) -> None:
    from rbtrg_robot import topics as t
    from rbtrg_robot.stage_config import ElevationStageConfig
    from rbtrg_robot.stages.elevation import ElevationStage

    for yaw in (0.0, 90.0):
        stage = ElevationStage(
            started_at(prior, later, yaw=yaw), ElevationStageConfig(), (LidarConfig().mounted(),)
        )
        ((topic, status),) = stage.tick(1)
        assert topic is t.MAP_STATUS
        assert ("does not fit" in status.warning) == (yaw != 0.0)
