"""Bags, layouts, trajectories and files of others: each a row that is 1 where it is read, or refused with the words
that help.

`--data FOLDER` adds public clips and files that lie there (`real/`, `files/`, `terrain/`): how far each scan moved, how
well neighbours fit.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from hal.errors import OperatorError
from hal.scenes import load_scene
from hal.scenes.readers import read_geometry
from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.hosts.offline import rerun
from rbtrg_robot.importer.bag import Bag
from rbtrg_robot.importer.run import convert_bag, look
from rbtrg_robot.log.read import read_run
from rbtrg_robot.log.summary import overview
from rbtrg_robot.log.trajectory import of_run
from rbtrg_robot.wire.messages import decode
from tools.bench.outside import beside, files, foreign
from tools.bench.report import Report

SCAN_COUNT = 20
"""Of a made-up drive."""


def run(args: list[str]) -> Report:
    """Run this bench with the arguments of its command line; returns its rows."""
    parser = argparse.ArgumentParser(prog="python -m tools.bench outside", description=__doc__)
    parser.add_argument("--data", type=Path, help="folder of public data")
    parser.add_argument(
        "--beside",
        action="store_true",
        help="one drive of ours by ours, KISS-ICP and rko-lio, and nothing else",
    )
    options = parser.parse_args(args)
    report = Report("outside")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        if options.beside:
            beside.compare(report, folder)
            return report
        for layout in (*foreign.LAYOUTS, "livox custom", "organised"):
            key = layout.replace(" ", "_")
            bag = foreign.write(folder / f"{key}_bag", foreign.sweeps(layout, 3))
            _holds(report, f"layout.{key}", partial(_three, bag, folder / key))
        for kind in ("mcap", "db3", "zstd", "messages", "bag"):
            bag = foreign.write(folder / f"{kind}_kind", foreign.sweeps("ouster", 3), kind)
            _holds(
                report,
                f"container.{kind}",
                partial(_three, bag, folder / f"{kind}_run"),
            )
        for kind, cases in (("file", files.CASES), ("log", files.LOGS)):
            for name, check in cases.items():
                _holds(report, f"{kind}.{name}", partial(check, folder))
        _drive(report, folder)
        _holds(report, "log.offset_and_duration", partial(_part_of_a_log, folder))
        _holds(report, "log.without_a_clock_has_a_map", partial(_without_clock, folder))
        _refusals(report, folder)
        if options.data is not None:
            _real(report, options.data, folder)
    return report


def _holds(report: Report, key: str, check: Callable[[], bool]) -> None:
    try:
        held = check()
    except OperatorError as error:
        held = False
        print(f"{key}: {error}")
    report.add(key, float(held), "read", 1.0, at_least=True)


def _import(bag: Path, out: Path) -> dict[str, int]:
    recording = Bag(bag)
    return convert_bag(recording, look(recording, {}, {}), out)


def _three(bag: Path, out: Path) -> bool:
    return _import(bag, out).get(t.POINTS.name, 0) == 3


def _drive(report: Report, folder: Path) -> None:
    """A straight drive of known length by LiDAR alone, and with an IMU."""
    for name, more in (("lidar_alone", []), ("lidar_imu", foreign.imu(SCAN_COUNT / 10 + 0.3))):
        bag = foreign.write(folder / f"{name}_bag", [*foreign.sweeps("hesai", SCAN_COUNT), *more])
        _import(bag, folder / name)
        rerun(folder / name, ["odometry", "elevation"], folder / f"{name}.mcap")
        way = of_run(folder / f"{name}.mcap")
        driven = 0.05 * (len(way.stamps) - 1)
        moved = float(np.linalg.norm(way.poses[-1, :3, 3] - way.poses[0, :3, 3]))
        report.add(f"drive.{name}.error_m", abs(moved - driven), "m", 0.05)


def _part_of_a_log(folder: Path) -> bool:
    """A re-run of 0.6 s from 0.7 s on has 6 of the 20 sweeps, of 10 Hz."""
    rerun(folder / "lidar_alone", ["odometry"], folder / "part.mcap", start_offset=0.65, duration=0.6)
    return len(of_run(folder / "part.mcap").stamps) == 6


def _without_clock(folder: Path) -> bool:
    """An imported bag has no /clock; its re-run has odometry and a map."""
    found = overview(folder / "lidar_alone.mcap").topics
    return t.CLOCK.name not in found and found[t.MAP_UPDATE.name].count > 0


def _refusals(report: Report, folder: Path) -> None:
    """Each with the words that tell what would work."""
    two = [*foreign.sweeps("ouster", 2, "/left"), *foreign.sweeps("ouster", 2, "/right", "other")]
    ambiguous = foreign.write(folder / "two", two)
    nothing = foreign.write(folder / "nothing", [foreign.static("a", "b", (0.0, 0.0, 0.0))])
    unread = foreign.write(folder / "unread", foreign.sweeps("ouster", 2))
    db3 = foreign.write(folder / "db3_unread", foreign.sweeps("ouster", 2), "db3")
    named = foreign.write(folder / "named", foreign.sweeps("ouster", 2, t.POINTS.name))
    (folder / "stub.mcap").write_text("version https://git-lfs.github.com/spec/v1\n")
    (folder / "stub.ply").write_text("version https://git-lfs.github.com/spec/v1\n")
    np.save(folder / "dem.npy", np.zeros((50, 60)))
    cases: tuple[tuple[str, str, Callable[[], object]], ...] = (
        ("two_lidars", "--map main=", lambda: look(Bag(ambiguous), {}, {})),
        ("no_sensor", "neither a LiDAR nor an IMU", lambda: look(Bag(nothing), {}, {})),
        (
            "rerun_of_a_foreign_bag",
            "rbtrg-robot import",
            lambda: rerun(unread, ["odometry"], folder / "x.mcap"),
        ),
        (
            "rerun_of_a_db3_folder",
            "rbtrg-robot import",
            lambda: rerun(db3, ["odometry"], folder / "x.mcap"),
        ),
        (
            "planner_without_a_map",
            "holds no /elevation_map/update",
            lambda: rerun(named, ["planner"], folder / "x.mcap"),
        ),
        ("lfs_bag", "git lfs pull", lambda: Bag(folder / "stub.mcap")),
        ("lfs_scene", "git lfs pull", lambda: load_scene(folder / "stub.ply")),
        (
            "bag_as_a_scene",
            "map convert",
            lambda: load_scene(folder / "stub.mcap"),
        ),
        ("dem_without_cells", "--resolution", lambda: load_scene(folder / "dem.npy")),
    )
    for key, words, act in cases:
        told = ""
        try:
            act()
        except OperatorError as error:
            told = str(error)
        report.add(f"refused.{key}", float(words in told), "told", 1.0, at_least=True)


def _real(report: Report, data: Path, folder: Path) -> None:
    for clip in ("os0_8_10scans", "os1_128_3scans"):
        _import(data / "real" / clip, folder / clip)
        rerun(folder / clip, ["odometry", "elevation"], folder / f"{clip}.mcap")
        way = of_run(folder / f"{clip}.mcap")
        steps = np.linalg.norm(np.diff(way.poses[1:, :3, 3], axis=0), axis=1)
        report.add(f"real.{clip}.scans", len(way.stamps), "scans")
        report.add(f"real.{clip}.step_m", float(np.median(steps)), "m")
        report.add(f"real.{clip}.step_spread_m", float(np.ptp(steps)), "m", 0.15)
        healths = [
            decode(e.data, msg.OdometryHealth)
            for e in read_run(folder / f"{clip}.mcap")
            if e.topic == t.ODOM_HEALTH.name
        ]
        report.add(f"real.{clip}.inliers", min(h.inliers for h in healths), "share", 0.9, at_least=True)
        report.add(f"real.{clip}.residual_m", float(np.median([h.residual for h in healths[1:]])), "m", 0.06)
    for folder_, patterns in (("files", ("pcl_*.pcd",)), ("terrain", ("*.ply", "*.pcd"))):
        clouds = sorted(path for pattern in patterns for path in (data / folder_).glob(pattern))
        read = sum(len(read_geometry(cloud).vertices) > 0 for cloud in clouds)
        report.rate(f"{folder_}.clouds", read, len(clouds), limit=1.0)
