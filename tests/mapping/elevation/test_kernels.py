"""The kernels that fuse scans and look along rays, against plain numpy on random input."""

from __future__ import annotations

import numpy as np
import pytest

from mapping.elevation import fusion as kernels
from mapping.elevation.tiles import CONTACT, FRESH_CELL, LIDAR, PLANTS, UNKNOWN, TileStore
from mapping.elevation.visibility import COMPANY_BAND, judge, trace

RULE = np.array([2.5, 0.05, 0.08, 0.8, 2, 5, 0.006**2, 1e-8, 0.06**2, 3, 1000.0, 6])


def rotation(rng: np.random.Generator) -> np.ndarray:
    q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    return q * np.linalg.det(q)


def test_a_read_out_is_taken_back_as_numpy_does_it() -> None:
    rng = np.random.default_rng(5)
    rows, cols, i0, j0 = 41, 60, -13, -30
    store = TileStore(16)
    store.allocate(-1, -2)
    height, variance, upper = rng.normal(size=(3, rows, cols)).astype(np.float32)
    upper[rng.random(upper.shape) < 0.5] = np.nan
    source = rng.choice(np.array([UNKNOWN, CONTACT, LIDAR, PLANTS], np.uint8), (rows, cols))
    upper[:, 14:30], source[:, 14:30] = np.inf, UNKNOWN  # a tile of which nothing comes stays absent
    known = source != UNKNOWN
    at = np.nonzero(known | np.isfinite(upper))
    want = np.repeat(FRESH_CELL, at[0].size)
    want["upper"] = np.where(known[at] & (source[at] != PLANTS), np.inf, upper[at])
    want["height"], want["variance"] = (
        np.where(known[at], layer[at], np.nan) for layer in (height, variance)
    )
    want["source"], want["count"], want["seen"] = source[at], np.where(source[at] == LIDAR, 7, 0), 99
    store.take_back(i0, j0, (height, variance, upper), source, 7, 99)
    used = store.used
    cell = store.locate((at[0] + i0).astype(np.int64), (at[1] + j0).astype(np.int64))
    assert store.used == used
    assert store.slot(0, -1) < 0
    for name in store.cells.dtype.names or ():
        np.testing.assert_array_equal(store.cells[cell][name], want[name], name)
    others = np.setdiff1d(np.arange(used * 16 * 16), cell)
    assert (store.cells["source"][others] == UNKNOWN).all()
    assert set(np.flatnonzero(store.touched)) == set(cell >> 8)


def test_project_equals_numpy() -> None:
    rng = np.random.default_rng(0)
    points = rng.uniform(-6, 6, (3000, 3)).astype(np.float32)
    points[::50, 1] = np.nan
    points[1::200] *= 4
    r, p, o = rotation(rng), rng.normal(size=3), np.array([0.1, -0.2, 0.3])
    limits, body = (
        np.array([0.4, 8.0, 1.0, 0.5, -np.inf, np.inf, -np.inf, np.inf]),
        np.array([-1.0, 1.0, -2.0, 2.0, -1.0, 1.0]),
    )
    noise = np.array([0.01, 0.002, 0.004, 0.005])
    n = len(points)
    store = TileStore(8)
    cell, z = np.empty(n, np.uint32), np.empty(n, np.float32)
    weight, shared = np.empty(n, np.float32), np.empty(n, np.float32)
    ray_of = np.empty(n, np.uint32)
    rays, counts, absent = np.empty((n, 3), np.float32), np.zeros(7, np.int64), np.zeros(2, np.int64)

    def project() -> bool:
        return kernels.project(
            points, r, p, o, limits, body, noise, 0.04, store.directory, store.first, store.shift,
            cell, z, weight, shared, ray_of, rays, counts, absent,
        )  # fmt: skip

    while not project():  # tiles are made as they are met
        assert store.slot(*absent) < 0
        store.allocate(*absent)
    m, q = counts[kernels.USED], counts[kernels.RAYS]

    x = points.astype(np.float64)
    finite = np.isfinite(x).all(axis=1)
    d = x - o
    reach = np.linalg.norm(d, axis=1)
    near = finite & (reach < 0.4)
    inside = finite & ~near & (np.abs(x) < [1, 2, 1]).all(axis=1)
    ray = finite & ~near & ~inside
    far = ray & (reach > 8.0)
    turned = x @ r.T
    flat = np.hypot(turned[:, 0], turned[:, 1])
    high = ray & ~far & (turned[:, 2] > 1.0) & (turned[:, 2] > 1.0 + 0.5 * flat)
    keep = ray & ~far & ~high
    drops = [(~finite).sum(), (near | far).sum(), inside.sum(), high.sum()]
    assert counts.tolist() == [*drops, keep.sum(), ray.sum(), n]
    world = turned + p
    np.testing.assert_allclose(rays[:q], world[ray], atol=1e-5)
    np.testing.assert_allclose(z[:m], world[keep, 2], atol=1e-5)
    np.testing.assert_allclose(rays[ray_of[:m]], world[keep], atol=1e-5)
    row, col = (
        np.floor(world[keep, 1] / 0.04 + 0.5).astype(int),
        np.floor(world[keep, 0] / 0.04 + 0.5).astype(int),
    )
    assert store.used > 100
    assert np.array_equal(cell[:m], store.locate(row, col))
    uz = (d @ r.T)[keep, 2] / reach[keep]
    want = 0.01**2 * uz**2 + (0.002 * reach[keep]) ** 2 * (1 - uz**2)
    np.testing.assert_allclose(1.0 / weight[:m], want, rtol=1e-4)
    np.testing.assert_allclose(shared[:m], (0.004 * flat[keep]) ** 2 + 0.005**2, rtol=1e-4)


