"""Where a mission is: a step, and the rounds of the loops around it."""

from __future__ import annotations

from collections.abc import Sequence

from rbtrg_robot.msg import MissionLoop

FOR_EVER = 0


class Cursor:
    """Walks over steps 1 .. `count`. Loops lie inside each other or apart."""

    def __init__(
        self, count: int, loops: Sequence[MissionLoop], at: int = 1, rounds: Sequence[int] = ()
    ) -> None:
        """`at`: the present step; `rounds` done of each loop, none by default."""
        self._count = count
        self._loops = loops
        self.at = at
        self.rounds = [int(r) for r in rounds] or [0] * len(loops)

    def advance(self) -> tuple[int, int] | None:
        """To the next step, back to the first one of a loop where it has rounds left.

        Returns the first and last step that lie ahead anew, or None at the end of the mission.
        """
        ending = [k for k, loop in enumerate(self._loops) if loop.last == self.at]
        for k in sorted(ending, key=lambda k: (-self._loops[k].first, -k)):  # the inner ones first
            loop = self._loops[k]
            self.rounds[k] += 1
            if loop.times == FOR_EVER or self.rounds[k] < loop.times:
                self.at = loop.first
                return loop.first, loop.last
            self.rounds[k] = 0
        if self.at >= self._count:
            return None
        self.at += 1
        return self.at, self.at


def nested(loops: Sequence[MissionLoop]) -> bool:
    """Whether all loops are nested or apart. Of two loops with the same steps the later one is the inner one."""
    return not any(
        a.first < b.first <= a.last < b.last or b.first < a.first <= b.last < a.last
        for k, a in enumerate(loops)
        for b in loops[k + 1 :]
    )
