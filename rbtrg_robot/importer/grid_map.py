"""Elevation maps in bags of others: grid_map_msgs/GridMap of ROS 1 and 2."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from mapping.grid import ElevationGrid
from rbtrg_robot import msg
from rbtrg_robot.importer.bag import Bag
from rbtrg_robot.log.read import LogError

LAYER = "elevation"
MOST_CELLS = 50_000_000
"""Cells."""


def grid_in(bag: Path, topic: str = "", layer: str = LAYER) -> ElevationGrid:
    """The newest GridMap of a bag, in its own frame. `topic` may be empty where there is one alone. Raises LogError."""
    recording = Bag(bag)
    topics = sorted({s.topic for s in recording.sources if s.type == msg.GridMap.__msgtype__})
    if not topics:
        raise LogError(f"{bag} holds no {msg.GridMap.__msgtype__}")
    if not topic and len(topics) > 1:
        raise LogError(f"{bag} holds several maps: say --topic {' or '.join(topics)}")
    if topic and topic not in topics:
        raise LogError(f"{bag} holds no {msg.GridMap.__msgtype__} on {topic}; it does on {', '.join(topics)}")
    newest = None
    for source, _, _, data in recording.messages({topic or topics[0]}):
        newest = source, data
    if newest is None:
        raise LogError(f"{bag} holds no message on {topic or topics[0]}")
    source, data = newest
    try:
        store = get_typestore(Stores.EMPTY)
        store.register(get_types_from_msg(source.schema.data.decode(), source.type))  # type: ignore[union-attr]
        message = store.deserialize_cdr(data, source.type)
    except Exception as error:
        raise LogError(f"the map on {source.topic} of {bag} cannot be read: {error}") from error
    return _grid(message, layer, f"the map on {source.topic} of {bag}")


def _grid(message: Any, layer: str, name: str) -> ElevationGrid:
    """grid_map counts cells from the +x, +y corner, column by column, from where its ring buffer begins. Raises
    LogError."""
    info, turn = message.info, message.info.pose.orientation
    if layer not in message.layers:
        raise LogError(f"{name} has no layer {layer}: say --layer {' or '.join(message.layers)}")
    if abs(turn.x) + abs(turn.y) + abs(turn.z) > 1e-6:
        raise LogError(f"{name} is turned in its frame: rotate it to the axes before")
    part = message.data[message.layers.index(layer)]
    cells = [d.size for d in part.layout.dim]
    labels = [d.label for d in part.layout.dim]
    if len(cells) != 2 or not 0 < cells[0] * cells[1] <= MOST_CELLS or part.data.size != cells[0] * cells[1]:
        raise LogError(f"{name}: layer {layer} is no array of {' x '.join(map(str, cells))} cells")
    along = np.asarray(part.data, np.float32).reshape(cells)
    if labels[0] == "row_index":  # stored row by row
        along = along.T
    along = np.roll(along, (-int(message.inner_start_index), -int(message.outer_start_index)), axis=(0, 1))
    height = np.ascontiguousarray(along[::-1, ::-1])
    rows, cols = height.shape
    cell, place = float(info.resolution), info.pose.position
    if not (np.isfinite([cell, place.x, place.y]).all() and cell > 0.0):
        raise LogError(f"{name} has cells of {cell} m at ({place.x}, {place.y})")
    origin = place.x - (cols - 1) * cell / 2, place.y - (rows - 1) * cell / 2
    return ElevationGrid(height, np.isfinite(height), origin, cell)
