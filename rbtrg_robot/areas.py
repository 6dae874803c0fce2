"""Areas that were drawn on the ground, in messages and beside the map on the disk, as one fence."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hal.safety.geofence import Fence, Geofence, GeofenceError
from mapping.elevation.exchange import MapError
from mapping.elevation.files import areas_in
from mapping.grid import FARTHEST_PLACE
from rbtrg_robot import msg

MOST_AREAS = 50
"""Areas at once."""
MOST_CORNERS = 100
"""Of one."""


def fence_of(areas: Sequence[msg.GroundArea]) -> Fence:
    """Raises GeofenceError where one of them is no polygon in `map`, or there are too many."""
    if len(areas) > MOST_AREAS or any(len(area.corners) > 2 * MOST_CORNERS for area in areas):
        raise GeofenceError(f"at most {MOST_AREAS} areas of {MOST_CORNERS} corners each")
    polygons = []
    for area in areas:
        if len(area.corners) % 2 or not (np.abs(area.corners) < FARTHEST_PLACE).all():
            raise GeofenceError(f"`map` reaches {FARTHEST_PLACE / 1000:.0f} km, and a corner is x and y")
        corners = np.reshape(area.corners, (-1, 2)).tolist()
        polygons.append(Geofence.of(corners, keep_out=bool(area.keep_out), name=area.name))
    return Fence(tuple(polygons))


def ground_area(name: str, corners: Sequence[Sequence[float]], *, keep_out: bool) -> msg.GroundArea:
    """`corners` x, y [m] in `map`, unchecked: `fence_of` judges them. Raises ValueError, TypeError for anything but
    numbers."""
    flat = np.array([(float(x), float(y)) for x, y in corners], np.float64).reshape(-1)
    return msg.GroundArea(name=name, keep_out=keep_out, corners=flat)


def plain(areas: Sequence[msg.GroundArea]) -> list[dict[str, object]]:
    """As JSON holds them: name, keep_out, corners [[x, y] in metres]."""
    return [
        {"name": a.name, "keep_out": bool(a.keep_out), "corners": np.reshape(a.corners, (-1, 2)).tolist()}
        for a in areas
    ]


def read_areas(file: Path) -> list[msg.GroundArea]:
    """Those that a map file holds. Raises MapError."""
    try:
        return of_text(areas_in(file))
    except GeofenceError as error:
        raise MapError(f"{file.name}: {error}") from error


def to_text(areas: Sequence[msg.GroundArea]) -> str:
    """As a map file holds them."""
    return json.dumps(plain(areas))


def of_text(text: str) -> list[msg.GroundArea]:
    """What `to_text` wrote; none of an empty text. Raises GeofenceError for anything else."""
    try:
        rows = json.loads(text or "[]")
    except (ValueError, RecursionError) as error:
        raise GeofenceError("its areas cannot be read") from error
    return of_rows(rows)


def of_rows(rows: Any) -> list[msg.GroundArea]:
    """What `plain` made, from whoever. Raises GeofenceError for anything else."""
    try:
        found = [
            ground_area(str(row["name"])[:64], row["corners"], keep_out=row["keep_out"] is True)
            for row in rows
        ]
    except (ValueError, KeyError, TypeError, OverflowError) as error:
        raise GeofenceError("an area has a name, keep_out, and corners x, y in metres") from error
    fence_of(found)
    return found
