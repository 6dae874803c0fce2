"""Traversal graphs as npz files: one JSON header and the public arrays."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from hal.npzfile import read_npz
from planning.errors import PlanningError
from planning.graph.params import GraphParams

FILE_FORMAT = 4
"""Version of the layout; `read_graph` refuses others."""
_ARRAYS: dict[str, tuple[type, str, int]] = {
    "nodes": (np.float64, "node", 2),
    "indptr": (np.int64, "row", 1),
    "indices": (np.int32, "edge", 1),
    "risk": (np.float32, "edge", 1),
    "price": (np.float32, "edge", 2),
    "frontier": (np.bool_, "node", 1),
    "turn_price": (np.float32, "node", 2),
    "free_headings": (np.uint64, "node", 1),
    "node_ids": (np.int64, "node", 1),
    "node_revision": (np.int64, "node", 1),
    "edge_revision": (np.int64, "edge", 1),
}
"""dtype, what there is one of, and dimensions."""


def write_graph(path: str | Path, header: dict[str, Any], arrays: dict[str, NDArray[Any]]) -> None:
    """Write header and arrays. The suffix is not changed."""
    with Path(path).open("wb") as file:
        text = json.dumps(header | {"format": FILE_FORMAT})
        np.savez_compressed(
            file, allow_pickle=False, header=np.array(text), **{n: arrays[n] for n in _ARRAYS}
        )


def read_graph(path: str | Path) -> tuple[dict[str, Any], GraphParams, dict[str, NDArray[Any]]]:
    """Header, settings and arrays of a file, checked against each other. Raises PlanningError."""
    try:
        data = read_npz(path)
        header = json.loads(str(data["header"]))
        found = header["format"]
        arrays = {name: data[name] for name in _ARRAYS} if found == FILE_FORMAT else {}
    except FileNotFoundError as error:
        raise PlanningError(f"there is no file {path}") from error
    except (KeyError, TypeError, ValueError, OSError, RecursionError) as error:
        raise PlanningError(f"{path} is not a traversal graph file: {error}") from error
    if found != FILE_FORMAT:
        raise PlanningError(
            f"{path}: graph format {found}, this program reads {FILE_FORMAT}: build the graph again"
        )
    try:
        params = GraphParams(**header["params"])
        _seed, _version = int(header["seed"]), int(header["version"])
        header["start"] = _place(header["start"])
        header["first"] = _place(header["first"])
    except (KeyError, TypeError, ValueError, ValidationError) as error:
        raise PlanningError(f"{path}: the header makes no sense: {error}") from error
    nodes = len(arrays["nodes"])
    count = {"node": nodes, "row": nodes + 1, "edge": len(arrays["indices"])}
    for name, (dtype, of, dimensions) in _ARRAYS.items():
        a = arrays[name]
        if a.dtype != dtype or a.ndim != dimensions or len(a) != count[of]:
            raise PlanningError(f"{path}: the arrays do not fit each other: {name} is {a.dtype} {a.shape}")
    indptr, indices = arrays["indptr"], arrays["indices"]
    if arrays["nodes"].shape[1] != 3 or not np.isfinite(arrays["nodes"]).all():
        raise PlanningError(f"{path}: the arrays do not fit each other: nodes must be finite x, y, z")
    sound = indptr[0] == 0 and indptr[-1] == len(indices) and (np.diff(indptr) >= 0).all()
    if not sound or (len(indices) and not 0 <= indices.min() <= indices.max() < nodes):
        raise PlanningError(f"{path}: the arrays do not fit each other: edges name nodes that are not there")
    return header, params, arrays


def _place(xy: Any) -> tuple[float, float] | None:
    return None if xy is None else (float(xy[0]), float(xy[1]))
