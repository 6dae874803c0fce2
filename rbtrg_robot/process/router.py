"""The router of a stack: brought along, or one that is there already."""

from __future__ import annotations

from typing import Any

from hal.errors import OperatorError
from rbtrg_robot.config import StackConfig
from rbtrg_robot.process.runfiles import RobotTaken
from rbtrg_robot.processes import SUPERVISOR
from rbtrg_robot.wire.bus import Bus, BusError


def open_bus(config: StackConfig, **ours: Any) -> Bus:
    """The supervisor's, alone on it. Raises BusError, RobotTaken."""
    join = config.network.join
    try:
        bus = Bus(config.endpoint, SUPERVISOR, config.scope, router=not join, **ours)
    except BusError as error:
        if not join:
            raise
        raise BusError(
            f"nothing listens on {config.endpoint}: start its router first, or leave network.join out"
        ) from error
    try:
        if bus.second(SUPERVISOR):
            raise RobotTaken(
                f"a stack of robot {config.robot!r} is on the router at {config.endpoint} already (domain "
                f"{config.domain}): "
                "end that one, or give this one another --robot"
            )
        if bus.second("replay"):
            raise RobotTaken(
                f"a log is played on the router at {config.endpoint} (robot {config.robot!r}, domain "
                f"{config.domain}): end that first"
            )
    except OperatorError:
        bus.close()
        raise
    return bus
