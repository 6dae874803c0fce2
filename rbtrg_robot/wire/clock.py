"""The source clock of a stack on hardware.

A wall clock is set: by NTP, by hand, by a computer that booted in 1970. No deadline may depend on it. The supervisor
reads the wall clock once, at its start. From there on the source clock of every process is the shared monotonic clock
plus that one offset. Stamps look like wall time, and no stage ever sees a step."""

from __future__ import annotations

import time


class SourceClock:
    """Call it for the time [ns]. It never goes back and never jumps."""

    def __init__(self, offset: int | None = None) -> None:
        """`offset` [ns] of another process of the same stack; None: the wall clock's of now."""
        self.offset = time.time_ns() - time.monotonic_ns() if offset is None else offset

    def __call__(self) -> int:
        return time.monotonic_ns() + self.offset
