"""A stream that repeats itself is dead, however fresh its stamps: real values have noise, so they repeat by chance
only."""

from __future__ import annotations

from numpy.typing import NDArray

from hal.safety.monitors import Monitor

KEPT_PAYLOADS = 512
"""Payloads that are remembered: a driver may play its buffer again. Two and a half seconds of an IMU."""


class Repeats:
    """Counts how often in a row a stream said what it had said, each time equally long before."""

    def __init__(self, row: Monitor, name: str = "", memory: int = KEPT_PAYLOADS) -> None:
        """`row` says how often it may; `name` fills its words. `memory`: how many payloads back it looks."""
        self._row, self._name, self._memory = row, name, memory
        self._known: dict[int, int] = {}
        """Number of the newest payload by its hash, oldest first."""
        self._heard = self._back = self._count = 0
        self.words = ""
        """What the operator reads while the stream is dead; else empty."""

    def dead(self, payload: NDArray) -> bool:
        """Whether the stream is, now that it says `payload`. An empty one says nothing: all of them are alike."""
        self._heard += 1
        now = hash(payload.tobytes())
        before = self._known.pop(now, None) if payload.size else None
        back = 0 if before is None else self._heard - before
        if payload.size:
            self._known[now] = self._heard
            if len(self._known) > self._memory:
                del self._known[next(iter(self._known))]
        self._count = self._count + 1 if back and back == self._back else int(back > 0)
        self._back = back
        self.words = self.told if self._row.outside(self._count) else ""
        return bool(self.words)

    @property
    def told(self) -> str:
        """What the operator reads of a repetition."""
        return self._row.tell(name=self._name)

    @property
    def again(self) -> bool:
        """Whether the newest payload is an old one."""
        return self._row.active and self._count > 0
