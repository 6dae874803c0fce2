"""The corrected way of every scan, and the elevation map along it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator

import numpy as np

from hal.rotation import quaternion, rotation_rpy, wrap
from hal.types import Array
from mapping.closing.graph import after, between, levelled
from mapping.closing.keyframes import Keyframe
from mapping.closing.recording import Recording, Scan
from mapping.elevation.config import ElevationConfig
from mapping.elevation.map import ElevationMap

CLEAN_EVERY = 3
"""Scans from one look along the rays to the next, as the stack has it."""
RUN_GAP = 1800 * 10**9
"""Two runs [ns], whatever their clocks say: what a map knows from an hour ago gives way sooner."""


def corrected(scans: list[Scan], keyframes: list[Keyframe], nodes: Array) -> Array:
    """(n, 4, 4) poses of base_link in `map`: between two keyframes as odometry has it from each, by the way from one to
    the other. nodes (k, 4)."""
    at = np.array([keyframe.scan for keyframe in keyframes])
    along = np.array([keyframe.along for keyframe in keyframes])
    run = np.array([keyframe.run for keyframe in keyframes])
    out = np.empty((len(scans), 4, 4))
    for n, scan in enumerate(scans):
        a = int(np.searchsorted(at, n, side="right")) - 1
        b = a + 1 if a + 1 < len(at) and run[a + 1] == scan.run else a
        ground = levelled(scan.pose, scan.below)
        place = after(nodes[a], between(keyframes[a].place, ground))
        if b != a:
            share = float(np.clip((scan.along - along[a]) / (along[b] - along[a]), 0.0, 1.0))
            other = after(nodes[b], between(keyframes[b].place, ground))
            turn = wrap(other[3] - place[3])
            place = (1.0 - share) * place + share * other
            place[3] = other[3] - (1.0 - share) * turn
        out[n] = scan.pose
        out[n, :3, :3] = rotation_rpy(0.0, 0.0, place[3] - ground[3]) @ scan.pose[:3, :3]
        out[n, :3, 3] = place[0], place[1], place[2] + scan.below
        out[n, 3] = 0.0, 0.0, 0.0, 1.0
    return out


def fuse(
    recording: Recording,
    poses: Array,
    params: ElevationConfig,
    which: Iterable[int] | None = None,
    progress: Callable[[float], None] = lambda _share: None,
) -> ElevationMap:
    """The map of scans (all, or the numbers `which`) whose base_link is at poses (n, 4, 4) in `map`. progress hears the
    share that is done."""
    made = ElevationMap(params)
    numbers = list(range(len(recording.scans)) if which is None else which)
    for k, _ in enumerate(fusing(made, recording, poses, numbers)):
        progress((k + 1) / len(numbers))
    return made


def fusing(made: ElevationMap, recording: Recording, poses: Array, numbers: Iterable[int]) -> Iterator[None]:
    """Scans into a map, one at a time."""
    shift, last = 0, None
    for k, n in enumerate(numbers):
        scan, position = recording.scans[n], poses[n, :3, 3]
        orientation = quaternion(poses[n, :3, :3])
        if last is not None and last.run != scan.run:
            shift += last.stamp + RUN_GAP - scan.stamp
        last, stamp = scan, scan.stamp + shift
        for sensor, points in recording.points(scan):
            made.fuse(points, position, orientation, stamp, sensor)
            if k % CLEAN_EVERY == 0:
                made.clean()
        if k % CLEAN_EVERY == 0:
            made.find_plants()
        made.fuse_ground(scan.contacts, position, orientation, stamp)
        yield
