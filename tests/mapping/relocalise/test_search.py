"""Columns and branch and bound against plain numpy."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mapping.relocalise.columns import SLICE_COUNT, SLICE_HEIGHT, matched, occupy, ones, pool, settle
from mapping.relocalise.search import Columns, as_columns, branch_and_bound, find_places
from tests.mapping.relocalise.rooms import corner_room, ground_of, seen_from


def random_words(random: np.random.Generator, *shape: int, share: float = 0.2) -> np.ndarray:
    bits = random.random((*shape, 64)) < share
    return (bits * (np.uint64(1) << np.arange(64, dtype=np.uint64))).sum(axis=-1, dtype=np.uint64)


def test_bits_are_counted() -> None:
    words = [0, 1, 2**63, 2**64 - 1, 0x5A5A_0F0F_1234_8001]
    assert [ones(np.uint64(w)) for w in words] == [w.bit_count() for w in words]


def test_points_occupy_the_slices_and_cells_around_them() -> None:
    columns = np.zeros((9, 9), np.uint64)
    occupy(np.array([[0.5, 0.25, 0.3], [-9.0, 0.0, 0.0]]), 0.0, 0.0, 0.0, 0.125, columns)
    expected = np.zeros((9, 9), np.uint64)
    expected[1:4, 3:6] = 0b11  # 0.3 m reaches from 0.175 to 0.425
    assert (columns == expected).all()


def test_ground_sets_the_slice_of_its_height_in_the_cell_that_it_lies_in() -> None:
    random = np.random.default_rng(4)
    height = random.uniform(-3.0, 20.0, (30, 40)).astype(np.float32)
    trusted = random.random(height.shape) < 0.3
    levels = random_words(random, 12, 14, share=0.01)
    expected = levels.copy()
    settle(height, trusted, 1.0, -2.0, 0.04, 0.9, -2.1, -1.0, 0.125, levels)
    r, c = np.nonzero(trusted)
    level = np.rint((height[r, c].astype(float) + 1.0) / SLICE_HEIGHT).astype(np.int64)
    on = (level >= 0) & (level < SLICE_COUNT)
    at = np.rint((r * 0.04 + 0.1) / 0.125).astype(int)[on], np.rint((c * 0.04 + 0.1) / 0.125).astype(int)[on]
    np.bitwise_or.at(expected, at, np.uint64(1) << level[on].astype(np.uint64))
    assert 0 < on.sum() < on.size
    assert (levels == expected).all()


def test_a_pooled_map_holds_what_any_cell_of_the_window_holds() -> None:
    fine = random_words(np.random.default_rng(1), 13, 11)
    wide = pool(pool(fine, 1), 2)
    for i in range(13):
        for j in range(11):
            assert wide[i, j] == np.bitwise_or.reduce(fine[i : i + 4, j : j + 4].ravel())


def test_a_score_counts_the_bits_that_submap_and_map_share_and_a_window_never_scores_less() -> None:
    random = np.random.default_rng(2)
    fine = random_words(random, 20, 24)
    wide = pool(pool(fine, 1), 2)
    offsets = random.integers(-6, 7, (30, 2)).astype(np.int32)
    words = random_words(random, 30, share=0.1)
    for row, col, shift in ((10, 12, 32), (3, 2, 35), (17, 22, 29)):
        count = 0
        for (i, j), word in zip(offsets + np.array([row, col]), words, strict=True):
            if 0 <= i < 20 and 0 <= j < 24:
                lift = shift - SLICE_COUNT // 2
                there = int(fine[i, j]) >> lift if lift >= 0 else (int(fine[i, j]) << -lift) % 2**64
                count += (there & int(word)).bit_count()
        assert matched(fine, 1, row, col, shift, offsets, words) == count
        for up in range(4):
            for left in range(4):
                assert matched(wide, 4, row - up, col - left, shift, offsets, words) >= count


def test_branch_and_bound_finds_what_trying_everything_finds() -> None:
    random = np.random.default_rng(4)
    fine = [random_words(random, 40, 40, share=0.05)]
    ground = [random_words(random, 40, 40, share=0.01)]
    for k in range(5):  # as many levels as `Columns` has: the kernel is compiled for them
        fine.append(pool(fine[-1], 1 << k))
        ground.append(pool(ground[-1], 1 << k))
    offsets = random.integers(-8, 9, (5, 40, 2)).astype(np.int32)
    words = random_words(random, 40, share=0.05)
    bins = np.zeros((5, 40, 40), np.int32)
    best = np.zeros((5, 40, 40, 4), np.int32)
    window = np.array([0, 0, 40, 40])
    found = branch_and_bound(tuple(fine), tuple(ground), offsets, words, window, 1, 0.8, 1, 1, bins, best)
    scores = np.zeros((5, 40, 40), int)
    for k in range(5):
        for row in range(40):
            for col in range(40):
                levels = [n for n in range(64) if int(ground[0][row, col]) >> n & 1]
                tried = [matched(fine[0], 1, row, col, n, offsets[k], words) for n in levels]
                scores[k, row, col] = max(tried, default=0)
    assert found == scores.max() > 0
    good = scores >= 0.8 * found
    assert (bins[good] == scores[good]).all()
    assert (bins[bins >= 0.8 * found] == scores[bins >= 0.8 * found]).all()


@pytest.mark.parametrize("place", [(1.3, -0.7, 2.2), (-2.0, 1.1, -0.4)])
def test_the_best_place_is_the_robots_within_a_cell(place: tuple[float, float, float]) -> None:
    cloud = corner_room()
    structure = seen_from(cloud, *place).astype(float) + np.array([0.0, 0.0, 0.4])
    structure = structure[structure[:, 2] > 0.2]
    found = find_places(Columns.of(cloud.astype(np.float32), [ground_of(4.0, 3.0)]), structure)
    assert math.dist((found[0].x, found[0].y), place[:2]) < 0.2
    assert abs(found[0].yaw - place[2]) < 0.1
    assert found[0].share > 0.9
    around = find_places(
        Columns.of(cloud.astype(np.float32), [ground_of(4.0, 3.0)]), structure, (0.0, 0.0, 0.0)
    )
    assert all(math.hypot(p.x, p.y) < 2.2 and abs(p.yaw) < 0.6 for p in around)


def test_points_become_columns_of_slices() -> None:
    xy, words = as_columns(np.array([[0.1, 0.1, 0.3], [0.2, 0.1, 0.6], [1.1, 0.1, -0.1]]))
    middle = SLICE_COUNT // 2
    np.testing.assert_allclose(xy, [[0.15, 0.1], [1.1, 0.1]])
    assert [int(w) for w in words] == [(1 << middle + 1) + (1 << middle + 2), 1 << middle - 1]
    assert SLICE_HEIGHT == 0.25
