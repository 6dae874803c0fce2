"""What a stage knows at this instant, in names and words: its own figures, and what it knows of a place on the
ground."""

from __future__ import annotations

import math
from collections.abc import Iterator
from enum import Enum
from typing import Any

import numpy as np
from pydantic import BaseModel

from mapping.elevation.exchange import SOURCES
from planning.risk.body import weights_of
from planning.risk.cost import cost_of
from rbtrg_robot import msg
from rbtrg_robot.msg import Message
from rbtrg_robot.stages.elevation import ElevationStage
from rbtrg_robot.stages.look_around import views_of
from rbtrg_robot.stages.planner import PlannerStage
from rbtrg_robot.stages.stage import Stage

Row = tuple[str, str]
"""Name and value, in words."""

OURS = ("hal.", "mapping.", "planning.", "rbtrg_robot.")
MOST_DEPTH = 2
"""Objects within a stage and within these are looked into."""
MOST_LINES = 250
FEW_ITEMS = 8
"""Values of a list that are shown one by one."""


def figures(stage: Stage) -> list[Row]:
    """Everything in the stage that is a number, a word or a few of them, by the names the code has for it; of what is
    larger, its size."""
    rows = []
    for row in _rows(stage, "", MOST_DEPTH, {id(stage)}):
        rows.append(row)
        if len(rows) == MOST_LINES:
            rows.append(("...", f"the first {MOST_LINES} are shown"))
            break
    return rows


def _rows(thing: Any, lead: str, depth: int, seen: set[int]) -> Iterator[Row]:
    names = [*getattr(thing, "__dict__", ())]
    names += [n for c in type(thing).__mro__ for n in getattr(c, "__slots__", ()) if not n.startswith("__")]
    for name in names:
        value = getattr(thing, name, None)
        label = lead + name.lstrip("_")
        words = _words(value)
        if words is not None:
            yield label, words
        elif depth and _is_part(value) and id(value) not in seen:
            seen.add(id(value))
            yield from _rows(value, f"{label}.", depth - 1, seen)


def _is_part(value: Any) -> bool:
    """One of ours; settings and messages are shown elsewhere."""
    return type(value).__module__.startswith(OURS) and not isinstance(value, BaseModel | Message)


def _words(value: Any) -> str | None:
    """None for what is no value but a part with values of its own, or nothing to show."""
    if isinstance(value, Enum):
        return str(value.value)
    if value is None or isinstance(value, bool | str):
        return "none" if value is None else str(value)[:200] or "(empty)"
    if isinstance(value, int | float | np.number | np.bool_):
        return f"{value:.6g}" if isinstance(value, float | np.floating) else str(value)
    if isinstance(value, np.ndarray):
        return _few(value.ravel().tolist(), f"array {value.shape}")
    if isinstance(value, tuple) and hasattr(value, "_fields"):
        return None
    if isinstance(value, list | tuple | set | frozenset):
        return _few([*value], f"{len(value)} items")
    if isinstance(value, dict):
        return _few([f"{k} {_words(v)}" for k, v in value.items() if _words(v)], f"{len(value)} items")
    if hasattr(value, "__len__") and not type(value).__module__.startswith(OURS):
        return f"{len(value)} items"
    return None


def _few(values: list[Any], otherwise: str) -> str:
    if not values or len(values) > FEW_ITEMS:
        return otherwise if values else "nothing"
    words = [_words(value) for value in values]
    return ", ".join(word for word in words if word is not None) if None not in words else otherwise


def brief(message: Message) -> str:
    """A message in one line: its plain fields, and how long its lists are."""
    words = []
    names: tuple[str, ...] = message.__slots__
    for name in names:
        value = getattr(message, name)
        if isinstance(value, Message):
            if name != "header":
                inner = brief(value)
                words += [f"{name}: {inner}"] if inner else []
        elif isinstance(value, np.ndarray | list):
            if len(value) > FEW_ITEMS:
                words.append(f"{len(value)} {name}")
            elif len(value):
                words.append(f"{name} {_few([*value], str(len(value)))}")
        elif value not in ("", False):
            words.append(f"{name} {_words(value)}")
    return ", ".join(words)[:400]


