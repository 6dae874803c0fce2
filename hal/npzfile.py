"""The one reader of .npz and .npy files from somebody else: what an array takes is known, and allowed, before anything
is unpacked.

`numpy.load` unpacks what an archive says, up to a thousand times its size, and its parser of headers raises whatever it
trips over.
"""

from __future__ import annotations

import math
import os
import zipfile
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from hal.regular import open_regular

MAX_MEMBERS = 1000
"""Arrays of one file; maps and graphs have some twenty."""
MAX_HEADER = 10_000
"""Bytes of the description of one array; ours have 128."""
KINDS = "biufU"
"""Kinds of numbers and texts that are read: no objects, which would run code, no records."""
GIGABYTE = 1_000_000_000
PACKED = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
"""How a member may be packed. The other ways take memory that the size of the member does not tell."""


class DamagedFile(ValueError):
    """It is no readable file of arrays, or larger than allowed; the message says what is wrong, without the file's
    name."""


def read_npz(path: Path | str, most: float = GIGABYTE, only: Collection[str] = ()) -> dict[str, NDArray[Any]]:
    """The arrays of a .npz file by name, or those of them that are named in `only`.

    most: bytes that all arrays of the file may take together. Raises OSError, and DamagedFile for everything else.
    """
    with open_regular(path) as file, _told("npz"), zipfile.ZipFile(file) as archive:
        return _arrays(archive, most, only)


def read_npy(path: Path | str, most: float = GIGABYTE) -> NDArray[Any]:
    """The array of a .npy file of `most` bytes. Raises OSError, and DamagedFile for everything else."""
    with open_regular(path) as file, _told("npy"):
        size = os.fstat(file.fileno()).st_size
        _check_size(size, most)
        return _array(file, size, "the array")


def check_packed(member: zipfile.ZipInfo) -> None:
    """Raises DamagedFile: it is packed in a way that is not read."""
    if member.compress_type not in PACKED:
        raise DamagedFile(
            f"{member.filename[:40]}: packed by method {member.compress_type}: pack it as plain zip"
        )


@contextmanager
def _told(kind: str) -> Iterator[None]:
    """Whatever zip, zlib and numpy trip over is a damaged file."""
    try:
        yield
    except (DamagedFile, OSError):
        raise
    except Exception as error:
        raise DamagedFile(" ".join(f"broken or truncated .{kind} file ({error})".split())[:200]) from error


def _check_size(size: int, most: float) -> None:
    if size > most:
        raise DamagedFile(
            f"{size / GIGABYTE:.1f} GB of arrays, more than {most / GIGABYTE:g}: cut it or use a coarser resolution"
        )


def _arrays(archive: zipfile.ZipFile, most: float, only: Collection[str]) -> dict[str, NDArray[Any]]:
    members = archive.infolist()
    if len(members) > MAX_MEMBERS:
        raise DamagedFile(f"{len(members)} arrays, more than {MAX_MEMBERS}")
    _check_size(sum(member.file_size for member in members), most)
    out: dict[str, NDArray[Any]] = {}
    for member in members:
        name = member.filename.removesuffix(".npy")
        if only and name not in only:
            continue
        check_packed(member)
        with archive.open(member) as stream:
            out[name] = _array(stream, member.file_size, name)
    return out


def _array(stream: IO[bytes], size: int, name: str) -> NDArray[Any]:
    """One array of `size` bytes with its header."""
    version = npy.read_magic(stream)
    if version not in ((1, 0), (2, 0)):
        raise DamagedFile(f"{name[:40]}: version {version} of the format is not read")
    reader = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
    shape, by_columns, dtype = reader(stream, max_header_size=MAX_HEADER)
    if dtype.kind not in KINDS or dtype.names or dtype.subdtype:
        raise DamagedFile(f"{name[:40]}: holds {dtype}, which is neither numbers nor text")
    count = math.prod(shape)
    taken = count * dtype.itemsize
    if any(n < 0 for n in shape) or not 0 <= taken <= size:
        raise DamagedFile(f"{name[:40]}: {shape} of {dtype} do not fit into its {size} bytes")
    data = stream.read(taken)
    if len(data) < taken or stream.read(1):
        raise DamagedFile(f"{name[:40]}: holds other than {shape} of {dtype}")
    array = np.frombuffer(bytearray(data), dtype, count) if count else np.empty(0, dtype)
    return array.reshape(shape, order="F" if by_columns else "C")
