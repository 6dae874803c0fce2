"""The price of a straight move: each wheel's crossings, slopes, posts and gaps, against plain numpy."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from planning.graph.edge_price import EVEN_TAN, HIGHEST_FACE, TRACK_BEYOND, edge_price
from planning.graph.faces import FACE_NOISE, update_faces
from planning.graph.flags import FIELD, HOLE, UNSEEN, VIRTUAL
from planning.graph.params import GraphParams
from planning.graph.prices import LONGEST_TREAD, Prices, angle_at, prices_of, size_at, tread_at

RES = 0.04
PRICES = prices_of(GraphParams(controller="hybrid"))
AXLE, TREAD = PRICES.axle, PRICES.tread
WHEELS = [(AXLE, TREAD), (AXLE, -TREAD), (-AXLE, TREAD), (-AXLE, -TREAD)]


def faces_of(z: np.ndarray) -> np.ndarray:
    out = np.zeros((*z.shape, 2), np.int16)
    update_faces(out, z, np.ones(z.shape, bool), RES, 0, 0, *z.shape)
    return out


def price(
    z: np.ndarray, a: np.ndarray, b: np.ndarray, flags: np.ndarray | None = None, prices: Prices = PRICES
) -> np.ndarray:
    out = np.full((2, 2), np.nan, np.float32)
    flags = np.zeros(z.shape, np.uint16) if flags is None else flags
    edge_price(z, flags, faces_of(z), 0.0, 0.0, RES, prices, *a, *b, out)
    return out


def kerb(degrees: float, height: float, noise: float = 0.0) -> np.ndarray:
    """5 x 4 m with a face through (2.5, 2.0), whose normal is so many degrees off the x axis."""
    y, x = np.mgrid[0:100, 0:125] * RES
    a = np.radians(degrees)
    z = np.where((x - 2.5) * np.cos(a) + (y - 2.0) * np.sin(a) > 0.0, height, 0.0)
    return (z + noise * np.random.default_rng(0).standard_normal(z.shape)).astype(np.float32)


@pytest.mark.parametrize("degrees", [0, 20, 45, 60])
@pytest.mark.parametrize("height", [0.19, 0.10])
def test_a_kerb_costs_one_crossing_at_its_angle_in_however_many_moves(degrees: int, height: float) -> None:
    z = kerb(degrees, height, 0.003)
    whole = price(z, (1.3, 2.0), (3.7, 2.0))
    low, high = (
        4.0 * PRICES.face[:, :, size_at(height + d), angle_at(np.radians(max(0, degrees + a)))]
        for d, a in ((-0.012, -8), (0.012, 8))
    )
    assert (low[0] <= whole[0]).all()
    assert (whole[0] <= high[0]).all(), "up, forward and backward"
    assert (low[1] <= whole[1]).all()
    assert (whole[1] <= high[1]).all(), "down on the way back"
    x = np.linspace(1.3, 3.7, 7)
    parts = sum(price(z, (a, 2.0), (b, 2.0)) for a, b in pairwise(x))
    np.testing.assert_allclose(parts[:, 0], whole[:, 0], rtol=0.35, atol=0.02)
    assert (parts[:, 1] >= 0.65 * whole[:, 1] - 0.02).all(), "backward none is left out"
    np.testing.assert_allclose(price(z, (3.7, 2.0), (1.3, 2.0)), whole[::-1], rtol=0.35, atol=0.02)


def test_a_robot_that_backs_up_to_a_kerb_has_met_it_before_its_wheels_stand_under_it() -> None:
    """One that came down a kerb backed up against it by 0.12 m to turn, climbed it with one wheel, and fell."""
    z = kerb(0, 0.19)[:, ::-1].copy()  # up towards -x, where it backs up to
    edge = 4.95 - 2.5
    for gap, met in ((0.04, True), (0.2, False)):
        here = edge + AXLE + gap
        back = price(z, (here, 2.0), (here + 0.12, 2.0))[1]
        assert bool(back[1] > 5.0) is met, "backward, from there to here"
        assert back[0] < 1.0, "forward nothing is met"


def test_a_kerb_under_the_left_wheels_is_half_of_one() -> None:
    level = PRICES._replace(slope=np.zeros_like(PRICES.slope))  # beyond it the robot leans
    y, x = np.mgrid[0:100, 0:125] * RES
    whole, half = (
        price((0.16 * at).astype(np.float32), (1.3, 2.0), (3.7, 2.0), prices=level)
        for at in (x > 2.5, (x > 2.5) & (y > 2.0))
    )
    np.testing.assert_allclose(half, 0.5 * whole, rtol=0.25, atol=0.02)  # a row of the table is a centimetre


@pytest.mark.parametrize("tread", [0.30, 0.36])  # 0.28 m may be 0.24 m on cells of 4 cm: no way
def test_faces_that_follow_each_other_are_stairs(tread: float) -> None:
    _, x = np.mgrid[0:100, 0:125] * RES
    steps = (0.15 * np.clip(np.floor((x - 1.6) / tread) + 1, 0, 5)).astype(np.float32)
    whole = price(steps, (0.7, 2.0), (4.3, 2.0))
    share = 4.0 * 5.0 * PRICES.stairs[:, size_at(0.15), tread_at(tread), 0]
    np.testing.assert_allclose(whole[:, 0], share, rtol=0.35)
    assert whole[0, 0] > 2.0 * 20.0 * PRICES.face[0, 0, size_at(0.15), 0], "harder than so many single faces"
    x = np.linspace(0.7, 4.3, 8)
    parts = sum(price(steps, (a, 2.0), (b, 2.0)) for a, b in pairwise(x))
    np.testing.assert_allclose(parts[:, 0], whole[:, 0], rtol=0.3, atol=0.02)


def test_what_nobody_saw_is_not_told_and_low_faces_are_noise() -> None:
    a, b = (1.9, 2.0), (3.1, 2.0)
    z = kerb(0, 0.19)
    assert price(z, a, b).min() > 0.0
    for flag in (UNSEEN, VIRTUAL):
        assert price(z, a, b, np.full(z.shape, flag, np.uint16)).max() == 0.0
    assert price(kerb(0, 0.02), a, b).max() == 0.0


def test_a_field_a_gap_and_a_slope_cost_by_the_metre_and_by_the_crossing() -> None:
    rng = np.random.default_rng(1)
    posts = (0.12 * rng.integers(0, 2, (34, 42))).repeat(3, 0).repeat(3, 1)[:100, :125].astype(np.float32)
    field = np.full(posts.shape, FIELD, np.uint16)
    one, two = price(posts, (1.5, 2.0), (2.5, 2.0), field), price(posts, (1.5, 2.0), (2.0, 2.0), field)
    assert PRICES.posts[size_at(0.09)] <= one.min() <= one.max() <= PRICES.posts[size_at(0.15)]
    assert one[0, 0] == pytest.approx(2.0 * two[0, 0], rel=0.3)

    flat, flags = np.zeros((100, 125), np.float32), np.zeros((100, 125), np.uint16)
    flags[:, 62:64] = HOLE
    assert price(flat, (1.5, 2.0), (3.5, 2.0), flags)[0, 0] == pytest.approx(
        4.0 * PRICES.gap[size_at(0.06)], rel=0.5
    )
    for degrees in (0, 20, 26):
        y, x = np.mgrid[0:100, 0:125] * RES
        for towards in (0, 45, 90, 135):
            a = np.radians(towards)
            z = (np.tan(np.radians(degrees)) * (x * np.cos(a) + y * np.sin(a))).astype(np.float32)
            got = price(z, (1.5, 2.0), (3.0, 2.0))
            there, back = (
                1.5 * PRICES.slope[angle_at(np.radians(degrees)), angle_at(np.radians(d))]
                for d in (towards, 180 - towards)
            )
            np.testing.assert_allclose(got, [[there, there], [back, back]], rtol=1e-4, atol=1e-6)


def plain(z: np.ndarray, flags: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """`edge_price`, in plain numpy."""
    faces = faces_of(z)
    d = float(np.hypot(*(b - a)))
    u = (b - a) / d
    step = 0.5 * RES
    n, beyond = int(np.ceil(d / step)), int(TRACK_BEYOND / step)
    k = np.arange(-beyond, n + beyond + 1)
    within = (k >= 0) & (k < n)
    out, posts, fields, samples = np.zeros((2, 2)), 0, 0, 0
    for ahead, aside in WHEELS:
        w = a + ahead * u + aside * np.array([-u[1], u[0]])
        col, row = (np.floor((w[i] + k * step * u[i]) / RES + 0.5).astype(int) for i in (0, 1))
        f, flag, height = faces[row, col].astype(float), flags[row, col], z[row, col].astype(float)
        big = np.abs(f).max(axis=1)
        told = (big >= 1000 * FACE_NOISE) & (flag & (FIELD | HOLE | UNSEEN | VIRTUAL) == 0)
        sign = np.where(told, np.sign(f @ u), 0.0)
        in_field = within & (flag & FIELD > 0)
        samples += within.sum()
        fields += in_field.sum()
        posts = max(posts, big[in_field & (big <= 1000 * HIGHEST_FACE)].max(initial=0))
        crossed = []
        for i, j in runs(sign):
            m = (k[i] + k[j]) // 2 + beyond
            part = height[i : j + 1]
            rise = part.max() - part[0] if sign[i] > 0 else part[0] - part.min()
            size = min(rise, 0.001 * big[m])
            if not FACE_NOISE <= size <= HIGHEST_FACE:
                continue
            near = faces[row[m] - 3 : row[m] + 4, col[m] - 3 : col[m] + 4].reshape(-1, 2).astype(float)
            near = near[(near @ f[m] > 0.0) & (np.abs(near).max(axis=1) <= 1000 * HIGHEST_FACE)]
            normal = near.sum(axis=0)
            angle = np.arccos(min(abs(normal @ u) / np.hypot(*normal), 1.0))
            crossed.append((m, sign[i], size_at(size), angle))
        for m, way, size, angle in crossed:
            both = PRICES.face[:, :, size, angle_at(angle)].copy()
            at = [other for other, *_ in crossed].index(m)
            near = [crossed[o] for o in (at - 1, at + 1) if 0 <= o < len(crossed)]
            treads = [abs(m - other) * step for other, like, *_ in near if like == way]
            treads = [tread for tread in treads if tread <= LONGEST_TREAD]
            if treads:
                tread = np.mean(treads) * np.cos(angle)
                both[:, 0] = PRICES.stairs[:, size, tread_at(tread), angle_at(angle)]
            both = both if way > 0 else both[::-1]
            place = k[m] * step
            out[:, 0] += np.where(within[m], both[:, 0], 0.0)
            out[:, 1] += np.where(
                (0.0 <= place < d + PRICES.radius, -PRICES.radius <= place < d), both[:, 1], 0.0
            )
        for i, j in runs((flag & HOLE > 0).astype(float)):
            if within[j - (j - i) // 2]:
                out += PRICES.gap[size_at((j - i) * step)]
    if fields:
        out += PRICES.posts[size_at(0.001 * posts)] * d * fields / samples
    n = int(np.ceil(d / (2.0 * RES)))
    for along in (np.arange(n) + 0.5) * d / n:
        at = [a + (along + x) * u + y * np.array([-u[1], u[0]]) for x, y in WHEELS]
        cells = [tuple(np.floor(p / RES + 0.5).astype(int)[::-1]) for p in at]
        if any(
            flags[c] & (FIELD | HOLE | UNSEEN | VIRTUAL) or np.abs(faces[c]).max() >= 1000 * FACE_NOISE
            for c in cells
        ):
            continue
        fl, fr, rl, rr = (float(z[c]) for c in cells)
        pitch, roll = (fl + fr - rl - rr) / (4 * AXLE), (fl + rl - fr - rr) / (4 * TREAD)
        if np.hypot(pitch, roll) > EVEN_TAN:
            i, way = angle_at(np.arctan(np.hypot(pitch, roll))), np.arctan2(abs(roll), pitch)
            out[0] += PRICES.slope[i, angle_at(way)] * d / n
            out[1] += PRICES.slope[i, angle_at(np.pi - way)] * d / n
    return out


def runs(values: np.ndarray) -> list[tuple[int, int]]:
    """First and last index of each stretch of one value that is not 0."""
    ends = np.flatnonzero(np.diff(values, prepend=0.0, append=0.0))
    return [(i, j - 1) for i, j in zip(ends[:-1].tolist(), ends[1:].tolist(), strict=True) if values[i]]


def test_the_kernel_is_the_plain_sum_over_four_wheels() -> None:
    rng, seen = np.random.default_rng(5), []
    for k in range(60):
        z = kerb(rng.uniform(0, 180), rng.uniform(0.05, 0.25), 0.004)
        _, x = np.mgrid[0:100, 0:125] * RES
        z += (np.tan(np.radians(rng.uniform(0, 25))) * x).astype(np.float32)
        flags = np.zeros(z.shape, np.uint16)
        for flag in (FIELD, HOLE, UNSEEN, VIRTUAL)[: k % 5]:
            r, c = rng.integers(30, 60), rng.integers(40, 70)
            flags[r : r + 6, c : c + 6] |= flag
        a, b = rng.uniform((2.0, 1.5), (3.0, 2.5), (2, 2))
        seen.append(price(z, a, b, flags))
        np.testing.assert_allclose(seen[-1], plain(z, flags, a, b), rtol=1e-3, atol=1e-4)
    first = np.array([s[0, 0] for s in seen])
    assert np.std(first[np.isfinite(first)]) > 0.05
    assert np.isfinite(first).sum() > 50, "stairs that are no way are rare"
