"""Keys that drive: which are held now, as a terminal tells it. Pure; times in s of a clock that never goes back.

A terminal repeats a held key and does not tell when it is released, so a key counts for a while after each repeat.
The first repeat of a keyboard comes late (0.25 to 0.5 s). So a key that came once counts that long, and a repeating
key counts shorter."""

from __future__ import annotations

FIRST_HOLD, REPEATED_HOLD = 0.6, 0.15
"""[s] a key counts after it came once, and after it came again."""
KEYS: dict[str, tuple[float, float]] = {
    "w": (1.0, 0.0),
    "s": (-1.0, 0.0),
    "a": (0.0, 1.0),
    "d": (0.0, -1.0),
    "\x1b[A": (1.0, 0.0),
    "\x1b[B": (-1.0, 0.0),
    "\x1b[D": (0.0, 1.0),
    "\x1b[C": (0.0, -1.0),
}
"""Forward and to the left, as shares."""
STOP_KEYS, RESUME, QUIT = (" ", "\x1b"), "r", ("q", "\x03")
FASTER, SLOWER = "+", "-"


class HeldKeys:
    """Which of `KEYS` are held."""

    def __init__(self) -> None:
        self._until: dict[str, float] = {}
        self._came: dict[str, float] = {}

    def press(self, key: str, now: float) -> None:
        """A key came from the terminal."""
        again = now - self._came.get(key, -1.0) < FIRST_HOLD
        self._came[key] = now
        self._until[key] = now + (REPEATED_HOLD if again else FIRST_HOLD)

    def clear(self) -> None:
        """Nothing is held."""
        self._until.clear()

    def want(self, now: float) -> tuple[float, float] | None:
        """Shares forward and to the left, -1 to 1; None while nothing is held."""
        held = [KEYS[key] for key, until in self._until.items() if now < until]
        if not held:
            return None
        forward, left = (max(-1.0, min(1.0, sum(x))) for x in zip(*held, strict=True))
        return forward, left
