"""Ground the wheels stand on: the support plane under a robot whose LiDAR cannot see its own feet."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mapping.elevation.exchange import MapPatch
from mapping.elevation.tiles import CONTACT, LIDAR, UNKNOWN, TileStore

ROUGH_HEIGHT = 0.04
"""Contacts this far off their common plane [m] stand on steps or rubble: no plane, only the wheels' own spots."""
WHEEL_SPOT = 0.10
"""Radius of ground known around one wheel contact [m]."""
MAX_SLOPE = 0.7
"""Steeper planes come from a wheel on a kerb, not from ground."""
CONTRADICTED_SHARE = 0.25
"""Share of the LiDAR's cells off the support plane that tell that the wheels do not stand on one."""


@dataclass(frozen=True, slots=True, eq=False)
class SupportPatch:
    """Cells on the world lattice with the height and variance of the support plane."""

    i: NDArray[np.int64]
    j: NDArray[np.int64]
    height: NDArray[np.float32]
    variance: NDArray[np.float32]
    under: NDArray[np.bool_]
    """Within the body rectangle."""

    def those(self, which: NDArray[np.bool_]) -> SupportPatch:
        """Some of the cells."""
        return SupportPatch(
            self.i[which], self.j[which], self.height[which], self.variance[which], self.under[which]
        )


def support_patch(
    contacts: NDArray[np.float64],
    centre: NDArray[np.float64],
    yaw: float,
    half: tuple[float, float],
    radius: float | None,
    sigma: float,
    resolution: float,
    plane: bool = True,
) -> SupportPatch:
    """Cells under the robot from wheel contacts.

    contacts (k, 3), k > 0, bottoms of the touching wheels, world [m]; centre (2,) of the body, world; half: half
    length and width of the body rectangle with its margin [m]; radius: a disc of this radius instead [m]. Three
    contacts give the plane by least squares. Fewer contacts, or no `plane`, tell of their own spots only."""
    mean = contacts.mean(axis=0)
    local = contacts - mean
    slope = np.linalg.lstsq(local[:, :2], local[:, 2], rcond=0.05)[0]
    off = np.abs(local[:, 2] - local[:, :2] @ slope).max()
    rough = not plane or len(contacts) < 3 or off > ROUGH_HEIGHT or float(np.hypot(*slope)) > MAX_SLOPE
    reach = max(half) * 1.5 if radius is None else radius
    lo = np.floor((centre - reach) / resolution).astype(int)
    hi = np.ceil((centre + reach) / resolution).astype(int)
    most = int((hi[0] - lo[0] + 1) * (hi[1] - lo[1] + 1))
    i, j, under = np.empty(most, np.int64), np.empty(most, np.int64), np.empty(most, np.bool_)
    height, variance = np.empty(most, np.float32), np.empty(most, np.float32)
    n = _cells(
        lo, hi, centre, np.cos(yaw), np.sin(yaw), *half, -1.0 if radius is None else radius,
        contacts, mean, slope, rough, sigma, resolution, i, j, height, variance, under,
    )  # fmt: skip
    return SupportPatch(i[:n], j[:n], height[:n], variance[:n], under[:n])


@njit(cache=True)
def _cells(
    lo, hi, centre, c, s, half_length, half_width, radius, contacts, mean, slope, rough, sigma, resolution,
    i, j, height, variance, under,
):  # fmt: skip  # pragma: no cover
    """Write the cells of `support_patch` from lattice column and row `lo` to `hi` (2,); returns their number. radius
    < 0: the body rectangle."""
    n = 0
    for row in range(lo[1], hi[1] + 1):
        for col in range(lo[0], hi[0] + 1):
            x, y = col * resolution - centre[0], row * resolution - centre[1]
            below = abs(c * x + s * y) <= half_length and abs(-s * x + c * y) <= half_width
            if not (below if radius < 0.0 else x * x + y * y <= radius * radius):
                continue
            px, py = col * resolution, row * resolution
            nearest, wheel = np.inf, 0
            for k in range(len(contacts)):
                away = np.hypot(px - contacts[k, 0], py - contacts[k, 1])
                if away < nearest:
                    nearest, wheel = away, k
            if rough and nearest > WHEEL_SPOT:
                continue
            plane = mean[2] + (px - mean[0]) * slope[0] + (py - mean[1]) * slope[1]
            spread = sigma + 0.05 * nearest
            i[n], j[n], under[n] = row, col, below
            height[n] = contacts[wheel, 2] if rough else plane
            variance[n] = spread * spread
            n += 1
    return n


