"""Tiles on disk: those far from the robot leave memory, and come back when somebody reads or writes them."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Key = tuple[int, int]
"""Row and column of a tile."""


class Shelf:
    """Tiles of one size in one file of a folder. The file has no name, so it disappears when the process ends.

    Without a folder nothing is put away: everything stays in memory."""

    def __init__(self, folder: Path | None = None) -> None:
        self.trouble = ""
        """Why no more tiles can be put away; words for the operator."""
        self._folder = folder
        self._file: int | None = None
        self._places: dict[Key, int] = {}
        self._free: list[int] = []
        self._end = 0

    @property
    def open(self) -> bool:
        """Whether tiles can be put away."""
        return self._folder is not None and not self.trouble

    @property
    def keys(self) -> list[Key]:
        """The tiles on the disk."""
        return list(self._places)

    @property
    def nbytes(self) -> int:
        """Size of the file [bytes]."""
        return self._end

    def __len__(self) -> int:
        return len(self._places)

    def __contains__(self, key: Key) -> bool:
        return key in self._places

    def put(self, key: Key, tile: NDArray) -> bool:
        """Write a tile, all of one size. Returns False if the disk does not take it; the caller keeps the tile, and
        `trouble` says why."""
        data = np.ascontiguousarray(tile).tobytes()
        place = self._free[-1] if self._free else self._end
        try:
            if self._file is None:
                assert self._folder is not None
                # the number lives as long as this object: a file object would be closed in an order of its own
                with tempfile.TemporaryFile(dir=self._folder) as file:
                    self._file = os.dup(file.fileno())
            done = os.pwrite(self._file, data, place)
            if done != len(data):
                raise OSError(f"only {done} of {len(data)} bytes were written")
        except OSError as error:
            self.trouble = (
                f"tiles of the map cannot be put on the disk, all stay in memory: {error.strerror or error}"
            )
            return False
        if self._free:
            self._free.pop()
        else:
            self._end += len(data)
        self._places[key] = place
        return True

    def get(self, key: Key, out: NDArray) -> None:
        """Read a tile into a contiguous array of its size; it stays on the disk. If it cannot be read it is lost, and
        `out` stays as it is."""
        try:
            assert self._file is not None
            got = os.preadv(self._file, [out.view(np.uint8).data], self._places[key])
            if got != out.nbytes:
                raise OSError(f"only {got} of {out.nbytes} bytes were read")
        except OSError as error:
            self.trouble = f"a tile of the map was lost on the disk: {error.strerror or error}"

    def take(self, key: Key, out: NDArray) -> None:
        """Read a tile, and free its place."""
        self.get(key, out)
        self._free.append(self._places.pop(key))

    def clear(self) -> None:
        """Forget every tile."""
        self._places.clear()
        self._free.clear()
        self._end = 0
        if self._file is not None:
            os.ftruncate(self._file, 0)

    def __del__(self) -> None:
        if self._file is not None:
            os.close(self._file)
