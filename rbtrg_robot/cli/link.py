"""A command's connection to the running stack."""

from __future__ import annotations

from rbtrg_robot.process.runfiles import read_state
from rbtrg_robot.wire.bus import Bus


def connect(robot: str) -> Bus:
    """Open the bus of a robot. Raises NotRunning, BusError."""
    state = read_state(robot)
    return Bus(state["endpoint"], "cli", int(state["domain"]))
