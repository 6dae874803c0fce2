"""Trials of a bench in a file, a JSON line each: a bench that was ended goes on where it was."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

Record = dict[str, Any]


class Records:
    """What stands in the file `out` is not done again; without a file nothing is kept."""

    def __init__(self, out: Path | None) -> None:
        self._out = out
        lines = out.read_text().splitlines() if out is not None and out.is_file() else []
        self.done: dict[str, Record] = {r["key"]: r for r in map(json.loads, lines)}
        """By key."""

    def add(self, record: Record) -> None:
        """Keep a record; its `key` is the trial's."""
        self.done[record["key"]] = record
        if self._out is not None:
            with self._out.open("a") as file:
                file.write(f"{json.dumps(record)}\n")

    def get(self, key: str, trial: Callable[[], Record]) -> Record:
        """The record of a trial, which is done now where none stands in the file."""
        if key not in self.done:
            self.add({"key": key, **trial()})
        return self.done[key]


def numbers(text: str) -> list[int]:
    """`0-3,7` -> 0, 1, 2, 3, 7."""
    out: list[int] = []
    for part in text.split(","):
        first, _, last = part.partition("-")
        out += range(int(first), int(last or first) + 1)
    return out
