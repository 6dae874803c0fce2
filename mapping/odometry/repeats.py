"""A stream that repeats itself is dead, however fresh its stamps: real values have noise, so they repeat by chance
only."""

from __future__ import annotations

from numpy.typing import NDArray

from hal.safety.monitors import Monitor


class Repeats:
    """Counts how often a stream said the same in a row."""

    def __init__(self, row: Monitor, name: str = "") -> None:
        """`row` says how often it may; `name` fills its words."""
        self._row, self._name = row, name
        self._last = b""
        self._count = 0
        self.words = ""
        """What the operator reads while the stream is dead; else empty."""

    def dead(self, payload: NDArray) -> bool:
        """Whether the stream is, now that it says `payload`. An empty one says nothing: all of them are alike."""
        now = payload.tobytes()
        self._count = self._count + 1 if now and now == self._last else 0
        self._last = now
        self.words = self._row.tell(name=self._name) if self._row.outside(self._count) else ""
        return bool(self.words)
