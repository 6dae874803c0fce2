"""What a fault is to this bench, and what came of one."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from hal.safety.monitors import Monitor


@dataclass(frozen=True, slots=True)
class Outcome:
    """One injection, judged by the simulator's truth."""

    moved: float = 0.0
    """Way of base_link after the fault [m]."""
    rest: float = 0.0
    """From the fault until the robot stands for good [s]; infinite where it does not; 0 where it stood."""
    words: str = ""
    """All that the operator could read since the fault: causes, holds, reasons, joined by newlines."""
    error: float = 0.0
    """Largest true error of the pose [m] while the stack called it `good`, or at a goal called `reached`."""
    fell: bool = False


@dataclass(frozen=True, slots=True)
class Fault:
    """One row of the bench. A module of this folder lists its own in `FAULTS`."""

    name: str
    monitors: tuple[Monitor, ...]
    """Those that catch it; without them the row must miss a limit. None where no check catches it, but the way in which
    an input is used."""
    sizes: tuple[float, ...]
    """Two sizes or more, in the unit that `inject` takes."""
    inject: Callable[[float, int], Outcome]
    """`inject(size, seed)`: bring the stack up, drive, inject, watch, tear down."""
    rest: float | None = None
    """At rest within [s] after the fault; None where it asks for no stop."""
    error: float = math.inf
    """Largest error [m] that may be called `good` or `reached`."""
    says: tuple[str, ...] = ()
    """Words that the operator must have read, each in at least one line."""

    def missed(self, outcome: Outcome) -> str:
        """What `outcome` misses, in words; empty where it holds."""
        out = ["fell"] if outcome.fell else []
        if self.rest is not None and not outcome.rest <= self.rest:
            out.append(f"at rest after {outcome.rest:.2f} s, asked {self.rest:.2f} s")
        if not outcome.error <= self.error:
            out.append(f"called good at {outcome.error:.2f} m, asked {self.error:.2f} m")
        out += [f"nobody said {word!r}" for word in self.says if word not in outcome.words]
        return "; ".join(out)
