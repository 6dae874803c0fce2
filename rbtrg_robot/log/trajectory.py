"""The way of a run as a file that others read (TUM, KITTI), and how far it is from another: ATE and RPE.

ATE: root mean square of the positions' distances after the rigid motion that brings the estimate closest to the
reference (Umeyama 1991). RPE: root mean square of the error of the motion between two poses, by distance driven and by
time (Sturm et al., IROS 2012). Pairs follow each other and do not overlap, those by distance along the estimate; the
program evo gives the same figures.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hal.regular import open_regular
from hal.rotation import quaternion, rotation_vectors, rotations
from hal.types import NS, Array
from rbtrg_robot import msg
from rbtrg_robot.log.read import LogError, read_run
from rbtrg_robot.wire.messages import MessageError, decode, stamp_of

SAME_MOMENT = 0.01
"""Two poses no further apart than this [s] are of one moment."""
LARGEST_FILE = 200_000_000
"""Bytes of a trajectory file."""
FORMATS = {".tum": "tum", ".txt": "tum", ".kitti": "kitti"}
"""By the end of a file's name."""


@dataclass(frozen=True, slots=True, eq=False)
class Trajectory:
    """Poses in one frame."""

    stamps: NDArray[np.int64]
    """(n,) [ns]; 0, 1, 2 ... where the file knows none (KITTI)."""
    poses: Array
    """(n, 4, 4)."""
    timed: bool = True

    def at(self, index: NDArray[np.int64]) -> Trajectory:
        """Some of them."""
        return Trajectory(self.stamps[index], self.poses[index], self.timed)

    @property
    def length(self) -> float:
        """[m] along the poses."""
        return float(np.linalg.norm(np.diff(self.poses[:, :3, 3], axis=0), axis=1).sum())


@dataclass(frozen=True, slots=True)
class Comparison:
    """How far an estimate is from a reference; lengths in metres, angles in degrees."""

    pairs: int
    """Poses that both have."""
    length: float
    ate: float
    distance: float
    rpe_distance: float
    rpe_distance_deg: float
    """Over `distance` [m]; NaN where the run is shorter."""
    seconds: float
    frames: int
    """Poses in `seconds`."""
    rpe_time: float
    rpe_time_deg: float


def of_run(log: Path, topic: str = "/odom") -> Trajectory:
    """The poses on a topic of a run: Odometry or PoseStamped. Raises LogError where there is none."""
    stamps, positions, orientations, others = [], [], [], set()
    kinds = (msg.Odometry.__msgtype__, msg.PoseStamped.__msgtype__)
    for entry in read_run(log):
        if entry.type in kinds and entry.topic != topic:
            others.add(entry.topic)
        if entry.topic != topic or entry.type not in kinds:
            continue
        try:
            message = decode(entry.data, entry.type)
        except MessageError:
            continue
        pose = message.pose.pose if entry.type == kinds[0] else message.pose
        p, q = pose.position, pose.orientation
        stamps.append(stamp_of(message) or entry.publish_time)
        positions.append((p.x, p.y, p.z))
        orientations.append((q.x, q.y, q.z, q.w))
    if not stamps:
        lead = (
            f"; poses are on {', '.join(sorted(others))}: --topic"
            if others
            else f": `rbtrg-robot replay {log} --rerun odometry --out NEW.mcap` makes some"
        )
        raise LogError(f"{log} holds no poses on {topic}{lead}")
    return of_poses(np.array(stamps, np.int64), np.array(positions), np.array(orientations), f"{log}")


def of_poses(stamps: NDArray[np.int64], positions: Array, orientations: Array, name: str) -> Trajectory:
    """From stamps (n,) [ns], positions (n, 3) [m] and quaternions (n, 4) x, y, z, w. Raises LogError, which begins with
    `name`."""
    norm = np.linalg.norm(orientations, axis=1)
    if not (np.isfinite(positions).all() and np.isfinite(norm).all() and (norm > 0.5).all()):
        raise LogError(f"{name} holds poses that are none: not finite, or without an orientation")
    poses = np.tile(np.eye(4), (len(stamps), 1, 1))
    poses[:, :3, :3], poses[:, :3, 3] = rotations(orientations / norm[:, None]), positions
    return Trajectory(stamps, poses)


def format_of(path: Path, told: str = "") -> str:
    """`tum` or `kitti`. Raises LogError."""
    found = told or FORMATS.get(path.suffix.lower(), "")
    if found not in FORMATS.values():
        raise LogError(f"{path.name}: name it .tum or .kitti, or say --format tum or kitti")
    return found


def write(trajectory: Trajectory, path: Path, told: str = "") -> None:
    """As a file: TUM `seconds x y z qx qy qz qw`, KITTI the upper three rows of each pose. Raises LogError."""
    lines = []
    if format_of(path, told) == "tum":
        for stamp, pose in zip(trajectory.stamps.tolist(), trajectory.poses, strict=True):
            values = [*pose[:3, 3], *quaternion(pose[:3, :3])]
            lines.append(f"{stamp // NS}.{stamp % NS:09d} " + " ".join(f"{v:.9f}" for v in values))
    else:
        lines = [" ".join(f"{v:.9e}" for v in pose[:3].reshape(-1)) for pose in trajectory.poses]
    try:
        path.write_text("\n".join(lines) + "\n")
    except OSError as error:
        raise LogError(f"cannot write {path}: {error.strerror}") from error


