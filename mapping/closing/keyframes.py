"""Keyframes of the graph: every few metres one, with what was seen around it as a map to be searched and as a submap to
be searched for."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from hal.rotation import quaternion, rotation_rpy
from hal.types import Array
from mapping.closing.graph import between, levelled
from mapping.closing.recording import Recording, Scan
from mapping.elevation.config import ElevationConfig
from mapping.elevation.map import ElevationMap
from mapping.relocalise import PriorMap, Submap
from mapping.thin_cloud import ThinCloud

KEYFRAME_SPACING = 4.0
"""Between keyframes, along the way [m]."""
MAP_REACH, MAP_STRIDE = 8.0, 1.0
"""The map of a keyframe is made of scans up to so far away along the way, so far apart [m]."""
SUBMAP_SCANS = (-3.0, 3.0, 0.0)
"""Scans of a keyframe's submap, along the way from it [m]; the last one is the keyframe."""
SUBMAP_VOXEL = 0.15
"""Of a submap [m]: with the relocaliser's 0.1 m a comparison takes twice as long."""
KEPT_MAPS = 24
"""Maps that are kept in memory, 20 MB each: keyframes that are compared lie near each other."""
T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Keyframe:
    """One node of the graph."""

    scan: int
    """In the recording."""
    run: int
    along: float
    """Driven since the start of its run [m]."""
    place: Array
    """(4,) of the ground under the robot in the `odom` of its run: x, y, z [m], yaw [rad]."""


def keyframes_of(scans: list[Scan], newest: list[Keyframe]) -> list[Keyframe]:
    """Every `KEYFRAME_SPACING` along each run, and its first scan; of the scans after the `newest` one that is
    known."""
    out = list(newest)
    for n in range(newest[-1].scan if newest else 0, len(scans)):
        scan = scans[n]
        if not out or out[-1].run != scan.run or scan.along - out[-1].along >= KEYFRAME_SPACING:
            out.append(Keyframe(n, scan.run, scan.along, levelled(scan.pose, scan.below)))
    return out[len(newest) :]


class Surroundings:
    """Maps and submaps of keyframes, made when they are asked for; the newest ones are kept."""

    def __init__(self, recording: Recording, params: ElevationConfig) -> None:
        self._recording = recording
        self._params = params
        self._maps: OrderedDict[int, PriorMap | None] = OrderedDict()
        self._submaps: OrderedDict[int, Submap] = OrderedDict()

    def map(self, keyframe: Keyframe) -> PriorMap | None:
        """What was seen around a keyframe, in the frame of the ground under it, x ahead. None where no ground was
        seen."""
        if keyframe.scan not in self._maps:
            keep(self._maps, keyframe.scan, self._build(keyframe))
        self._maps.move_to_end(keyframe.scan)
        return self._maps[keyframe.scan]

    def submap(self, keyframe: Keyframe) -> Submap:
        """What was seen from a keyframe and a little before and after it, in the same frame."""
        if keyframe.scan not in self._submaps:
            keep(self._submaps, keyframe.scan, self._look(keyframe))
        self._submaps.move_to_end(keyframe.scan)
        return self._submaps[keyframe.scan]

    def _build(self, keyframe: Keyframe) -> PriorMap | None:
        made, cloud = ElevationMap(self._params), ThinCloud()
        for n in self._near(keyframe, np.arange(-MAP_REACH, MAP_REACH + 1e-6, MAP_STRIDE)):
            scan = self._recording.scans[n]
            pose = seen_from(keyframe.place, scan.pose)
            for sensor, points in self._recording.points(scan):
                made.fuse(points, pose[:3, 3], quaternion(pose[:3, :3]), scan.stamp, sensor)
                made.clean()
                cloud.add(points, pose[:3, :3], pose[:3, 3])
        if not len(made.store.keys) or not len(cloud):
            return None
        return PriorMap(cloud.points, [made.grid()])

    def _look(self, keyframe: Keyframe) -> Submap:
        submap = Submap(SUBMAP_VOXEL)
        for n in self._near(keyframe, np.array(SUBMAP_SCANS)):
            scan = self._recording.scans[n]
            pose = seen_from(keyframe.place, scan.pose)
            submap.stand()
            for sensor, points in self._recording.points(scan):
                submap.add(points, pose[:3, 3], quaternion(pose[:3, :3]), sensor.origin, scan.below)
        return submap

    def _near(self, keyframe: Keyframe, away: Array) -> list[int]:
        """Scans of the keyframe's run at so many metres from it, each once, in the order of `away`."""
        scans = self._recording.scans
        own = np.array([n for n, scan in enumerate(scans) if scan.run == keyframe.run])
        along = np.array([scans[n].along for n in own])
        at = np.searchsorted(along, keyframe.along + away).clip(max=len(own) - 1)
        far = np.abs(along[at] - keyframe.along - away) < 2.0 * MAP_STRIDE
        chosen = [int(n) for n in own[at[far]]]
        if away[-1] == 0.0:
            chosen[-1] = keyframe.scan  # the robot may have stood there: any of these scans is as far along
        return list(dict.fromkeys(reversed(chosen)))[::-1]


def keep(kept: OrderedDict[int, T], key: int, value: T) -> None:
    """Put it to those that are kept; the oldest one goes."""
    kept[key] = value
    if len(kept) > KEPT_MAPS:
        kept.popitem(last=False)


def seen_from(place: Array, pose: Array) -> Array:
    """(4, 4) a pose in the frame of a place (4,): x, y, z [m], yaw [rad]."""
    out = np.eye(4)
    out[:3, :3] = rotation_rpy(0.0, 0.0, -place[3]) @ pose[:3, :3]
    out[:3, 3] = between(place, levelled(pose))[:3]
    return out
