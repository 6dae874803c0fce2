"""Every check of an input, one row each: what is watched, what is allowed, what happens beyond, what the operator reads.

The code that judges asks the row (`outside`, `tell`) and spells no limit and no sentence of its own, as topics are spelt in one table.
`status`, the console's health page, `docs/safety.md` and `tools.bench faults` read it. A limit that an operator may set stands in the
configuration, and the row names its field.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from enum import StrEnum


class Check(StrEnum):
    """What a monitor compares."""

    RANGE = "range"
    """A value with what is possible or usual, in its unit."""
    AGE = "age"
    """A stamp with the clock."""
    CLOCK = "clock"
    """A remote clock with ours: drift, delay, steps."""
    REPEAT = "repeat"
    """A payload with the ones before: a stream that repeats itself is dead."""
    AGREEMENT = "agreement"
    """A stream with another that must tell the same."""
    OWNER = "owner"
    """A publisher with the one that a topic belongs to."""
    CONTACT = "contact"
    """A force or a held wheel with what the map explains."""


class Consequence(StrEnum):
    """What happens, from the mildest on."""

    TELL = "tell"
    """`status` says it; nothing else changes."""
    DEGRADE = "degrade"
    """The input is not used; localisation is `degraded`."""
    HOLD = "hold"
    """Zero velocity while it lasts."""
    LATCH = "latch"
    """Zero velocity until `resume`."""
    LOST = "lost"
    """The pose is not known: zero velocity, the goal ends."""
    REFUSE = "refuse"
    """The message, file or start is refused."""


@dataclass(frozen=True, slots=True)
class Monitor:
    """One row."""

    name: str
    """Unique; `tools.bench faults --without NAME` takes it out."""
    stream: str
    """What is watched, as operators call it."""
    check: Check
    consequence: Consequence
    judge: str
    """The process that judges."""
    words: str
    """What the operator reads; a format string that is filled by `tell`."""
    remedy: str
    """What the operator does about it."""
    low: float = -math.inf
    high: float = math.inf
    """Allowed from `low` to `high`, in `unit`; infinite where a setting or another row decides."""
    unit: str = ""
    setting: str = ""
    """The field of the configuration that holds the limit, such as `gate.sensor_timeout.imu`."""
    against: str = ""
    """The stream that it is compared with."""
    test: str = ""
    """The test that was seen to fail without it, below `tests/`."""

    def outside(self, value: float, low: float | None = None, high: float | None = None) -> bool:
        """Whether `value` is beyond what is allowed; what is no number is. `low`, `high`: limits from the configuration.

        Never where the monitor was taken out, see `taken_out`.
        """
        if self.name in _OUT:
            return False
        low, high = self.low if low is None else low, self.high if high is None else high
        return not low <= value <= high

    @property
    def active(self) -> bool:
        """False only where a bench took it out: for checks that `outside` cannot express."""
        return self.name not in _OUT

    def tell(self, **values: object) -> str:
        """The operator's words, with what was found."""
        return self.words.format(**values)


_OUT: set[str] = set()
"""Monitors that a bench took out, to show that its rows fail without them. No configuration reaches this."""


@contextmanager
def taken_out(*names: str) -> Iterator[None]:
    """Without these monitors, in this process. For `tools.bench faults --without` and its tests. Raises KeyError for an unknown name."""
    for name in names:
        BY_NAME[name]
    _OUT.update(names)
    try:
        yield
    finally:
        _OUT.difference_update(names)


# One block per area, in the order in which data flows. Rows are constants, so that the judge names its row.

# -- clocks and streams of the robot ------------------------------------------------------------------------------------

# -- localisation -------------------------------------------------------------------------------------------------------

# -- map, contact, what the robot feels -----------------------------------------------------------------------------------
HOLE_WIDTH = Monitor(
    name="width of a hole",
    stream="elevation map",
    check=Check.RANGE,
    consequence=Consequence.HOLD,
    judge="elevation",
    words="a hole that is too wide to cross",
    remedy="drive around it, or lay something over it",
    setting="graph.max_gap",
    against="rims on both sides",
    test="mapping/elevation/test_holes.py",
)
OWN_PARTS = Monitor(
    name="own parts",
    stream="LiDAR sweeps",
    check=Check.REPEAT,
    consequence=Consequence.TELL,
    judge="odometry",
    words="the LiDAR sees something that moves with the robot, and it is in its way everywhere: own_parts: [{parts}]",
    remedy="check that nothing hangs there; `rbtrg-robot calibrate lidar` writes own_parts for the configuration",
    setting="own_parts",
    against="odometry",
    test="mapping/odometry/test_own.py",
)

# -- commands and who gives them ------------------------------------------------------------------------------------------

# -- goals ----------------------------------------------------------------------------------------------------------------

MONITORS: tuple[Monitor, ...] = tuple(v for v in dict(globals()).values() if isinstance(v, Monitor))
BY_NAME: dict[str, Monitor] = {monitor.name: monitor for monitor in MONITORS}
