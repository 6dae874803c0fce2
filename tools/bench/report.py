"""The report of a benchmark: rows with a value, its limit and a baseline measured in the same run."""

from __future__ import annotations

import json
import math
import os
import platform
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

from rbtrg_robot.provenance import commit


@dataclass(frozen=True, slots=True)
class Row:
    """One figure. `at_least` turns the limit from a ceiling into a floor."""

    key: str
    value: float
    unit: str
    limit: float | None = None
    baseline: float | None = None
    at_least: bool = False
    trials: int | None = None
    """Of a rate: how many trials."""
    bound: float | None = None
    """Of a rate: what it keeps at 80 % confidence, on the side of its limit."""

    @property
    def ok(self) -> bool:
        """True when the value keeps its limit; NaN never does."""
        if self.limit is None:
            return True
        return self.value >= self.limit if self.at_least else self.value <= self.limit


@dataclass(slots=True)
class Report:
    """The result of one benchmark."""

    bench: str
    rows: list[Row] = field(default_factory=list)

    def add(
        self,
        key: str,
        value: float,
        unit: str,
        limit: float | None = None,
        baseline: float | None = None,
        at_least: bool = False,
    ) -> None:
        """Append one row."""
        self.rows.append(Row(key, float(value), unit, limit, baseline, at_least))

    def rate(
        self, key: str, hits: int, trials: int, limit: float | None = None, at_least: bool = True
    ) -> None:
        """Append a rate with its number of trials and its bound at 80 % confidence; NaN without trials."""
        value = hits / trials if trials else math.nan
        bound = least_rate(hits, trials) if at_least else 1.0 - least_rate(trials - hits, trials)
        self.rows.append(Row(key, value, "rate", limit, None, at_least, trials, bound))

    @property
    def ok(self) -> bool:
        """True when every row keeps its limit."""
        return all(row.ok for row in self.rows)

    def to_json(self) -> str:
        """`{"bench", "machine", "rows": [{"key", "value", "unit", "limit", "at_least", "baseline"}]}`; NaN and infinity
        become null."""
        rows = [
            {
                "key": r.key,
                "value": r.value if math.isfinite(r.value) else None,
                "unit": r.unit,
                "limit": r.limit,
                "at_least": r.at_least,
                "baseline": r.baseline,
                **({} if r.trials is None else {"trials": r.trials, "bound_80": r.bound}),
            }
            for r in self.rows
        ]
        return json.dumps({"bench": self.bench, "machine": machine(), "rows": rows}, indent=1)

    def record(self, file: Path, command: str) -> None:
        """Write the rows with title, command, date, commit and machine. Title and note of a file that is there stay."""
        past = json.loads(file.read_text()) if file.exists() else {}
        told = {
            "bench": self.bench,
            "title": past.get("title", self.bench),
            "command": command,
            "date": datetime.now(UTC).date().isoformat(),
            "commit": commit(),
            "machine": machine(),
            "note": past.get("note", ""),
            "rows": json.loads(self.to_json())["rows"],
        }
        file.write_text(json.dumps(told, indent=1) + "\n")

    def to_text(self) -> str:
        """A table for people; a row that misses its limit is marked."""
        lines = [f"{self.bench} on {machine()}"]
        for r in self.rows:
            sign = ">=" if r.at_least else "<="
            limit = "" if r.limit is None else f"  ({sign} {r.limit:g})"
            base = "" if r.baseline is None else f"  baseline {r.baseline:.4g}"
            if r.trials is not None:
                base = f"  of {r.trials}, {sign} {r.bound:.3f} at 80 %"
            flag = "" if r.ok else "  MISSED"
            lines.append(f"  {r.key:40s} {r.value:12.5g} {r.unit}{limit}{base}{flag}")
        return "\n".join(lines)


def least_rate(hits: int, trials: int, confidence: float = 0.8) -> float:
    """One-sided Clopper-Pearson lower bound of a rate: below it, `hits` or more of `trials` have a chance of 1 -
    `confidence` at most."""
    if hits == 0:
        return 0.0
    low, high = 0.0, 1.0
    for _ in range(60):
        p = 0.5 * (low + high)
        chance = sum(math.comb(trials, k) * p**k * (1.0 - p) ** (trials - k) for k in range(hits, trials + 1))
        low, high = (p, high) if chance < 1.0 - confidence else (low, p)
    return low


def machine() -> str:
    """Processor count and architecture, Python version."""
    return f"{os.cpu_count()} cores, {platform.machine()}, Python {platform.python_version()}"
