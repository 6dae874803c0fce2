"""What a controller was measured to do, as prices that the planner's kernels look up.

The hazard of a motion is -ln(1 - p), with p the probability that it ends the drive (`hal.envelope`). Hazards add along
a route, so a route's cost may hold them: `fall_cost` metres for each (`GraphParams`). What is no motion of the table
costs nothing.
"""

from __future__ import annotations

import math
from functools import cache, partial
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from hal.envelope import FAILURES, MAX_RISK, Envelope, Table, stored
from planning.graph.params import GraphParams

Array = NDArray[np.float64]

ENDING = ("fell", "stuck", "touched")
"""Kinds of `hal.envelope.FAILURES` that end a drive."""
SLIDES_END = 0.25
"""Share of the slides that do, beside or on a face: the robot stands astride then, and may fall in the next turn. On
stairs none did: the tracker leads the robot back. By the kerb lanes of decision 28."""
POINT_SPREAD = math.sqrt(3.0)
"""Of the outer points, in standard deviations."""
MIDDLE_WEIGHT, OUTER_WEIGHT = 2.0 / 3.0, 1.0 / 6.0
"""Weights of the points."""
MAP_SIGMA = 0.01
"""Standard deviation of a face on the map [m]."""
SIZE_STEP, SIZE_COUNT = 0.01, 36
"""Heights and widths of the tables [m]: 0 to 0.35, beyond which nothing was tried."""
TREAD_STEP, LEAST_TREAD, TREAD_COUNT = 0.02, 0.20, 8
"""Depths of treads of the tables [m]: 0.20 to 0.34, deeper ones are no easier."""
FLIGHT_RISERS = 8
"""Risers from one landing to the next, half a storey: nothing turns round between them, so they are one motion."""
LONGEST_TREAD = 0.45
"""Faces up, or down, that are so far apart [m] at most are stairs."""
ANGLE_STEP, ANGLE_COUNT = math.radians(5.0), 37
"""Angles of the tables [rad]: 0 to 180 deg."""
MEASURED_SPEED = 0.5
"""[m/s] at which slopes, faces and posts within the limits of every controller are passed (`tools.bench envelope`):
they are no reason to be slower."""


class Prices(NamedTuple):
    """Prices by size (`SIZE_COUNT`) and angle (`ANGLE_COUNT`)."""

    measured: bool
    """Whether they come from an envelope. Without one stairs are a slope."""
    face: Array
    """(2, 2, sizes, angles) [m] of one wheel that crosses a face: up or down, driven forward or backward, by the face's
    height and the angle between travel and its normal."""
    stairs: Array
    """(2, sizes, treads, angles) [m] of one wheel that crosses a riser of stairs driven forward, up or down. Infinite
    where stairs are no way: those on which a flight ends the drive too often, up or down: what is driven down must be
    left."""
    slope: Array
    """(angles, angles) [m/m] by steepness and the angle between travel and uphill."""
    turn: Array
    """(2, sizes, angles) [m/rad] of a bend and of a turn on the spot, by the highest edge under the wheels and
    steepness."""
    posts: Array
    """(sizes,) [m/m] in a stepfield, by the height of its posts."""
    gap: Array
    """(sizes,) [m] of one wheel that crosses a gap, by its width."""
    axle: float
    tread: float
    """Where the wheels touch the ground, before base_link and beside it [m]."""
    radius: float
    """From its axle a wheel touches a face that is higher than this [m]."""

    def of_face(self, size: float, angle: float, tread: float, back: bool) -> float:
        """[m] of one wheel that crosses a face of `size` [m], negative: down, at an angle to its normal [rad]; `tread`
        [m]: of stairs, else 0."""
        down, i, j = int(size < 0.0), size_at(size), angle_at(angle)
        stairs = tread > 0.0 and not back
        return float(self.stairs[down, i, tread_at(tread), j] if stairs else self.face[down, int(back), i, j])


def free(axle: float, tread: float, radius: float) -> Prices:
    """Where nothing has a price: the paper's cost."""
    return Prices(
        False,
        np.zeros((2, 2, SIZE_COUNT, ANGLE_COUNT)),
        np.zeros((2, SIZE_COUNT, TREAD_COUNT, ANGLE_COUNT)),
        np.zeros((ANGLE_COUNT, ANGLE_COUNT)),
        np.zeros((2, SIZE_COUNT, ANGLE_COUNT)),
        np.zeros(SIZE_COUNT),
        np.zeros(SIZE_COUNT),
        axle,
        tread,
        radius,
    )


def prices_of(params: GraphParams) -> Prices:
    """Prices by the stored envelope of a controller. Raises EnvelopeError."""
    return _prices(params.controller, params.fall_cost, params.axle, params.tread, params.radius)


