"""Numbers of latches: what a `resume` must name, and which stop a latch confirms. The standard library only: `stop`
starts with it.

RobotState.latch rises with every stop that the robot takes, repeats too. A sender gives its stop a name, and the
number that the robot latches with ends in it. So an earlier state, or one of another stop, is no answer to a lost
stop."""

from __future__ import annotations

import secrets

NAME_COUNT = 1 << 24
"""Names of stops are 1 to NAME_COUNT - 1; 0 names none. A latch is at most so much [ns] ahead of the clock."""


def new_name() -> int:
    """Of a stop that is about to be sent."""
    return 1 + secrets.randbelow(NAME_COUNT - 1)


def number(least: int, name: int) -> int:
    """The next number of a latch, `least` or above, that ends in the name of the stop; `least` where it names none."""
    return least + (name - least) % NAME_COUNT if name else least


def confirms(latch: int, name: int) -> bool:
    """A robot that latched with this number has heard the stop of this name."""
    return latch % NAME_COUNT == name
