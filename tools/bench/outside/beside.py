"""One recorded drive of ours by ours, by KISS-ICP as it comes and by rko-lio as it comes.

rko-lio is no dependency: `uv run --with rko-lio==0.4.0 python -m tools.bench outside --beside`. It opens our run as any
bag.
"""

from __future__ import annotations

import importlib
import time
from collections import deque
from pathlib import Path
from typing import Any

from hal.errors import OperatorError
from hal.lidar.config import only
from hal.types import NS, ImuSample, LidarScan
from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.config import load
from rbtrg_robot.log.bag import describe
from rbtrg_robot.log.write import LogWriter
from rbtrg_robot.wire.convert import BASE, imu_msg, rpy_quaternion, scan_msg, transform_msg
from rbtrg_robot.wire.messages import encode, stamp_of
from tools.bench.perception.odometry import Track, drive, errors
from tools.bench.report import Report
from tools.odometry_study import RecordedDrive, record

START_DATE = 1_767_225_600 * NS
"""The simulated clock of `up` begins here; that of lockstep at 0, which rko-lio takes for no stamp."""
WITH = "rko-lio==0.4.0"
VOXEL_SIDES = (1.0, 0.25)
"""rko-lio's own, and one for small scenes [m]."""
DRIVE_GOALS = [(6.0, 0.0)]
"""Ahead and left of the start [m]."""


def compare(report: Report, folder: Path) -> None:
    """Rows `beside.*`: RPE over 1 s, CPU a scan on one thread. Raises OperatorError where rko-lio is not there."""
    _part("lio")
    run = record(load(None, [], scene="yard", lidars=only("xt16")), DRIVE_GOALS)
    report.add("beside.driven_m", run.path_length(), "m")
    tracks = drive(run, ("kiss_icp", "stock"))
    found = {"ours": tracks["kiss_icp"], "kiss_icp_stock": tracks["stock"]}
    bag = as_bag(run, folder / "beside")
    for voxel in VOXEL_SIDES:
        found[f"rko_lio_{voxel:g}m"] = _rko_lio(voxel, bag)
    for name, track in found.items():
        wrong = errors(run, track)
        report.add(f"beside.{name}.scans", len(track.stamps), "scans")
        report.add(f"beside.{name}.rpe_1s_mm", wrong.rpe_mm, "mm")
        report.add(f"beside.{name}.rpe_1s_deg", wrong.rpe_deg, "deg")
        report.add(f"beside.{name}.cpu_ms", wrong.cpu_ms, "ms")


def as_bag(run: RecordedDrive, folder: Path) -> Path:
    """The drive as `up` would have recorded it in the profile `full`: sweeps, IMU and the LiDAR's mount."""
    mount = run.extrinsics
    lidar = transform_msg(START_DATE, BASE, "lidar_main", mount.translation, rpy_quaternion(mount.rpy))
    with LogWriter(folder / "log_0.mcap", {}) as writer:
        writer.write(t.TF_STATIC, encode(msg.TFMessage(transforms=[lidar])), START_DATE, START_DATE, 1)
        for number, sample in enumerate(run.samples(), 1):
            if isinstance(sample, ImuSample):
                message: msg.Message = imu_msg(
                    ImuSample(sample.stamp + START_DATE, sample.gyro, sample.accel)
                )
                topic: t.Topic = t.IMU
            elif isinstance(sample, LidarScan):
                message, topic = (
                    scan_msg(LidarScan(sample.stamp + START_DATE, sample.points, sample.name)),
                    t.POINTS,
                )
            else:
                continue
            writer.write(topic, encode(message), stamp_of(message), stamp_of(message), number)
    describe(folder)
    return folder


def _rko_lio(voxel: float, bag: Path) -> Track:
    """What rko-lio's own reader and odometry make of the folder: its defaults but for voxels, one thread, near
    points."""
    settings, reader = _part("config"), _part("dataloaders.rosbag").RosbagDataLoader
    data = reader(bag, t.IMU.name, t.POINTS.name, None, None, BASE, settings.TimestampConfig())
    imu, lidar = data.extrinsics
    config = settings.LIOConfig(voxel_size=voxel, max_num_threads=1, min_range=0.3)
    odometry = _part("lio").LIO(config)
    track, spent, waiting = Track(), 0.0, deque[dict[str, Any]]()
    for kind, parts in data:
        if kind != "imu":
            waiting.append(parts)
            continue
        start = time.process_time()
        odometry.add_imu_measurement(**parts, extrinsic_imu2base=imu)
        while waiting and waiting[0]["end_time_ns"] < parts["time"]:  # the IMU is ahead of the sweep
            sweep = waiting.popleft()
            odometry.register_scan(**sweep, extrinsic_lidar2base=lidar)
            track.stamps.append(sweep["end_time_ns"] - START_DATE)
            track.poses.append(odometry.pose())
            track.cpu.append(spent + time.process_time() - start)
            spent, start = 0.0, time.process_time()
        spent += time.process_time() - start
    return track


def _part(name: str) -> Any:
    """A module of rko-lio. Raises OperatorError."""
    try:
        return importlib.import_module(f"rko_lio.{name}")
    except ImportError as error:
        raise OperatorError(
            f"rko-lio is not installed: `uv run --with {WITH} python -m tools.bench outside --beside`"
        ) from error
