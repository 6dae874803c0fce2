"""One camera of a robot: mount, intrinsics, frames. A pinhole without distortion; the optical frame as in REP 103.

Frames come as JPEG, as robots and network cameras send them: nothing on the way to a page or a log decodes one.
"""

from __future__ import annotations

import io
import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from PIL.Image import Image

from hal.errors import OperatorError
from hal.rotation import rotation_rpy
from hal.types import Array, Extrinsics

OPTICAL_AXES = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""Axes of the optical frame (x right, y down, z ahead) in the axes of the mount (x ahead, y left, z up), as columns."""


class CameraError(OperatorError):
    """A camera gives no frames; the message tells what to do. It may come back."""

    retry = True


@dataclass(frozen=True, slots=True)
class MountedCamera:
    """Where a camera looks from, and how."""

    name: str
    mount: Extrinsics
    """Of the mount in base_link: x ahead along the view, z up."""
    width: int
    height: int
    """[pixels]"""
    fov: float
    """Horizontal field of view [rad]."""
    rate: float
    """Most frames a second [Hz]."""

    @property
    def focal(self) -> float:
        """[pixels], both axes."""
        return 0.5 * self.width / math.tan(0.5 * self.fov)

    @property
    def matrix(self) -> Array:
        """(3, 3) intrinsic matrix K."""
        return np.array(
            [[self.focal, 0.0, 0.5 * self.width], [0.0, self.focal, 0.5 * self.height], [0.0, 0.0, 1.0]]
        )

    @property
    def vertical_fov(self) -> float:
        """[rad]"""
        return 2.0 * math.atan(0.5 * self.height / self.focal)

    @property
    def rotation(self) -> Array:
        """(3, 3) base_link <- optical frame."""
        return rotation_rpy(*self.mount.rpy) @ OPTICAL_AXES


@dataclass(frozen=True, slots=True)
class CameraFrame:
    """One picture."""

    stamp: int
    """Of the exposure [ns, source clock]."""
    jpeg: bytes


def encode(picture: Image) -> bytes:
    """As JPEG: 9 kB at 320 x 240."""
    out = io.BytesIO()
    picture.save(out, "JPEG", quality=75)
    return out.getvalue()


class CameraSource(Protocol):
    """Who gives frames. One thread; `open` before the first frame."""

    camera: MountedCamera

    def open(self) -> str:
        """Reach the camera; says in a few words by what the frames come. Raises CameraError. Bounded in time."""

    def frame(self, now: int) -> CameraFrame | None:
        """A frame that is newer than the last one, asked for at `now` [ns, source clock]; None: there is none yet.

        Raises CameraError.
        """

    def close(self) -> None:
        """Release everything. Idempotent."""
