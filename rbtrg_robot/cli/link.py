"""A command's connection to the running stack."""

from __future__ import annotations

from rbtrg_robot.bus import Bus
from rbtrg_robot.runfiles import read_state


def connect(robot: str) -> Bus:
    """Open the bus of a robot. Raises NotRunning, BusError."""
    state = read_state(robot)
    return Bus(state["endpoint"], "cli", int(state["domain"]))
