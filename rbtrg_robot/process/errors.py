"""Errors an operator can mend. Their text says how; commands print it as one line and exit non-zero."""

from __future__ import annotations

from pydantic import ValidationError

from hal.contract import BackendError
from hal.locomotion.torchfile import PolicyError
from hal.safety.geofence import GeofenceError
from hal.scenes import SceneError
from mapping.elevation.exchange import MapError
from rbtrg_robot.config import ConfigError, explain
from rbtrg_robot.log.file import LogError
from rbtrg_robot.process.runfiles import AlreadyRunning, NotRunning
from rbtrg_robot.process.zygote import ZygoteError
from rbtrg_robot.wire.bus import BusError

OPERATOR_ERRORS: tuple[type[Exception], ...] = (
    AlreadyRunning,
    NotRunning,
    BackendError,
    BusError,
    ConfigError,
    GeofenceError,
    LogError,
    MapError,
    PolicyError,
    SceneError,
    ValidationError,
    ZygoteError,
)


def describe(error: BaseException) -> str:
    """One line for an operator."""
    if isinstance(error, ValidationError):
        return explain(error)
    lines = str(error).strip().splitlines()
    return lines[0] if lines else type(error).__name__
