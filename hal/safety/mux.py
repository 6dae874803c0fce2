"""Arbitration of motion: one source at a time has it, the speaking one with the highest priority.

A source is silent once its timeout has passed. Each has one owner per channel (velocity, tilt of the trunk): the
first to speak, while it speaks. Publishers are told apart by topic, so the same hand is another owner on another
channel. A source that took the motion from a lower one keeps it until `release`, even if it falls silent: a robot
that was driven by hand goes on by itself only when told to. The emergency stop stands above all sources; it belongs
to the gate."""

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

    def speaks(self, source: Source, now: int) -> bool:
        return abs(now - self.at) / NS < source.timeout


class CommandMux:
    """Call `take` for every command. Times in ns of the source clock."""

    def __init__(self, *sources: Source) -> None:
        self._sources = sorted(sources, key=lambda source: -source.priority)
        self._voices: dict[tuple[Source, str], _Voice] = {}
        self._held: Source | None = None

    def take(self, source: Source, owner: str, now: int, channel: str = "") -> str:
        """Why a command of `owner` through `source` does not count; empty if it does. `owner`: any name of its own."""
        voice = self._voices.get((source, channel))
        if voice is not None and voice.owner != owner and voice.speaks(source, now):
            return f"another {source.name} has the say"
        self._voices[source, channel] = _Voice(owner, now)
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
        return any(voice.speaks(source, now) for (of, _), voice in self._voices.items() if of == source)
