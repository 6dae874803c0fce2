"""Point clouds and meshes from files, plain: PLY, PCD, STL, OBJ. Only positions and faces are kept."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hal.regular import open_regular
from hal.scenes.scene import Geometry, SceneError

_PLY_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2",
    "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4",
    "double": "f8", "float64": "f8",
}  # fmt: skip
_PCD_TYPES = {"F": "f", "I": "i", "U": "u"}


def read_geometry(path: Path) -> Geometry:
    """Read by file ending. Raises SceneError for a format or a content that cannot be read."""
    reader = {".ply": _ply, ".pcd": _pcd, ".stl": _stl, ".obj": _obj}.get(path.suffix.lower())
    if reader is None:
        raise SceneError(
            f"{path.name}: cannot read {path.suffix or 'a file without ending'}: use .ply, .pcd, .stl or .obj"
        )
    try:
        with open_regular(path) as file:
            data = file.read()
        if data.startswith(b"version https://git-lfs"):
            raise SceneError(f"{path.name} is a Git LFS pointer, not the file: `git lfs pull` fetches it")
        geometry = reader(data)
    except SceneError:
        raise
    except OSError as error:
        raise SceneError(f"{path}: {error.strerror}") from error
    except Exception as error:  # whatever a broken file trips a reader over
        raise SceneError(
            f"{path.name}: broken or truncated {path.suffix[1:].upper()} file ({error})"
        ) from error
    named = geometry.triangles
    if len(named) and (named.min() < 0 or named.max() >= len(geometry.vertices)):
        raise SceneError(f"{path.name}: broken file (a face names a vertex that is not there)")
    return geometry.finite(path.name)


_NO_FACES = np.empty((0, 3), np.int64)


def _count(word: str) -> int:
    """To numpy -1 means all that is there."""
    if not word.isdecimal():
        raise ValueError(f"{word[:20]!r} is no number of things")
    return int(word)


# --- PLY ----------------------------------------------------------------------------------------------------------
@dataclass(slots=True)
class _Element:
    name: str
    count: int
    scalars: list[tuple[str, str]] = field(default_factory=list)
    lists: list[tuple[str, str]] = field(default_factory=list)
    """Count type and item type."""
    order: list[tuple[str, str, str]] = field(default_factory=list)
    """All properties: name, type of a value, type of the count of a list or nothing."""
    first: int = 0
    """Scalars before the first list; 0 without a list."""


def _ply(data: bytes) -> Geometry:
    head, sep, body = data.partition(b"end_header\n")
    if not sep:
        head, sep, body = data.partition(b"end_header\r\n")
    if not data.startswith(b"ply") or not sep:
        raise ValueError("no PLY header")
    layout, elements = "", list[_Element]()
    for words in (line.split() for line in head.decode("ascii", "replace").splitlines()):
        if words[:1] == ["format"]:
            layout = words[1]
        elif words[:1] == ["element"]:
            elements.append(_Element(words[1], _count(words[2])))
        elif words[:2] == ["property", "list"]:
            elements[-1].first = elements[-1].first or len(elements[-1].scalars)
            elements[-1].lists.append((_PLY_TYPES[words[2]], _PLY_TYPES[words[3]]))
            elements[-1].order.append((words[4], _PLY_TYPES[words[3]], _PLY_TYPES[words[2]]))
        elif words[:1] == ["property"]:
            elements[-1].scalars.append((words[2], _PLY_TYPES[words[1]]))
            elements[-1].order.append((words[2], _PLY_TYPES[words[1]], ""))
    if layout not in ("ascii", "binary_little_endian", "binary_big_endian"):
        raise ValueError(f"unknown layout {layout!r}")
    order = ">" if layout == "binary_big_endian" else "<"
    vertices, triangles, lines, at = None, _NO_FACES, body.splitlines() if layout == "ascii" else [], 0
    for element in elements:
        if layout == "ascii":
            rows, lines = lines[: element.count], lines[element.count :]
            if len(rows) < element.count:
                raise ValueError(f"{len(rows)} of {element.count} {element.name} lines")
            if element.name == "vertex":
                column = [name.lower() for name, _ in element.scalars]
                if element.lists and not element.first:
                    raise ValueError("a list before x, y, z of a vertex")
                table = np.array([row.split()[: element.first or None] for row in rows], np.float64)
                vertices = table[:, [column.index(k) for k in "xyz"]]
            elif element.name == "face":
                triangles = _fans([[int(v) for v in row.split()][1:] for row in rows])
        elif not element.lists:
            dtype = np.dtype([(name, order + kind) for name, kind in element.scalars])
            records = np.frombuffer(body, dtype, element.count, at)
            at += dtype.itemsize * element.count
            if element.name == "vertex":
                vertices = _columns(records)
        elif element.name == "vertex":
            vertices, at = _ply_ragged(body, at, element, order)
        elif element.name == "face" and not element.scalars and len(element.lists) == 1:
            triangles, at = _ply_faces(body, at, element, order)
        else:
            break  # nothing after an element of unknown length is needed
    if vertices is None:
        raise ValueError("no vertices")
    return Geometry(vertices, triangles)


def _columns(records: NDArray[np.void]) -> NDArray[np.float64]:
    """(n, 3) of the fields x, y, z, whatever their case."""
    names = {name.lower(): name for name in records.dtype.names or ()}
    return np.stack([records[names[k]] for k in "xyz"], axis=1).astype(np.float64)


def _ply_ragged(body: bytes, at: int, element: _Element, order: str) -> tuple[NDArray[np.float64], int]:
    """Vertices (n, 3) whose records have lists, each of its own length; and where they end."""
    rows = []
    for _ in range(element.count):
        row = {}
        for name, kind, counted in element.order:
            value = np.dtype(order + kind)
            if counted:
                count = np.dtype(order + counted)
                at += count.itemsize + value.itemsize * int(np.frombuffer(body, count, 1, at)[0])
                continue
            row[name.lower()] = float(np.frombuffer(body, value, 1, at)[0])
            at += value.itemsize
        rows.append([row[k] for k in "xyz"])
    return np.array(rows, np.float64).reshape(-1, 3), at


def _ply_faces(body: bytes, at: int, element: _Element, order: str) -> tuple[NDArray[np.int64], int]:
    count_type, item_type = (np.dtype(order + kind) for kind in element.lists[0])
    triangle = np.dtype([("n", count_type), ("v", item_type, (3,))])
    if len(body) - at >= triangle.itemsize * element.count:
        table = np.frombuffer(body, triangle, element.count, at)
        if (table["n"] == 3).all():
            return table["v"].astype(np.int64), at + triangle.itemsize * element.count
    faces = []
    for _ in range(element.count):
        n = int(np.frombuffer(body, count_type, 1, at)[0])
        if n < 3:
            raise ValueError(f"a face of {n} corners")
        at += count_type.itemsize
        faces.append(np.frombuffer(body, item_type, n, at).tolist())
        at += item_type.itemsize * n
    return _fans(faces), at


def _fans(faces: list[list[int]]) -> NDArray[np.int64]:
    """Polygons cut into triangles."""
    cut = [(f[0], f[k], f[k + 1]) for f in faces for k in range(1, len(f) - 1)]
    return np.array(cut, np.int64).reshape(-1, 3)


# --- PCD ----------------------------------------------------------------------------------------------------------
def _pcd(data: bytes) -> Geometry:
    header: dict[str, list[str]] = {}
    at = 0
    while "DATA" not in header:
        end = data.index(b"\n", at)
        words = data[at:end].decode("ascii", "replace").split()
        at = end + 1
        if words and not words[0].startswith("#"):
            header[words[0]] = words[1:]
    fields = header["FIELDS"]
    repeat = [int(n) for n in header.get("COUNT", ["1"] * len(fields))]
    points = _count(header["POINTS"][0])
    layout = header["DATA"][0]
    if layout == "ascii":
        rows = data[at:].split(b"\n")[:points]
        table = np.array([row.split() for row in rows if row.strip()], np.float64)
        if len(table) < points:
            raise ValueError(f"{len(table)} of {points} points")
        first = np.concatenate([[0], np.cumsum(repeat)])
        return Geometry(table[:, [int(first[fields.index(k)]) for k in "xyz"]], _NO_FACES)
    if layout not in ("binary", "binary_compressed"):
        raise ValueError(f"layout {layout}: save it as ascii, binary or binary_compressed")
    kinds = [f"<{_PCD_TYPES[t]}{s}" for t, s in zip(header["TYPE"], header["SIZE"], strict=True)]
    names = [f if fields.index(f) == i else f"_{i}" for i, f in enumerate(fields)]  # padding may repeat "_"
    dtype = np.dtype([(f, k, (n,)) for f, k, n in zip(names, kinds, repeat, strict=True)])
    if layout == "binary_compressed":  # field after field instead of point after point
        packed, size = (int(v) for v in np.frombuffer(data, "<u4", 2, at))
        if size != points * dtype.itemsize:
            raise ValueError(f"{size} bytes for {points} points of {dtype.itemsize}")
        body, columns, start = lzf(data[at + 8 : at + 8 + packed], size), {}, 0
        for name, kind, n in zip(names, kinds, repeat, strict=True):
            width = np.dtype(kind).itemsize * n
            columns[name] = np.frombuffer(body, kind, points * n, start).reshape(points, n)[:, 0]
            start += width * points
        return Geometry(np.stack([columns[k] for k in "xyz"], axis=1).astype(np.float64), _NO_FACES)
    records = np.frombuffer(data, dtype, points, at)
    return Geometry(np.stack([records[k][:, 0] for k in "xyz"], axis=1).astype(np.float64), _NO_FACES)


def lzf(data: bytes, size: int) -> bytes:
    """Unpack LZF to `size` bytes. Raises ValueError. Format: a byte below 32 announces that many bytes and one,
    verbatim; otherwise a copy of 3 to 264 bytes from up to 8 kB before."""
    out, at = bytearray(), 0
    while at < len(data) and len(out) <= size:
        control = data[at]
        at += 1
        if control < 32:
            out += data[at : at + control + 1]
            at += control + 1
            continue
        length = control >> 5
        if length == 7:
            length += data[at]
            at += 1
        back = ((control & 31) << 8 | data[at]) + 1
        at += 1
        length += 2
        start = len(out) - back
        if start < 0:
            raise ValueError("a copy from before the beginning")
        piece = out[start : start + length]
        while len(piece) < length:  # it overlaps what it makes
            piece += piece[: length - len(piece)]
        out += piece
    if len(out) != size:
        raise ValueError(f"{len(out)} bytes where {size} were packed")
    return bytes(out)


# --- meshes -------------------------------------------------------------------------------------------------------
def _stl(data: bytes) -> Geometry:
    count = int(np.frombuffer(data, "<u4", 1, 80)[0]) if len(data) >= 84 else 0
    if len(data) == 84 + 50 * count and count:
        dtype = np.dtype([("normal", "<f4", (3,)), ("corner", "<f4", (3, 3)), ("attribute", "<u2")])
        corners = np.frombuffer(data, dtype, count, 84)["corner"].reshape(-1, 3)
    elif data.lstrip()[:5].lower() == b"solid":
        words = [line.split() for line in data.splitlines()]
        corners = np.array([w[1:4] for w in words if w[:1] == [b"vertex"]], np.float64)
    else:
        raise ValueError(f"{len(data)} bytes do not fit {count} triangles")
    if len(corners) == 0 or len(corners) % 3:
        raise ValueError(f"{len(corners)} corners are no triangles")
    return Geometry(corners.astype(np.float64), np.arange(len(corners)).reshape(-1, 3))


def _obj(data: bytes) -> Geometry:
    vertices: list[list[float]] = []
    faces: list[list[int]] = []
    text = (
        data.decode("utf-8", "replace").replace("\\\r\n", " ").replace("\\\n", " ")
    )  # a line goes on after a backslash
    for line in text.splitlines():
        words = line.split()
        if words[:1] == ["v"]:
            vertices.append([float(v) for v in words[1:4]])
        elif words[:1] == ["f"]:
            index = [int(w.split("/")[0]) for w in words[1:]]
            faces.append([i - 1 if i > 0 else len(vertices) + i for i in index])
    return Geometry(np.array(vertices, np.float64).reshape(-1, 3), _fans(faces))