def behind(
    patch: SupportPatch, off: NDArray[np.bool_], centre: NDArray[np.float64], resolution: float
) -> NDArray[np.bool_]:
    """Which cells of a patch (n,) lie behind a cell of another height, `off` (n,), as seen from `centre` (2,) [m].

    The robot stands on this side of a wall or an edge: its support plane says nothing of the other side."""
    i0, j0 = patch.i.min(), patch.j.min()
    blocks = np.zeros((patch.i.max() - i0 + 1, patch.j.max() - j0 + 1), np.bool_)
    blocks[patch.i - i0, patch.j - j0] = off
    ci, cj = centre[1] / resolution - i0, centre[0] / resolution - j0
    di, dj = patch.i - i0 - ci, patch.j - j0 - cj
    steps = np.linspace(0.0, 1.0, 2 * max(blocks.shape) + 1)[:, None]
    i, j = np.rint(ci + steps * di).astype(int), np.rint(cj + steps * dj).astype(int)
    # The centre may lie beside the patch: what the line crosses before it blocks nothing.
    inside = (i >= 0) & (i < blocks.shape[0]) & (j >= 0) & (j < blocks.shape[1])
    return (inside & blocks[np.clip(i, 0, blocks.shape[0] - 1), np.clip(j, 0, blocks.shape[1] - 1)]).any(
        axis=0
    )


def carried(store: TileStore, resolution: float, contacts: NDArray[np.float64]) -> NDArray[np.bool_]:
    """(k,) whether known ground can carry a wheel at each of `contacts` (k, 3) [m]: the LiDAR knows ground at its
    height there, or none at all."""
    out = np.array(np.isfinite(contacts).all(axis=1))
    x, y, z = contacts[out].T
    reach = np.arange(-round(WHEEL_SPOT / resolution), round(WHEEL_SPOT / resolution) + 1)
    i, j = (np.rint(v / resolution).astype(np.int64)[:, None] + reach for v in (y, x))
    n = len(reach)
    at = store.locate(np.repeat(i, n, axis=1).ravel(), np.tile(j, n).ravel())  # it may grow the pool
    cells = store.cells[at].reshape(len(x), n * n)
    seen = cells["source"] == LIDAR
    out[out] = ~seen.any(axis=1) | (seen & (np.abs(cells["height"] - z[:, None]) <= ROUGH_HEIGHT)).any(axis=1)
    return out


def enter(
    store: TileStore,
    contacts: NDArray[np.float64],
    centre: NDArray[np.float64],
    yaw: float,
    half: tuple[float, float],
    radius: float | None,
    sigma: float,
    resolution: float,
) -> SupportPatch:
    """Write the ground under the wheels where neither LiDAR nor wheels knew better. Returns what was written; see
    `support_patch`.

    Three wheels on rubble always make a plane. If the LiDAR knows another ground under the body, only the wheels'
    spots are written."""
    for plane in (True, False):
        patch = support_patch(contacts, centre, yaw, half, radius, sigma, resolution, plane)
        cell = store.locate(patch.i, patch.j)
        old = store.cells[cell]
        seen = old["source"] == LIDAR
        off = seen & (np.abs(patch.height - old["height"]) > ROUGH_HEIGHT)
        if np.count_nonzero(off & patch.under) <= CONTRADICTED_SHARE * np.count_nonzero(seen & patch.under):
            break
    take = (old["source"] == UNKNOWN) | ((old["source"] == CONTACT) & (patch.variance <= old["variance"]))
    if radius is not None:  # the patch is larger than the body
        take &= ~behind(patch, off, centre, resolution)
    written = patch.those(take)
    _write(store, cell[take], written.height, written.variance, CONTACT)
    return written


def entered(patch: MapPatch) -> SupportPatch:
    """What `enter` once wrote, as far as a read-out of the map shows it; none of it counts as under the body."""
    row, col = np.nonzero(patch.layers["source"] == CONTACT)
    return SupportPatch(
        (row + patch.cell[0]).astype(np.int64),
        (col + patch.cell[1]).astype(np.int64),
        patch.layers["elevation"][row, col],
        patch.layers["variance"][row, col],
        np.zeros(len(row), np.bool_),
    )


def take_back(store: TileStore, written: SupportPatch) -> None:
    """Forget what was written beyond the body, as far as nobody has measured it since."""
    beyond = written.those(~written.under)
    cell = store.locate(beyond.i, beyond.j)
    old = store.cells[cell]
    same = (
        (old["source"] == CONTACT) & (old["height"] == beyond.height) & (old["variance"] == beyond.variance)
    )
    _write(store, cell[same], np.nan, np.nan, UNKNOWN)


def _write(
    store: TileStore,
    cell: NDArray[np.int64],
    height: NDArray[np.float32] | float,
    variance: NDArray[np.float32] | float,
    source: int,
) -> None:
    new = store.cells[cell]
    new["height"], new["variance"], new["source"] = height, variance, source
    store.cells[cell] = new
    store.changed(cell)
