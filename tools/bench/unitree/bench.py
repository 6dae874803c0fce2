"""The real robot's side: cost of its messages against the DDS library's own coder, the time to rest after a death, and
a
robot that goes and comes back.

All but the messages is done to a running `up` that drives the peer (`tests/hal/unitree/peer.py`) on loopback at 0.5
m/s.
"""

from __future__ import annotations

import argparse
import timeit

import numpy as np

from hal.types import NS
from hal.unitree import api, cloud, layout
from tools.bench.report import Report
from tools.bench.unitree.away import run as away
from tools.bench.unitree.deaths import DEATHS
from tools.bench.unitree.deaths import run as deaths

POINT_COUNT = 20_000
L1_POINT = np.dtype(
    {
        "names": ["x", "y", "z", "intensity", "ring", "time"],
        "formats": ["<f4", "<f4", "<f4", "<f4", "<u2", "<f4"],
        "offsets": [0, 4, 8, 16, 20, 24],
        "itemsize": 32,
    }
)


def _best(call, number: int, repeat: int = 9) -> float:  # type: ignore[no-untyped-def]
    """Seconds per call, the fastest of some repeats: the rest is other people's load."""
    return min(timeit.repeat(call, number=number, repeat=repeat)) / number


def _cloud() -> bytes:
    rng = np.random.default_rng(0)
    points = np.zeros(POINT_COUNT, L1_POINT)
    for axis in "xyz":
        points[axis] = rng.normal(scale=4.0, size=POINT_COUNT)
    points["time"] = np.linspace(0.0, 0.1, POINT_COUNT)
    return cloud.encode_cloud(1_700_000_000 * NS, "utlidar_lidar", points)


def run(args: list[str]) -> Report:
    """Run this bench with the arguments of its command line; returns its rows."""
    parser = argparse.ArgumentParser(prog="python -m tools.bench unitree", description=__doc__)
    parser.add_argument("--deaths", nargs="*", choices=DEATHS, default=list(DEATHS), metavar="WHAT")
    parser.add_argument("--no-away", action="store_true", help="leave the robot that goes and comes back out")
    parser.add_argument("--trials", type=int, default=3)
    options = parser.parse_args(args)
    report = Report("unitree")
    _messages(report)
    if options.deaths:
        deaths(report, options.deaths, options.trials)
    if not options.no_away:
        away(report)
    return report


def _messages(report: Report) -> None:
    """Decoding a LowState (what odometry and the safety gate read of it), a cloud of 20 k points, and a request."""
    from hal.unitree import idl

    low = layout.CDR_HEADER + bytes(layout.LOW_STATE_CDR.itemsize)

    def low_state() -> None:
        record = layout.view(low, layout.LOW_STATE_CDR)
        motors, imu = record["motor_state"], record["imu_state"]
        _ = (
            record["tick"],
            motors["q"],
            motors["dq"],
            motors["tau_est"],
            imu["gyroscope"],
            imu["accelerometer"],
        )

    ours = _best(low_state, 500)
    theirs = _best(lambda: idl.LowState.__idl__.deserialize(low), 20, 5)
    report.add("unitree.low_state_decode", 1e6 * ours, "us", limit=5.0, baseline=1e6 * theirs)

    data = _cloud()
    mount = cloud.Limits()
    cloud.sweep(cloud.decode_cloud(data), mount)
    ours = _best(lambda: cloud.sweep(cloud.decode_cloud(data), mount), 20)
    theirs = _best(lambda: idl.PointCloud2.__idl__.deserialize(data), 2, 3)
    report.add("unitree.cloud_20k_to_points", 1e3 * ours, "ms", limit=0.3, baseline=1e3 * theirs)

    request = api.Request(1, api.Sport.MOVE, '{"x": 0.5, "y": 0.0, "z": 0.1}', True)
    body = idl.RequestMessage.__idl__.deserialize(request.pack())
    ours = _best(request.pack, 500)
    theirs = _best(lambda: idl.RequestMessage.__idl__.serialize(body), 50)
    report.add("unitree.move_encode", 1e6 * ours, "us", baseline=1e6 * theirs)

    report.add("unitree.low_state_checksum", 1e6 * _best(lambda: layout.low_state_checksum(low), 500), "us")
