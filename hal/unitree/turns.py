"""Whether one robot speaks, or two by turns. Pure; times in ns."""

from __future__ import annotations

import numpy as np

from hal.types import NS

Speaker = tuple[int, bytes]
"""Publisher on the network, and the serial number that it tells, as it comes."""
FLOOR_TIME = NS // 2
"""[ns] of silence after which a publisher has given up the floor: one that was restarted is another one then."""
LASTS = NS
"""[ns] two count as two after the last time that they took turns."""


class Turns:
    """Publishers of one topic. A restarted publisher never speaks through its old self again; two robots do."""

    def __init__(self) -> None:
        self._speaker: Speaker | None = None
        self._spoke = 0
        self._others: dict[Speaker, int] = {}
        self._turned: int | None = None

    def counts(self, who: Speaker, now: int) -> bool:
        """Whether a message of `who` counts: one has the floor until it falls silent."""
        if who != self._speaker and self._speaker is not None and 0 <= now - self._spoke < FLOOR_TIME:
            self._others[who] = now
            return False
        if who == self._speaker and any(self._spoke <= at for at in self._others.values()):
            self._turned = now
        elif who != self._speaker:
            self._others.pop(who, None)
        self._speaker, self._spoke = who, now
        return True

    def several(self, now: int) -> list[Speaker]:
        """All who speak by turns; empty where one does."""
        if self._turned is None or not 0 <= now - self._turned < LASTS:
            return []
        assert self._speaker is not None
        return [self._speaker, *(who for who, at in self._others.items() if now - at < LASTS)]

    def words(self, now: int) -> str:
        """The robots whose LowState comes by turns; empty where one speaks."""
        found = [np.frombuffer(serial, "<u4") for _, serial in self.several(now)]
        serials = ["-".join(str(part) for part in serial) for serial in found]
        return f"LowState of serial numbers {' and '.join(sorted(serials))}" if serials else ""
