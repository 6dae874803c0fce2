"""Arbitration of motion: one source at a time has it, the one with the highest priority that speaks.

A source is silent once its timeout has passed. Each has one owner: whoever spoke first keeps it while he speaks. A source that
took the motion from a lower one keeps it until `release`, though it falls silent: a robot that was driven by hand goes on
by itself only when told to. The emergency stop stands above all sources; it is the gate's.
"""

from __future__ import annotations

from dataclasses import dataclass

from hal.types import NS


@dataclass(frozen=True, slots=True)
class Source:
    """One row: whoever asks for motion."""

    name: str
    priority: int
    """The higher has the say."""
    timeout: float
    """[s] of silence after which it has let go."""


TRACKER = Source("tracker", 0, 0.2)
TELEOP = Source("teleop", 1, 0.2)


@dataclass(slots=True)
class _Voice:
    owner: str
    at: int


class CommandMux:
    """Call `take` for every command. Times in ns of the source clock."""

    def __init__(self, *sources: Source) -> None:
        self._sources = sorted(sources, key=lambda source: -source.priority)
        self._voices: dict[Source, _Voice] = {}
        self._held: Source | None = None

    def take(self, source: Source, owner: str, now: int) -> str:
        """Why a command of `owner` through `source` does not count; empty where it does. `owner`: any name that is his own."""
        voice = self._voices.get(source)
        if voice is not None and voice.owner != owner and self._speaks(source, now):
            return f"another {source.name} has the say"
        self._voices[source] = _Voice(owner, now)
        if self._held is None or self._held.priority < source.priority:
            lower = [other for other in self._sources if other.priority < source.priority]
            self._held = source if lower else self._held
        above = next(
            (s for s in self._sources if s.priority > source.priority and self._speaks(s, now)), None
        )
        if above is not None:
            return f"{above.name} has the say"
        return f"{self._held.name} took the motion" if self._held not in (None, source) else ""

    def taken(self, now: int) -> tuple[str, bool]:
        """The source that took the motion from the lower ones, empty when none did; and whether it still speaks."""
        return ("", False) if self._held is None else (self._held.name, self._speaks(self._held, now))

    def hold(self, source: Source) -> None:
        """`source` took the motion before this process began."""
        self._held = source

    def release(self, now: int) -> bool:
        """Give the motion back to the lower sources; False while the one that took it still speaks."""
        if self._held is not None and self._speaks(self._held, now):
            return False
        self._held = None
        return True

    def _speaks(self, source: Source, now: int) -> bool:
        voice = self._voices.get(source)
        return voice is not None and abs(now - voice.at) / NS < source.timeout