def read(path: Path) -> Trajectory:
    """A TUM or KITTI file, told by its columns. Raises LogError."""
    try:
        with open_regular(path) as file:
            text = file.read(LARGEST_FILE).decode(errors="replace")
    except OSError as error:
        raise LogError(f"cannot read {path}: {error.strerror}") from error
    rows = [
        line.replace(",", " ").split()
        for line in text.splitlines()
        if line.strip() and line.strip()[0] != "#"
    ]
    widths = {len(row) for row in rows}
    try:
        if widths == {8}:
            stamps = np.array([_nanoseconds(row[0]) for row in rows], np.int64)
            values = np.array([row[1:] for row in rows], np.float64)
            order = np.argsort(stamps, kind="stable")
            return of_poses(stamps[order], values[order, :3], values[order, 3:], str(path))
        if widths == {12}:
            poses = np.tile(np.eye(4), (len(rows), 1, 1))
            poses[:, :3] = np.array(rows, np.float64).reshape(-1, 3, 4)
            if not np.isfinite(poses).all():
                raise ValueError("a number is none")
            return Trajectory(np.arange(len(rows), dtype=np.int64), poses, timed=False)
    except ValueError as error:
        raise LogError(f"{path} is no trajectory: {error}") from error
    raise LogError(
        f"{path} is no trajectory: TUM has 8 columns and KITTI 12, this has {sorted(widths) or 'no line'}"
    )


def _nanoseconds(text: str) -> int:
    """Of seconds in plain decimals: a float would lose the last digits."""
    whole, _, part = text.partition(".")
    if part.isdigit() and whole.isdigit():
        return int(whole) * NS + int(part[:9].ljust(9, "0"))
    return round(float(text) * NS)


def compare(
    estimate: Trajectory, reference: Trajectory, distance: float = 1.0, seconds: float = 1.0
) -> Comparison:
    """`distance` [m] and `seconds` between the poses of a pair of RPE. Raises LogError where the two have nothing in
    common."""
    first, second = _associate(estimate, reference)
    if len(first) < 3:
        raise LogError(
            f"the two trajectories have {len(first)} moments in common (within {1000 * SAME_MOMENT:.0f} ms): "
            "are their clocks the same?"
        )
    own, other = estimate.at(first), reference.at(second)
    p, q = own.poses, other.poses
    moved = _aligned(p[:, :3, 3], q[:, :3, 3])
    ate = float(np.sqrt(((moved - q[:, :3, 3]) ** 2).sum(axis=1).mean()))
    period = float(np.median(np.diff(own.stamps))) / NS if own.timed else 0.1
    frames = max(1, round(seconds / period)) if period > 0 else 1
    by_time = np.arange(0, len(p), frames)
    by_distance = _along(p, distance)
    along, along_deg = _relative(p, q, by_distance)
    timely, timely_deg = _relative(p, q, by_time)
    return Comparison(
        len(p), other.length, ate, distance, along, along_deg, seconds, frames, timely, timely_deg
    )


def _associate(a: Trajectory, b: Trajectory) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Indices of poses of one moment. The shorter trajectory asks, each of its poses takes the nearest of the other."""
    if not (a.timed and b.timed):
        if len(a.stamps) != len(b.stamps):
            raise LogError(
                f"a KITTI file has no times: both must have as many poses, these have {len(a.stamps)} and "
                f"{len(b.stamps)}"
            )
        same = np.arange(len(a.stamps))
        return same, same
    swap = len(b.stamps) > len(a.stamps)
    short, long = (a, b) if swap else (b, a)
    right = np.clip(np.searchsorted(long.stamps, short.stamps), 1, max(len(long.stamps) - 1, 1))
    right = np.minimum(right, len(long.stamps) - 1)
    left = np.maximum(right - 1, 0)
    nearer = np.abs(long.stamps[left] - short.stamps) <= np.abs(long.stamps[right] - short.stamps)
    best = np.where(nearer, left, right)
    together = np.abs(long.stamps[best] - short.stamps) <= SAME_MOMENT * NS
    asked, found = np.flatnonzero(together), best[together]
    return (asked, found) if swap else (found, asked)


def _aligned(x: Array, y: Array) -> Array:
    """Points x (n, 3) moved rigidly so that they come closest to y (n, 3)."""
    cx, cy = x.mean(axis=0), y.mean(axis=0)
    u, _, vt = np.linalg.svd((y - cy).T @ (x - cx))
    flip = np.diag([1.0, 1.0, math.copysign(1.0, np.linalg.det(u @ vt))])
    return (x - cx) @ (u @ flip @ vt).T + cy


def _along(poses: Array, distance: float) -> NDArray[np.int64]:
    """Poses that lie `distance` [m] or a little more apart, along the way."""
    found, driven = [0], 0.0
    for k, step in enumerate(np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1), 1):
        driven += float(step)
        if driven >= distance:
            found.append(k)
            driven = 0.0
    return np.array(found)


def _relative(p: Array, q: Array, at: NDArray[np.int64]) -> tuple[float, float]:
    """RPE over neighbours of `at`: [m], [deg]; NaN without any."""
    if len(at) < 2:
        return math.nan, math.nan
    own = np.linalg.inv(p[at[:-1]]) @ p[at[1:]]
    other = np.linalg.inv(q[at[:-1]]) @ q[at[1:]]
    error = np.linalg.inv(other) @ own
    moved = (error[:, :3, 3] ** 2).sum(axis=1)
    turned = (rotation_vectors(np.ascontiguousarray(error[:, :3, :3])) ** 2).sum(axis=1)
    return math.sqrt(float(moved.mean())), math.degrees(math.sqrt(float(turned.mean())))