def hazards_of(params: GraphParams) -> Prices:
    """The same with hazards, -ln(1 - p), instead of metres. Raises EnvelopeError."""
    return _prices(params.controller, 1.0, params.axle, params.tread, params.radius)


@cache
def _prices(controller: str | None, fall_cost: float, axle: float, tread: float, radius: float) -> Prices:
    if controller is None or fall_cost == 0.0:
        return free(axle, tread, radius)
    envelope = stored(controller)
    size = np.arange(SIZE_COUNT) * SIZE_STEP
    angle = np.arange(ANGLE_COUNT) * ANGLE_STEP
    steep = np.minimum(angle, math.radians(60.0))
    out = free(axle, tread, radius)._replace(measured=True)

    def price(name: str, sigma: float, *values: ArrayLike) -> Array:
        if name not in envelope.manoeuvres:
            return np.zeros(np.broadcast_shapes(*(np.shape(v) for v in values)))
        return fall_cost * hazards(envelope, name, sigma, *values)

    across = np.minimum(angle, np.pi - angle)
    barred = np.zeros((SIZE_COUNT, TREAD_COUNT, 1), np.bool_)
    for way, name in enumerate(("up", "down")):
        for back, prefix in enumerate(("", "back_")):
            out.face[way, back] = 0.25 * price(prefix + name, MAP_SIGMA, size[:, None], across, 0.0)
        stairs = f"stairs_{name}"
        riser, depth, askew = np.ix_(size, LEAST_TREAD + TREAD_STEP * np.arange(TREAD_COUNT), across)
        out.stairs[way] = 0.25 * price(stairs, MAP_SIGMA, riser, depth, askew)
        if stairs in envelope.manoeuvres:
            ends = envelope.bound(stairs, riser, depth, 0.0, share=partial(ending, stairs))
            barred |= 1.0 - (1.0 - ends) ** FLIGHT_RISERS > MAX_RISK
    out.stairs[:, barred[..., 0]] = np.inf
    out.slope[:] = price("slope", 0.0, steep[:, None], angle)
    for k, name in enumerate(("bend", "spin")):
        out.turn[k] = price(name, MAP_SIGMA, size[:, None], steep, 1.0)
    out.posts[:] = price("posts", MAP_SIGMA, size, MEASURED_SPEED)
    out.gap[:] = 0.25 * price("gap", MAP_SIGMA, size)
    # No height is no face, whatever the map's noise makes of it.
    out.face[:, :, 0], out.stairs[:, 0], out.posts[0], out.gap[0] = 0.0, 0.0, 0.0, 0.0
    return out


def hazards(envelope: Envelope, name: str, sigma: ArrayLike, height: ArrayLike, *rest: ArrayLike) -> Array:
    """-ln(1 - p) of units of a manoeuvre, as far as the fit reaches. SI units, broadcast.

    p that it ends the drive is the mean over height - sqrt(3) sigma, height and height + sqrt(3) sigma with weights
    1/6, 2/3, 1/6 (Gauss and Hermite with three points, exact for the first five moments of the height). What is no way
    is the business of `Envelope.hazard`.
    """
    height, aside = np.asarray(height, np.float64), POINT_SPREAD * np.asarray(sigma, np.float64)
    low, middle, high = (
        envelope.mean(name, at, *rest, share=partial(ending, name))
        for at in (np.maximum(height - aside, 0.0), height, height + aside)
    )
    p = MIDDLE_WEIGHT * middle + OUTER_WEIGHT * (low + high)
    return np.asarray(-np.log1p(-np.minimum(p, 1.0 - 1e-9)))


def ending(name: str, table: Table) -> float:
    """Share of a manoeuvre's failures that end a drive, with half a failure more of each sort (Jeffreys)."""
    slides = 0.0 if name.startswith("stairs") else SLIDES_END
    first = len(table.axes) + 1
    each = dict(zip(FAILURES, np.sum(table.cells, axis=0)[first:].tolist(), strict=True))
    return (sum(each[kind] for kind in ENDING) + slides * each["slid"] + 0.5) / (sum(each.values()) + 1.0)


@njit(cache=True)
def size_at(size: float) -> int:
    """Row of a table for a height or width [m]."""
    return min(int(abs(size) / SIZE_STEP + 0.5), SIZE_COUNT - 1)


@njit(cache=True)
def angle_at(angle: float) -> int:
    """Column of a table for an angle [rad] from -pi to pi."""
    return min(int(abs(angle) / ANGLE_STEP + 0.5), ANGLE_COUNT - 1)


@njit(cache=True)
def tread_at(tread: float) -> int:
    """Column of a table for the depth of a tread [m]."""
    return min(max(int((tread - LEAST_TREAD) / TREAD_STEP + 0.5), 0), TREAD_COUNT - 1)