def reduce_oracle(cell, z, weight, shared, band, clearance):
    out = {}
    for c in np.unique(cell):
        at = np.flatnonzero(cell == c)
        h = z[at]
        top = h.max()
        if top - h.min() > clearance:
            low = h[h < h.min() + np.float32(clearance)].max()
            above = h[h >= h.min() + np.float32(clearance)].min()
            if above - low > clearance:
                top = low
        use = at[(h <= top) & (h >= top - band)]
        w = weight[use].astype(float)
        out[c] = (top, h.min(), w.sum(), (w * z[use]).sum() / w.sum(), len(use), shared[use].mean())
    return out


def test_reduce_equals_numpy() -> None:
    rng = np.random.default_rng(1)
    n = 4000
    cell = rng.integers(0, 300, n).astype(np.uint32)
    z = (rng.choice([0.0, 0.3, 2.0], n, p=[0.9, 0.07, 0.03]) + rng.normal(0, 0.03, n)).astype(np.float32)
    weight, shared = (rng.uniform(*span, n).astype(np.float32) for span in ((1e3, 1e5), (1e-5, 1e-3)))
    mark = rng.integers(-5, 400, 300).astype(np.int32)  # scratch may hold anything
    which, slot, sums = np.empty(n, np.int64), np.empty(n, np.uint32), np.empty((n, 8), np.float32)
    k, overhangs = kernels.reduce_cells(cell, z, weight, shared, n, mark, 0.05, 0.8, which, slot, sums)
    want = reduce_oracle(cell, z, weight, shared, 0.05, 0.8)
    assert k == len(want)
    assert overhangs > 0
    for s in range(k):
        t, b, w, mean, count, shared = want[which[s]]
        top, bottom, weight, depth, points, common = sums[s, :6]
        assert (top, bottom, points) == (t, b, count)
        assert weight == pytest.approx(w, rel=1e-4)
        assert top + depth / weight == pytest.approx(mean, abs=1e-5)
        assert common / points == pytest.approx(shared, rel=1e-4)


class CellOracle:
    """The two-mode cell, written once more in plain Python."""

    def __init__(self) -> None:
        self.h = self.v = None
        self.n = self.streak = self.seen = self.alt_seen = 0
        self.alt = self.below = None

    def take(self, z, pv, n, top, bottom, now):
        gate = None if self.h is None else max(0.05, 2.5 * (self.v + pv) ** 0.5)
        few = self.h is not None and self.n >= 3 > n and z - self.h > 0.05
        if self.h is None or (abs(z - self.h) > gate and self.n < 3 and n >= self.n):
            self.__init__()
            self.h, self.v, self.n, self.seen = z, max(pv, RULE[6]), n, now
            return
        if abs(z - self.h) <= gate and not few:
            v = min(self.v + 1e-8 * (now - self.seen), RULE[8])
            self.h = (v * z + pv * self.h) / (v + pv)
            self.v = max(v * pv / (v + pv), RULE[6])
            self.n, self.seen, self.streak = min(self.n + n, 255), now, 0
            return
        if z < self.h and top - bottom > 0.08:
            self.seen = now
            return
        if z > self.h and bottom - self.h > 0.8:
            return
        if self.streak and abs(z - self.alt) <= gate and now - self.alt_seen <= 1000:
            self.streak += 1
            self.alt += (z - self.alt) / self.streak
        else:
            self.alt, self.streak = z, 1
        self.alt_seen = now
        up, low = z > self.h, 0.0 < z - self.h <= 0.1
        if self.streak >= (2 if up else 5) and n * self.streak >= (6 if low and self.n >= 6 else 3):
            if up and (self.below is None or self.below >= self.h):
                self.below = self.h
            if not up and self.below is not None and self.below >= self.alt - gate:
                self.below = None
            self.h, self.v = self.alt, max(pv, RULE[6])
            self.n, self.seen, self.streak = min(n * self.streak, 255), now, 0


