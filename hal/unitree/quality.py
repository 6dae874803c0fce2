"""How well a stream of the robot's messages comes through."""

from __future__ import annotations

from hal.types import NS

LONGEST_GAP = 50
"""[ms] of the robot's own clock between two messages: of LowState, a quarter of what counts as no contact."""


class LinkQuality:
    """Rate and gaps of LowState. The gaps go by the robot's clock: a busy computer, which reads late, makes none."""

    def __init__(self) -> None:
        self._count = 0
        self._since: int | None = None
        self._newest = 0
        self._gaps = 0
        self.rate: float | None = None
        """Messages per second over the last whole second; None before one."""
        self._second: tuple[int, int] | None = None
        """When the present second began [ns], and messages since."""

    def heard(self, step: int, now: int) -> None:
        """A new message, `step` [ms, the robot's clock] after the last one; `now` [ns]."""
        if self._since is None:
            self._since = now
        else:
            self._count += 1
        self._newest = now
        begin, count = self._second or (now, 0)
        if now - begin >= NS:
            self.rate, begin, count = count * NS / (now - begin), now, 0
        self._second = begin, count + 1
        self._gaps += LONGEST_GAP < step < 2**31  # further: the robot was restarted

    def figures(self) -> dict[str, float]:
        """Messages per second since the last call (float), and how often they stayed away for more than LONGEST_GAP
        (int)."""
        seconds = 0.0 if self._since is None else (self._newest - self._since) / NS
        rate = self._count / seconds if seconds > 0.0 else 0.0
        self._since, self._count = None if self._since is None else self._newest, 0
        return {"low_state_rate": rate, "low_state_gaps": self._gaps}
