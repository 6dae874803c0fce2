"""Stamps of a clock that is not ours: find the offset, keep it steady, notice when it jumps."""

from __future__ import annotations

from collections import deque

from hal.types import NS


class ClockOffset:
    """Offset from a remote clock to the host clock: the smallest receive-minus-stamp of the last seconds.

    A message is never received before it was stamped, so the smallest difference is the offset plus the shortest
    delay; jitter of network and polling only adds. The robot's clock may start in 1970 and be set later: a
    difference that is more than `jump` away for several messages in a row starts anew.
    """

    def __init__(self, window: float = 10.0, jump: float = 1.0, patience: int = 3) -> None:
        """window [s] that is remembered; jump [s]; patience: messages."""
        self._bucket = round(window * NS / 10)
        self._jump = round(jump * NS)
        self._patience = patience
        self._strange = 0
        self._buckets: deque[tuple[int, int]] = deque(maxlen=10)
        self.jumps = 0
        """How often the remote clock was reset."""

    @property
    def offset(self) -> int | None:
        """Add to a remote stamp to get host time [ns]; None before the first message."""
        return min(value for _, value in self._buckets) if self._buckets else None

    def observe(self, stamp: int, received: int) -> None:
        """Take a remote stamp and its receive time [ns]."""
        difference = received - stamp
        offset = self.offset
        if offset is not None and abs(difference - offset) > self._jump:
            self._strange += 1
            if self._strange < self._patience:
                return
            self._buckets.clear()
            self.jumps += 1
        self._strange = 0
        slot = received // self._bucket
        if self._buckets and self._buckets[-1][0] == slot:
            self._buckets[-1] = (slot, min(self._buckets[-1][1], difference))
        else:
            self._buckets.append((slot, difference))

    def convert(self, stamp: int, received: int) -> int:
        """The stamp on the host clock [ns], never after `received`; `received` where the offset does not fit."""
        offset = self.offset
        if offset is None or abs(received - stamp - offset) > self._jump:
            return received
        return min(stamp + offset, received)
