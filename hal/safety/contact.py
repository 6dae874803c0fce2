"""Walls that the body touches: which cells they are, and which part of the body is in none of them.

A wall that the body is already in, because it leans at it or slid to it, stops only motion deeper into it. For that
wall the body ends where the wall begins now. The part left out this way is checked against all other walls
(`hal.safety.swept.shells`)."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from hal.raster import cell_of
from hal.safety.swept import FACE_NOISE, Body, Stand, Surroundings
from hal.types import Capabilities

DEEPEST_WALL = 0.12
"""[m] Largest depth of a wall in the body: of robots that leaned at one by 20 to 31 deg it was 0.08 to 0.12. Deeper,
map or pose is wrong."""
NEAR_WALL = 0.04
"""[m] A wall that is nearer to the body touches it: a cell of the map."""
WALL_REACH = 0.9
"""[m] from base_link: as far as a wall that the body touches is followed."""


class Contact(NamedTuple):
    """The body is in a wall, or NEAR_WALL it."""

    whole: Body
    """The body."""
    clear: Body
    """How far a body may reach, at most by NEAR_WALL beyond the true one, to be in no wall."""
    flat: tuple[bool, bool]
    """Whether a wall is along the left side, along the right side, and not at one end of it."""
    wall: NDArray[np.uint8]
    """(rows, cols) 1 where that wall is."""

    @property
    def body(self) -> Body:
        """The part of the body that is in no wall."""
        return Body(*map(min, self.clear, self.whole))

    def between(self, by: float) -> Body:
        """The body less what of its sides is in a wall, and `by` [m] more on a side along which there is one."""
        left, right = (
            end - (by if flat else 0.0) for end, flat in zip(self.body[2:], self.flat, strict=True)
        )
        return Body(self.whole.front, self.whole.back, left, right)


def contact_at(
    around: Surroundings, pose: tuple[float, float, float], stand: Stand, robot: Capabilities
) -> Contact | None:
    """The walls that the body at `pose` is in by up to DEEPEST_WALL, or NEAR_WALL; None where there are none."""
    wall = np.zeros(around.height.shape, np.uint8)
    place = (*around.origin, around.resolution, float(pose[0]), float(pose[1]), float(pose[2]))
    limit = robot.max_step + FACE_NOISE
    face = limit + 2.0 * around.resolution * math.tan(robot.max_slope)  # a step on the steepest slope
    whole = Body.of(robot)
    ends, flat = ends_clear_of(around.height, *place, stand, limit, face, wall, whole.front, whole.left)
    if not wall.any():
        return None
    grow_wall(around.height, *place, stand, limit, wall)
    return Contact(whole, Body(*ends), flat, wall)


@njit(cache=True)
def is_wall(height, row, col, plane, limit):  # pragma: no cover - compiled
    """Whether a cell rises above `plane` [m] by more than `limit` [m], or by half of it beside a cell that does: the
    foot of a wall is mixed."""
    rows, cols = height.shape
    above = height[row, col] - plane
    if not above > 0.5 * limit:
        return False
    if above > limit:
        return True
    for r in range(max(0, row - 1), min(rows, row + 2)):
        for k in range(max(0, col - 1), min(cols, col + 2)):
            if height[r, k] - plane > limit:
                return True
    return False


@njit(cache=True)
def is_face(height, row, col, limit):  # pragma: no cover - compiled
    """Whether a cell rises by more than `limit` [m] within two cells: beside a leaning robot, kerbs lie high above
    its plane."""
    rows, cols = height.shape
    for r in range(max(0, row - 2), min(rows, row + 3)):
        for k in range(max(0, col - 2), min(cols, col + 3)):
            if height[row, col] - height[r, k] > limit:
                return True
    return False


@njit(cache=True)
def ends_clear_of(
    height, x0, y0, resolution, x, y, yaw, stand, limit, face, wall, length, width
):  # pragma: no cover - compiled
    """How far a body of half the `length` and half the `width` [m], larger by NEAR_WALL, reaches to the front, back,
    left and right [m] without its part in walls. A wall is higher than `limit` [m] above the plane under the robot and
    rises by more than `face` [m] within two cells. Sets `wall` (rows, cols) to 1 in the cells of walls that the body
    is in. The second result: whether walls are along its left and along its right side."""
    rows, cols = height.shape
    c, s = math.cos(yaw), math.sin(yaw)
    ahead, behind = np.zeros(2), np.zeros(2)  # farthest along, on the left and on the right
    half = 0.5 * resolution * (abs(c) + abs(s))
    front, left = length + NEAR_WALL, width + NEAR_WALL
    back, right = front, left
    reach = math.ceil(math.hypot(front, left) / resolution)
    col, row = cell_of(x, x0, resolution), cell_of(y, y0, resolution)
    # First what lies at one side alone: what lies at a corner may belong to either.
    for corners in range(2):
        for r in range(max(0, row - reach), min(rows, row + reach + 1)):
            for k in range(max(0, col - reach), min(cols, col + reach + 1)):
                dx, dy = x0 + k * resolution - x, y0 + r * resolution - y
                u, v = c * dx + s * dy, c * dy - s * dx
                along = (front - u if u > 0.0 else back + u) + half
                across = (left - v if v > 0.0 else right + v) + half
                deep = length - abs(u) + half, width - abs(v) + half
                if not -NEAR_WALL < min(deep) <= DEEPEST_WALL or (max(deep) <= DEEPEST_WALL) != (
                    corners == 1
                ):
                    continue
                if not height[r, k] - (stand[0] + stand[1] * u + stand[2] * v) > limit:
                    continue
                if not is_face(height, r, k, face):
                    continue
                wall[r, k] = 1
                if deep[1] <= DEEPEST_WALL:
                    edge = 0 if v > 0.0 else 1
                    ahead[edge], behind[edge] = max(ahead[edge], u), max(behind[edge], -u)
                if along <= 0.0 or across <= 0.0:
                    continue  # left out already
                if (deep[0] < deep[1]) if corners == 0 else (along < across):
                    if u > 0.0:
                        front = u - half
                    else:
                        back = -u - half
                elif v > 0.0:
                    left = v - half
                else:
                    right = -v - half
    ends = np.minimum(ahead, behind) > 0.5 * length
    return (front, back, left, right), (ends[0], ends[1])


@njit(cache=True)
def grow_wall(height, x0, y0, resolution, x, y, yaw, stand, limit, wall):  # pragma: no cover - compiled
    """Set `wall` (rows, cols) to 1 in all wall cells within WALL_REACH of x, y [m] connected to those it holds; noise
    may leave a gap of one cell."""
    rows, cols = height.shape
    c, s = math.cos(yaw), math.sin(yaw)
    queue = np.empty((rows * cols, 2), np.int32)
    n = 0
    for r in range(rows):
        for k in range(cols):
            if wall[r, k] > 0:
                queue[n, 0], queue[n, 1] = r, k
                n += 1
    done = 0
    while done < n:
        row, col = queue[done, 0], queue[done, 1]
        done += 1
        for r in range(max(0, row - 2), min(rows, row + 3)):
            for k in range(max(0, col - 2), min(cols, col + 3)):
                dx, dy = x0 + k * resolution - x, y0 + r * resolution - y
                if wall[r, k] > 0 or math.hypot(dx, dy) > WALL_REACH:
                    continue
                plane = stand[0] + stand[1] * (c * dx + s * dy) + stand[2] * (c * dy - s * dx)
                if is_wall(height, r, k, plane, limit):
                    wall[r, k] = 1
                    queue[n, 0], queue[n, 1] = r, k
                    n += 1
