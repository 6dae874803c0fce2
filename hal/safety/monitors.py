"""Every check of an input, one row each: what is watched, what is allowed, what happens beyond, what the operator reads.

The code that judges asks the row (`outside`, `tell`) and spells no limit and no sentence of its own, as topics are spelt in one table.
`status`, the console's health page, `docs/safety.md` and `tools.bench faults` read it. A limit that an operator may set stands in the
configuration, and the row names its field.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from enum import StrEnum
from functools import cache
from string import Formatter


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


@cache
def _pattern(words: str) -> re.Pattern[str]:
    """What `words` look like once they are filled."""
    return re.compile(
        "".join(
            re.escape(text) + (".+?" if field is not None else "")
            for text, field, *_ in Formatter().parse(words)
        )
    )


def raised(text: str) -> list[Monitor]:
    """The monitors whose words stand in `text`: causes, holds and reasons travel as words, for people and logs alike."""
    return [monitor for monitor in MONITORS if _pattern(monitor.words).search(text)]


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
LIDAR_REPEATS = Monitor(
    "lidar_repeats",
    "LiDAR",
    Check.REPEAT,
    Consequence.LOST,
    "odometry",
    "the {name} LiDAR repeats its sweep: its stamps go on, its points do not",
    "power the LiDAR off and on, or restart its driver",
    high=1,
    unit="sweeps in a row; a sound one never repeats, its noise does not",
    test="mapping/odometry/test_inputs_that_lie.py",
)
IMU_REPEATS = Monitor(
    "imu_repeats",
    "IMU",
    Check.REPEAT,
    Consequence.LOST,
    "odometry",
    "the IMU repeats its sample: its stamps go on, its values do not",
    "restart the robot; drive it by hand to a safe place with care",
    high=4,
    unit="samples in a row; at most 2 where a driver tells each sample more than once",
    test="mapping/odometry/test_inputs_that_lie.py",
)
JOINTS_REPEAT = Monitor(
    "joints_repeat",
    "joints",
    Check.REPEAT,
    Consequence.DEGRADE,
    "odometry",
    "the joints repeat their sample: their stamps go on, their values do not",
    "restart the robot",
    high=4,
    unit="samples in a row",
    test="mapping/odometry/test_inputs_that_lie.py",
)
IMPOSSIBLE_SPEED = Monitor(
    "impossible_speed",
    "odometry",
    Check.RANGE,
    Consequence.LOST,
    "odometry",
    "the pose moves at {speed:.1f} m/s, faster than the robot drives: accelerometer or wheels tell what cannot be",
    "let the robot stand; if it comes again, restart the stack and look at the IMU",
    high=4.0,
    unit="m/s; the fastest of our robots drives 2.5",
    test="mapping/odometry/test_inputs_that_lie.py",
)
SCANS_DISAGREE = Monitor(
    "scans_disagree",
    "LiDAR",
    Check.AGREEMENT,
    Consequence.DEGRADE,
    "odometry",
    "over {seconds:.0f} s the scans lead {moved:.2f} m and {turned:.0f} deg from where wheels and gyro do: the wheels slip, or what the LiDAR shows is not where the robot is",
    "look whether the wheels spin; if not, restart the stack",
    high=1.0,
    unit="of 0.4 m or 6 deg over a second",
    against="wheels, IMU",
    test="mapping/odometry/test_inputs_that_lie.py",
)
MOVED_WHILE_STILL = Monitor(
    "moved_while_still",
    "LiDAR",
    Check.AGREEMENT,
    Consequence.DEGRADE,
    "odometry",
    "wheels and gyro stand still, the scans moved by {moved:.2f} m and {turned:.0f} deg: is the robot carried, or its floor moving?",
    "put the robot on firm ground; people who walk past are not taken for it",
    high=10,
    unit="scans in a row",
    against="wheels, IMU",
    test="mapping/odometry/test_inputs_that_lie.py",
)

# -- map, contact, what the robot feels -----------------------------------------------------------------------------------

# -- commands and who gives them ------------------------------------------------------------------------------------------

# -- goals ----------------------------------------------------------------------------------------------------------------
PLACE_UNSURE = Monitor(
    "place_unsure",
    "odometry",
    Check.AGREEMENT,
    Consequence.TELL,
    "navigator",
    "the robot's place is known within {place:.2f} m (two standard deviations), the goal asks for {asked:.2f} m",
    "drive where the LiDAR sees walls or posts, or set the pose; or ask for less: navigator.goal_tolerance",
    setting="navigator.goal_tolerance",
    against="the goal's tolerance",
    test="rbtrg_robot/stages/navigation/test_navigator.py",
)


MONITORS: tuple[Monitor, ...] = tuple(v for v in dict(globals()).values() if isinstance(v, Monitor))
BY_NAME: dict[str, Monitor] = {monitor.name: monitor for monitor in MONITORS}