def test_fuse_equals_a_plain_reading_of_the_rules() -> None:
    rng = np.random.default_rng(2)
    store = TileStore(8)
    index = store.locate(np.repeat(np.arange(8), 8), np.tile(np.arange(8), 8))
    cells = [CellOracle() for _ in range(64)]
    counts, residuals = np.zeros(6, np.int64), np.zeros(2)
    for scan in range(60):
        now = 100 * scan + (3000 if scan > 30 else 0)
        pick = rng.permutation(64)[:40]
        mode = rng.choice([0.0, 0.07, 0.4, 1.5], 40, p=[0.5, 0.2, 0.25, 0.05])
        if scan > 20:  # something came to stand on half of the cells, then left
            mode = np.where((pick < 32) & (scan < 40), 0.4, mode * (pick >= 32))
        z = (mode + rng.normal(0, 0.01, 40)).astype(np.float32)
        extent = rng.choice([0.0, 0.02, 0.3], 40, p=[0.5, 0.4, 0.1])
        n = rng.integers(1, 6, 40)
        weight, shared = (
            rng.uniform(1e3, 1e5, 40).astype(np.float32),
            rng.uniform(1e-6, 1e-4, 40).astype(np.float32),
        )
        bottom = (z - extent).astype(np.float32)
        sums = np.stack([z, bottom, weight, np.zeros(40), n, shared * n], axis=1).astype(np.float32)
        kernels.fuse(index[pick], sums, 40, store.cells, now, RULE, counts, residuals, store.touched, 6)
        for s, c in enumerate(pick):
            pv = 1.0 / float(sums[s, 2]) + float(sums[s, 5]) / float(sums[s, 4])
            cells[c].take(float(z[s]), pv, int(n[s]), float(z[s]), float(bottom[s]), now)
    got = store.cells[index]
    np.testing.assert_allclose(got["height"], [c.h for c in cells], atol=2e-5)
    np.testing.assert_allclose(got["variance"], [c.v for c in cells], rtol=1e-3)
    assert got["count"].tolist() == [c.n for c in cells]
    assert got["streak"].tolist() == [c.streak for c in cells]
    below = np.array([np.nan if c.below is None else c.below for c in cells])
    np.testing.assert_allclose(got["below"], below, atol=2e-5)
    assert counts[kernels.REPLACED] > 50
    assert counts[kernels.OVERHANG] > 0


@pytest.mark.parametrize(
    ("sigma", "known", "points", "rise", "scans"),
    [
        (0.003, 30, 1, 0.08, 6),  # mixed pixels beside the end of a wall
        (0.04, 6, 1, 0.08, 6),  # the same over a prior map, which is less certain
        (0.003, 5, 1, 0.08, 3),
        (0.003, 30, 3, 0.08, 2),
        (0.003, 30, 1, 0.12, 3),  # somebody steps there
        (0.003, 30, 3, 0.12, 2),
    ],
)
def test_few_points_do_not_raise_by_little_a_height_that_many_told(sigma, known, points, rise, scans) -> None:
    store = TileStore(8)
    index = store.locate(np.array([3]), np.array([3]))
    row = store.cells[index]
    row["height"], row["variance"], row["count"], row["source"] = 0.0, sigma**2, known, LIDAR
    row["upper"], row["alt"], row["below"] = np.inf, np.nan, np.nan
    store.cells[index] = row
    counts, residuals = np.zeros(6, np.int64), np.zeros(2)
    sums = np.array([[rise, rise, 4e4 * points, 0.0, points, 1e-5 * points, 0.0, 0.0]], np.float32)
    for scan in range(1, scans + 1):
        assert store.cells[index]["height"][0] == 0.0, f"before scan {scan}"
        kernels.fuse(index, sums, 1, store.cells, 100 * scan, RULE, counts, residuals, store.touched, 6)
    assert store.cells[index]["height"][0] == pytest.approx(rise)


def crossing(sensor, end, low, high):
    """Planar distances (...) at which a ray enters and leaves squares (..., 2); it misses those that it leaves before
    it enters."""
    d = end[:2] - sensor[:2]
    length = np.hypot(*d)
    u = d / length
    with np.errstate(divide="ignore"):
        a, b = (low - sensor[:2]) / u, (high - sensor[:2]) / u
    return np.maximum(np.minimum(a, b).max(axis=-1), 0.0), np.maximum(a, b).min(axis=-1)


