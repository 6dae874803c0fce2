"""Who operates: one page at a time, while it says so every two seconds. Pure; times in s of a clock that never goes
back."""

from __future__ import annotations

LEASE_TIME = 2.0
"""[s] a lease lasts without being renewed."""


class Lease:
    """One holder. Nobody loses it while he renews it, unless somebody takes it over by saying so twice."""

    def __init__(self) -> None:
        self._holder = 0
        self._until = 0.0

    def holder(self, now: float) -> int:
        """Number of the page that operates; 0 while none does."""
        return self._holder if now < self._until else 0

    def take(self, page: int, now: float, *, confirmed: bool = False) -> bool:
        """Take or renew it; with `confirmed` from whoever has it. False where another page has it."""
        if self.holder(now) not in (0, page) and not confirmed:
            return False
        self._holder, self._until = page, now + LEASE_TIME
        return True

    def give_back(self, page: int) -> None:
        """The page was closed."""
        if self._holder == page:
            self._until = 0.0
