"""How a scene file is read: the options of every command that reads one."""

from __future__ import annotations

import math
from typing import Annotated, Any

import typer

Resolution = Annotated[
    float | None, typer.Option(metavar="METRES", help="Cell size of an imported scene [m].")
]
HeightRange = Annotated[
    tuple[float, float] | None,
    typer.Option(metavar="LOW HIGH", help="Heights of black and white in a .png scene [m]."),
]
Units = Annotated[
    str | None, typer.Option(metavar="UNIT", help="Of a cloud or mesh: m, cm, mm, ft; else guessed.")
]
Up = Annotated[
    str | None, typer.Option(metavar="AXIS", help="Its axis that points up: z or y; else guessed.")
]


def chosen(
    resolution: float | None,
    height_range: tuple[float, float] | None,
    units: str | None,
    up: str | None,
    start: tuple[float, float, float] | None = None,
) -> dict[str, Any]:
    """What was said of it, for `hal.scenes.load_scene`. `start`: x, y [m], yaw [deg]."""
    at = None if start is None else (*start[:2], math.radians(start[2]))
    options = {
        "resolution": resolution,
        "height_range": height_range,
        "units": units,
        "up": up,
        "start": at,
    }
    return {name: value for name, value in options.items() if value is not None}
