"""What a restarted elevation process takes over from its predecessor, how long it waits, and when it gives up."""

from __future__ import annotations

from mapping.elevation.map import ElevationMap
from rbtrg_robot import msg
from rbtrg_robot.wire.convert import map_patch

RESTORE_PATIENCE = 3_000_000_000
"""A planner that says something this long after the request, or after the last part of its copy of the map, has no
more of it [ns]."""
SILENT_PLANNER = 35_000_000_000
"""Longest wait for one that says nothing [ns]: it may search all that time, and the supervisor ends it after 30 s."""
MOST_EPOCHS = 2**31
"""No restarted map goes on from a higher one: readers drop what is older, and the wire has 32 bits for it."""


def possible(status: msg.MapStatus) -> bool:
    """Whether the process before can have said this."""
    return status.epoch <= MOST_EPOCHS


class Handover:
    """Takes parts of the planner's copy of the map, and tells whether it is whole or lost.

    Nothing may be mapped meanwhile. It begins no map: after a loss the stage begins anew. Times in ns of the source
    clock."""

    def __init__(self, elevation: ElevationMap) -> None:
        self._map = elevation
        self.under_way = False
        self._asked = 0
        """When the wait for the copy, or for its next part, began."""
        self._came: set[int] = set()
        """Parts that have come."""

    def take(self, part: msg.MapPart, now: int) -> str:
        """One part. Returns what to tell of the whole once it has come. Raises LayoutError, MapError."""
        self._map.expect(part.parts)
        self._map.restore(map_patch(part.map, self._map.epoch))
        self._came.add(part.part)
        self._asked = now
        if len(self._came) < part.parts:
            return ""
        self.under_way, self._asked = False, 0
        return f"restarted; {self._map.store.counts()[1]} cells came back from the planner"

    def spoken(self, stamp: int) -> bool:
        """The planner said something else: whether it has no more of the map."""
        return bool(self._asked) and stamp - self._asked > RESTORE_PATIENCE

    def overdue(self, now: int) -> bool:
        """Whether the planner is not waited for any longer."""
        if not self.under_way:
            return False
        self._asked = self._asked or now
        return now - self._asked > SILENT_PLANNER

    def give_up(self) -> str:
        """Nobody has the map of before. Returns what to tell."""
        self.under_way, self._asked = False, 0
        lost = "a part of the map" if self._came else "the map"
        return f"restarted; {lost} of before is lost: the planner did not answer"