def test_trace_equals_brute_force_over_all_cells() -> None:
    rng = np.random.default_rng(3)
    res, size, angle = 0.1, 32, 0.003
    store = TileStore(size)
    grid = np.arange(-32, 32)
    index = store.locate(np.repeat(grid, 64), np.tile(grid, 64)).reshape(64, 64)
    known = rng.random((64, 64)) < 0.5
    store.cells["source"][index[known]] = LIDAR
    store.cells["height"][index[known]] = rng.uniform(-0.2, 0.6, known.sum())
    store.cells["variance"][index[known]] = 1e-4
    store.cells["count"][index[known]] = 9
    sensor = np.array([0.03, -0.02, 0.5])
    ends = np.column_stack([rng.uniform(-3, 3, (60, 2)), rng.uniform(-0.4, 0.6, 60)]).astype(np.float32)
    hit, low, many = np.empty(5000, np.int64), np.empty(5000), np.empty(5000, np.int32)
    n = trace(
        ends, 60, 1, 0, sensor, store.directory, store.first, store.shift, res, 2.5, 0.3, 0.04, angle, 3,
        store.cells, store.touched, store.mark, hit, low, many,
    )  # fmt: skip
    want_hit: dict[int, tuple[float, int]] = {}
    upper = np.full((64, 64), np.inf)
    height = np.where(known, store.cells["height"][index], -np.inf)

    def alone(r: int, c: int) -> bool:
        r0, c0 = r // 32 * 32, c // 32 * 32  # its tile
        around = [
            height[a, b]
            for a in range(max(r - 1, r0), min(r + 2, r0 + 32))
            for b in range(max(c - 1, c0), min(c + 2, c0 + 32))
            if (a, b) != (r, c)
        ]
        return not any(h > height[r, c] - COMPANY_BAND for h in around)

    late = 0
    middle = np.stack(np.meshgrid(grid, grid), axis=-1) * res  # x, y of row and column
    for end in ends.astype(float):
        dist = np.hypot(*(end - sensor)[:2])
        dz = (end[2] - sensor[2]) / dist
        enter, leave = crossing(sensor, end, middle - res / 2, middle + res / 2)
        for r, c in np.argwhere((leave > enter) & (leave <= min(dist - res, 2.5))).tolist():
            cut = enter[r, c], leave[r, c]
            if known[r, c]:
                z = sensor[2] + dz * (cut[0] if dz < 0 else cut[1])
                over = float(store.cells["height"][index[r, c]]) - z - 0.04
                near_end = cut[1] > min(dist - 0.3, 2.5)
                if near_end and not (cut[1] <= min(dist - 0.075, 2.5) and alone(r, c)):
                    continue
                if over > 3 * np.sqrt(1e-4 + (angle * cut[1]) ** 2):
                    was = want_hit.get(int(index[r, c]), (np.inf, 0))
                    want_hit[int(index[r, c])] = (min(was[0], z), was[1] + 1)
                    late += near_end
            else:
                upper[r, c] = min(upper[r, c], sensor[2] + dz * sum(cut) / 2 + angle * cut[1])
    assert n == len(want_hit)
    assert n > 100
    assert late > 2  # some count only because they stand alone
    for k in range(n):
        assert low[k] == pytest.approx(want_hit[int(hit[k])][0], abs=1e-9)
        assert many[k] == want_hit[int(hit[k])][1]
    np.testing.assert_allclose(store.cells["upper"][index], upper, atol=1e-6)


def test_judge_removes_after_two_looks_and_gives_the_ground_back() -> None:
    store = TileStore(8)
    around = store.locate(np.repeat([1, 2], 5), np.tile(np.arange(5), 2))
    store.cells["source"][around], store.cells["height"][around] = LIDAR, 0.0  # ground beside all of them
    index = store.locate(np.zeros(5, np.int64), np.arange(5))
    store.cells["source"][index] = LIDAR
    store.cells["height"][index], store.cells["variance"][index] = 0.5, 1e-4
    store.cells["count"][index] = [9, 9, 9, 1, 9]
    store.cells["below"][index[1]] = 0.01  # ground known before
    store.cells["below"][index[0]] = 0.11  # the foot of it, seen before the rest: nothing around is that high
    store.cells["below"][index[2]] = (
        0.30  # an earlier, lower view of the same thing: the rays passed under it
    )
    low, many = np.full(5, 0.2), np.array([5, 5, 5, 1, 1], np.int32)

    def look(now: int, at: np.ndarray) -> int:
        args = (low[at], many[at], len(at), 2, 500, 3, 0.8, now, store.cells, store.touched, 6)
        return judge(index[at], *args)

    everything = np.arange(5)
    assert look(400, everything) == 0  # confirmed too recently
    store.cells["passes"][index] = 0
    assert look(700, everything) == 1  # the stray point goes at once
    assert look(1000, np.array([0, 1, 2, 4])) == 3
    got = store.cells[index]
    assert got["height"][1] == pytest.approx(0.01)
    assert got["source"][1] == LIDAR
    assert np.isnan(got["height"][[0, 2, 3]]).all()
    assert (got["source"][[0, 2, 3]] == UNKNOWN).all()
    assert got["height"][4] == pytest.approx(0.5)  # one ray is not enough against a settled cell