def place(stage: Stage, x: float, y: float) -> list[Row]:
    """What it holds of x, y [m] in `map`: the cell of the elevation map; node, edges and their prices of the
    planner."""
    if isinstance(stage, ElevationStage):
        return _cell(stage, x, y)
    if isinstance(stage, PlannerStage):
        return _edges(stage, x, y)
    return []


def _cell(stage: ElevationStage, x: float, y: float) -> list[Row]:
    patch = stage.map.window(x, y, stage.map.params.resolution)
    row, col = (round((v - o) / patch.resolution) for v, o in zip((y, x), patch.origin[::-1], strict=True))
    found = {name: float(layer[row, col]) for name, layer in patch.layers.items()}
    rows: list[Row] = [("cell", f"({x:.2f}, {y:.2f}), {patch.resolution:g} m")]
    for name, value in found.items():
        if name == "source":
            rows.append((name, SOURCES[int(value)]))
        elif name == "variance":
            rows.append(
                ("standard deviation", f"{1000 * math.sqrt(value):.1f} mm" if value >= 0 else "unknown")
            )
        elif name == "trusted":
            rows.append((name, "yes" if value else "no"))
        else:
            rows.append((name, "unknown" if math.isnan(value) else f"{value:.3f} m"))
    return rows


def _edges(stage: PlannerStage, x: float, y: float) -> list[Row]:
    terrain = stage.terrain
    graph, grid = terrain.graph, terrain.grid
    if graph is None or grid is None or not len(graph.nodes):
        return [("graph", "none: no ground around the robot is known")]
    node = int(np.hypot(*(graph.nodes[:, :2] - (x, y)).T).argmin())
    nx, ny, nz = graph.nodes[node].tolist()
    rows: list[Row] = [
        (
            "nearest node",
            f"{node} at ({nx:.2f}, {ny:.2f}, {nz:.2f}), {math.hypot(nx - x, ny - y):.2f} m from there"
            + (", a frontier" if graph.frontier[node] else ""),
        )
    ]
    terrain.prepare()
    table = terrain.table
    assert table is not None
    arcs, known, w = table.arcs, table.tables.edge, weights_of(terrain.body)
    for slot in range(int(graph.indptr[node]), int(graph.indptr[node + 1])):
        tx, ty, _ = graph.nodes[graph.indices[slot]].tolist()
        length, risk = float(arcs.length[slot]), float(graph.risk[slot])
        body, unknown = known[slot].tolist()
        crossed = float(arcs.price[slot, 0])
        price = float(cost_of(w, length, risk, body, unknown)) + crossed
        rows.append(
            (
                f"edge to ({tx:.2f}, {ty:.2f})",
                f"price {price:.2f} m: length {length:.2f} m, native risk {risk:.2f}, body {body:.2f}, "
                f"unknown {unknown:.2f}, crossings {crossed:.2f} m",
            )
        )
    return rows


def frontiers(stage: PlannerStage, x: float, y: float) -> list[Row]:
    """Places to look from and what each is worth, for a robot at x, y [m] in `map`."""
    found = views_of(stage.terrain, msg.ExploreQuestion(start_x=x, start_y=y), stage.terrain.body, stage.now)
    if found.refused:
        return [("frontiers", found.refused)]
    rows = [("frontiers", f"{len(found.x)}; {found.seen:.0f} m2 seen, {found.hidden:.0f} m2 hidden")]
    return rows + [
        (f"frontier ({fx:.2f}, {fy:.2f})", f"shows {gain:.1f} m2, the way costs {way:.1f} m")
        for fx, fy, gain, way in zip(
            found.x.tolist(), found.y.tolist(), found.gain.tolist(), found.way.tolist(), strict=True
        )
    ]
