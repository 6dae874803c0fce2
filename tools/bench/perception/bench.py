"""Odometry and elevation map against the truth of the synthetic arena run: figure-eight, 60 s, trunk pitching by +-10
deg.

    python -m tools.bench perception [--json] [--seconds 60] [--seed 0] [--lidar xt16,mid360,l1] [--soak 3] [--lanes 4]
    [--basin 24] [--poses 20] [--offset 20] [--mounts 15] [--metres 1000]
                                    [--only relocalise|offset|mounts|map_1km|map|soak|odometry|open|basin|lanes]
                                    [--no-joints]

Baseline is stock KISS-ICP in the same run. `--soak 30` is the full endurance run (several times faster than real time);
`--soak 0` leaves it out. `--lanes 40` drives 40 generated rescue lanes, `--lanes 0` none. `--poses 100` puts the robot
at 100 places of
scenes mapped before. `--offset 20` drives so long with stamps that are off the IMU, `--mounts 15` with mounts that are
off. `--metres 1000` maps a street of that length. `--only NAME` runs one part. `--basin 24` moves the robot 24 times
while it sees nothing, `--basin 0` never.
`--open 20` drives so often on open ground of each kind, and in a crowd; with `--out FILE` what stands in it is not
driven again.
`--no-joints` hides the joints from the odometry.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from mapping.odometry.types import OdometryConfig
from tools.bench.perception import basin as _perception_basin
from tools.bench.perception import kilometre as _perception_kilometre
from tools.bench.perception import lanes as _perception_lanes
from tools.bench.perception import lidar as _perception_lidar
from tools.bench.perception import map as _perception_map
from tools.bench.perception import mounts as _perception_mounts
from tools.bench.perception import offset as _perception_offset
from tools.bench.perception import open_ground as _perception_open
from tools.bench.perception import relocalise as _perception_relocalise
from tools.bench.perception import soak as _perception_soak
from tools.bench.perception.odometry import Errors, drive, errors
from tools.bench.records import Records
from tools.bench.report import Report
from tools.synthetic import arena_run

PARTS = "relocalise", "offset", "mounts", "map_1km", "map", "soak", "odometry", "open", "basin", "lanes"
ENGINES = ("kiss_icp", "small_gicp", "stock")
RPE_LIMIT = {
    ("xt16", "kiss_icp"): (12.0, 0.20),
    ("xt16", "small_gicp"): (9.0, 0.15),
    ("mid360", "kiss_icp"): (20.0, 0.30),
    ("mid360", "small_gicp"): (11.0, 0.20),
}
"""RMS over 1 s [mm], [deg]."""
DRIFT_LIMIT = {("xt16", "kiss_icp"): 1.0, ("mid360", "kiss_icp"): 1.0}
"""[% of the path]"""
LANE_SECONDS = 90.0
"""A lane that is not driven by then [s, simulated] ends there."""
CPU_LIMIT = {("xt16", "kiss_icp"): 20.0, ("xt16", "small_gicp"): 20.0}
"""Median per scan of 23k points [ms]."""


def run(args: list[str]) -> Report:
    """Run this bench with the arguments of its command line; returns its rows."""
    parser = argparse.ArgumentParser(prog="python -m tools.bench perception")
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--lidar", default="xt16,mid360,l1")
    parser.add_argument("--soak", type=float, default=3.0, metavar="MINUTES")
    parser.add_argument("--lanes", type=int, default=4, metavar="N")
    parser.add_argument("--poses", type=int, default=20, metavar="N")
    parser.add_argument("--only", choices=PARTS)
    parser.add_argument("--metres", type=float, default=1000.0)
    parser.add_argument("--basin", type=int, default=24, metavar="N")
    parser.add_argument("--open", type=int, default=20, metavar="N")
    parser.add_argument("--mounts", type=float, default=15.0, metavar="SECONDS")
    parser.add_argument("--offset", type=float, default=20.0, metavar="SECONDS")
    parser.add_argument("--no-joints", action="store_true")
    parser.add_argument("--out", type=Path)
    options = parser.parse_args(args)
    report = Report("perception")
    asked = {options.only} if options.only else set(PARTS)
    if options.poses > 0 and "relocalise" in asked:
        _perception_relocalise.rows(report, options.poses, options.seed)
    if options.mounts > 0.0 and "mounts" in asked:
        _perception_mounts.rows(report, options.mounts, options.seed)
    if options.offset > 0.0 and "offset" in asked:
        _perception_offset.rows(report, options.offset, options.seed)
    if options.metres > 0.0 and "map_1km" in asked:
        _perception_kilometre.rows(report, options.metres)
    if "map" in asked:
        _perception_map.rows(report, options.lidar.split(","), options.seconds, options.seed)
    if options.soak > 0.0 and "soak" in asked:
        _perception_soak.rows(report, options.soak)
    if "odometry" in asked:
        for lidar in options.lidar.split(","):
            _odometry_rows(report, lidar, options.seconds, options.seed, not options.no_joints)
        _perception_lidar.rows(report, options.lidar.split(","))
    if options.open > 0 and "open" in asked:
        _perception_open.rows(report, options.open, Records(options.out))
    if options.basin > 0 and "basin" in asked:
        _perception_basin.rows(report, options.basin)
    if options.lanes > 0 and "lanes" in asked:
        _perception_lanes.rows(report, options.lanes, LANE_SECONDS)
    return report


def _odometry_rows(report: Report, lidar: str, seconds: float, seed: int, joints: bool) -> None:
    scene_run = arena_run(lidar, seed=seed, duration=seconds)
    maps = {name: _perception_map.EngineMap(scene_run) for name in ENGINES}
    tracks = drive(
        scene_run,
        ENGINES,
        OdometryConfig(use_joints=joints),
        on_scan=lambda name, scan: maps[name].take(scan),
    )
    rmse = {name: m.rmse_mm() for name, m in maps.items()}
    results: dict[str, Errors] = {name: errors(scene_run, track) for name, track in tracks.items()}
    stock = results["stock"]
    none = (None, None)
    for name, e in results.items():
        key = (lidar, name)
        mm, deg = RPE_LIMIT.get(key, none)
        report.add(f"rpe_mm.{lidar}.{name}", e.rpe_mm, "mm", mm, stock.rpe_mm)
        report.add(f"rpe_deg.{lidar}.{name}", e.rpe_deg, "deg", deg, stock.rpe_deg)
        report.add(f"drift_pct.{lidar}.{name}", e.drift_pct, "%", DRIFT_LIMIT.get(key), stock.drift_pct)
        limit = _perception_map.ENGINE_LIMIT.get(lidar) if name == "kiss_icp" else None
        report.add(f"map_rmse_mm.{lidar}.{name}", rmse[name], "mm", limit, rmse["stock"])
        report.add(f"cpu_ms.odometry.{lidar}.{name}", e.cpu_ms, "ms", CPU_LIMIT.get(key), stock.cpu_ms)
