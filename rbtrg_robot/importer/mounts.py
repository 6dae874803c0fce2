"""Where the sensors of a foreign robot sit: from its tf, its URDF, or what an operator says."""

from __future__ import annotations

import math
from collections.abc import Iterable
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from hal.regular import open_regular
from hal.rotation import rotation, rotation_rpy, rpy_of
from hal.types import Array, Extrinsics
from rbtrg_robot import msg
from rbtrg_robot.config import ConfigError

BASES = ("base_link", "base_footprint", "base", "body", "trunk")
"""Names of the robot's own frame, the best first."""
DEEPEST_TREE = 64
"""Frames between a sensor and the root of a tree."""
LARGEST_URDF = 20_000_000
"""Bytes."""


class Frames:
    """The tree of frames that do not move against each other."""

    def __init__(self) -> None:
        self._parents: dict[str, tuple[str, Array]] = {}
        """Of each frame: its parent, and (4, 4) parent <- frame."""

    def take(self, message: msg.TFMessage) -> None:
        """Transforms of /tf_static."""
        for transform in message.transforms:
            q, p = transform.transform.rotation, transform.transform.translation
            quaternion = np.array([q.x, q.y, q.z, q.w])
            norm = float(np.linalg.norm(quaternion))
            if norm > 0.5 and math.isfinite(norm):
                self._add(
                    transform.child_frame_id,
                    transform.header.frame_id,
                    rotation(quaternion / norm),
                    (p.x, p.y, p.z),
                )

    def take_urdf(self, path: Path) -> None:
        """The joints of a URDF as they stand at zero. Raises ConfigError."""
        try:
            with open_regular(path) as file:
                root = ElementTree.fromstring(file.read(LARGEST_URDF))
            for joint in root.iter("joint"):
                parent, child, origin = joint.find("parent"), joint.find("child"), joint.find("origin")
                if parent is None or child is None:
                    continue
                place = {} if origin is None else origin.attrib
                xyz = [float(v) for v in place.get("xyz", "0 0 0").split()]
                rpy = [float(v) for v in place.get("rpy", "0 0 0").split()]
                self._add(child.attrib["link"], parent.attrib["link"], rotation_rpy(*rpy), xyz)
        except (OSError, ElementTree.ParseError, ValueError, TypeError, KeyError) as error:
            raise ConfigError(f"{path} is no URDF: {error}") from error

    def _add(self, child: str, parent: str, turned: Array, place: Iterable[float]) -> None:
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = turned, list(place)
        self._parents[child.strip("/")] = (parent.strip("/"), pose)

    def mount(self, frame: str) -> Extrinsics | None:
        """A sensor in the robot's own frame; None where the tree does not say."""
        pose = np.eye(4)
        at, seen = frame.strip("/"), {}
        for _ in range(DEEPEST_TREE):
            seen[at] = pose
            if at not in self._parents:
                break
            at, step = self._parents[at]
            pose = step @ pose
        found = next((seen[base] for base in BASES if base in seen), None)
        if found is None and at != frame.strip("/") and at in seen:
            found = seen[at]  # the root is the robot, whatever it is called
        if found is None:
            return None
        x, y, z = found[:3, 3].tolist()
        return Extrinsics((x, y, z), rpy_of(found[:3, :3]))


def parse_mount(text: str) -> Extrinsics:
    """`X,Y,Z,ROLL,PITCH,YAW` [m, deg] in base_link, or `X,Y,Z`. Raises ConfigError."""
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        values = []
    if len(values) not in (3, 6) or not all(map(math.isfinite, values)):
        raise ConfigError(f"a mount is X,Y,Z,ROLL,PITCH,YAW in metres and degrees, got {text!r}")
    x, y, z, *turn = values
    roll, pitch, yaw = map(math.radians, turn or (0.0, 0.0, 0.0))
    return Extrinsics((x, y, z), (roll, pitch, yaw))
