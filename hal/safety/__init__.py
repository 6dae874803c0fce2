"""The safety gate in front of every robot, its geofence and the tilt it watches."""

from hal.safety.gate import SafetyGate
from hal.safety.gate_types import GateConfig, GateInputs, GateStatus, Refusal, RefusalReason, StopCause
from hal.safety.geofence import Geofence, GeofenceError
from hal.safety.tilt import TiltFilter

__all__ = [
    "GateConfig",
    "GateInputs",
    "GateStatus",
    "Geofence",
    "GeofenceError",
    "Refusal",
    "RefusalReason",
    "SafetyGate",
    "StopCause",
    "TiltFilter",
]
