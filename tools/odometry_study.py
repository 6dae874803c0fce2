"""The odometry engines in physics: one recorded drive of the simulated robot, fed to each of them.

    python -m tools.odometry_study [--scene yard] [--lidar xt16] [--goals 6,0]

Where the synthetic runs of `tools.bench perception` have wheels that roll, here they slip, and impacts shake the IMU.
Goals are x, y
[m] ahead and left of the start, separated by `;`; a goal that the robot gives up ends its part of the drive.
"""

from __future__ import annotations

import argparse
import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hal.lidar.config import only
from hal.types import NS, Array, Extrinsics, Sample
from rbtrg_robot import topics as t
from rbtrg_robot.config import StackConfig, load
from rbtrg_robot.hosts.lockstep import Lockstep
from rbtrg_robot.topics import Topic
from rbtrg_robot.wire.convert import imu_sample, joint_sample, lidar_scan, xyz, xyzw, yaw_of
from rbtrg_robot.wire.messages import decode, stamp_of
from tools.bench.perception.odometry import drive, errors

ENGINES = ("kiss_icp", "small_gicp")
GOAL_TIMEOUT = 40.0
"""For one goal [s]."""


@dataclass(frozen=True, slots=True, eq=False)
class RecordedDrive:
    """What the sensors said, in order of arrival, and the truth."""

    extrinsics: Extrinsics
    recorded: list[Sample]
    stamps: NDArray[np.int64]
    """(n,) of the truth [ns]."""
    position: Array
    """(n, 3) [m]."""
    orientation: Array
    """(n, 4) x, y, z, w, neighbours in one hemisphere."""

    def samples(self) -> Iterator[Sample]:
        """As they arrived."""
        yield from self.recorded

    def truth(self, stamps: NDArray[np.integer] | int) -> tuple[Array, Array]:
        """Position (n, 3) [m] and orientation (n, 4) of base_link at `stamps` [ns], linear between the recorded
        ones."""
        at = np.atleast_1d(np.asarray(stamps, np.int64))
        place, turned = (
            np.stack([np.interp(at, self.stamps, column) for column in values.T], axis=1)
            for values in (self.position, self.orientation)
        )
        return place, turned / np.linalg.norm(turned, axis=1, keepdims=True)

    def path_length(self) -> float:
        """Planar distance driven [m]."""
        return float(np.hypot(*np.diff(self.position[:, :2], axis=0).T).sum())


def record(config: StackConfig, goals: list[tuple[float, float]]) -> RecordedDrive:
    """Drive to the goals in lockstep."""
    samples: list[Sample] = []
    truth: list[tuple[int, Array, Array]] = []

    def hear(topic: Topic, payload: bytes, now: int) -> None:
        if topic is t.IMU:
            samples.append(imu_sample(decode(payload, topic.kind)))
        elif topic is t.JOINTS:
            samples.append(joint_sample(decode(payload, topic.kind)))
        elif topic is t.POINTS:
            samples.append(lidar_scan(decode(payload, topic.kind)))
        elif topic is t.TRUTH:
            message = decode(payload, topic.kind)
            pose = message.pose.pose
            truth.append((stamp_of(message), xyz(pose.position), xyzw(pose.orientation)))

    with Lockstep(config) as stack:
        stack.host.listen(hear)
        stack.wait_ready()
        pose = stack.newest[t.TRUTH].pose.pose
        x, y, yaw = pose.position.x, pose.position.y, yaw_of(pose.orientation)
        c, s = math.cos(yaw), math.sin(yaw)
        for ahead, left in goals:
            stack.send_goal(x + c * ahead - s * left, y + s * ahead + c * left)
            status = stack.finish_goal(GOAL_TIMEOUT)
            print(f"goal {ahead:g}, {left:g}: {status.state} {status.reason}")
    stamps, position, orientation = (np.array(values) for values in zip(*truth, strict=True))
    flips = np.cumprod(np.where(np.einsum("ij,ij->i", orientation[1:], orientation[:-1]) < 0.0, -1.0, 1.0))
    orientation[1:] *= flips[:, None]
    return RecordedDrive(config.mounted_lidars()[0].mount, samples, stamps, position, orientation)


def main() -> None:
    """Record, replay, print one line per engine."""
    parser = argparse.ArgumentParser(prog="python -m tools.odometry_study")
    parser.add_argument("--scene", default="yard")
    parser.add_argument("--lidar", default="xt16")
    parser.add_argument("--goals", default="6,0")
    options = parser.parse_args()
    goals = [(float(a), float(b)) for a, b in (goal.split(",") for goal in options.goals.split(";"))]
    run = record(load(None, [], scene=options.scene, lidars=only(options.lidar)), goals)
    seconds = (run.recorded[-1].stamp - run.recorded[0].stamp) / NS
    print(f"{options.scene}, {options.lidar}: {run.path_length():.1f} m in {seconds:.0f} s")
    for name, track in drive(run, ENGINES).items():
        e = errors(run, track)
        health = ", ".join(f"{count} {state}" for state, count in Counter(track.health).most_common())
        print(
            f"{name:10s} {e.rpe_mm:5.1f} mm {e.rpe_deg:.2f} deg within 1 s, off by {e.drift_pct:.2f} % at most,"
            f" {e.cpu_ms:.1f} ms per scan; scans: {health}"
        )


if __name__ == "__main__":
    main()
