"""Cameras: what one is, how its picture falls, and who gives frames."""

from hal.camera.camera import CameraError, CameraFrame, CameraSource, MountedCamera, encode
from hal.camera.config import CameraConfig

__all__ = ["CameraConfig", "CameraError", "CameraFrame", "CameraSource", "MountedCamera", "encode"]
