"""What a recording profile leaves out can be made again, byte for byte."""

from __future__ import annotations

from pathlib import Path

from rbtrg_robot import topics as t
from rbtrg_robot.config import load
from rbtrg_robot.hosts.lockstep import Lockstep
from rbtrg_robot.hosts.offline import rerun
from rbtrg_robot.log.read import read_run


def recorded(folder: Path, profile: str) -> Path:
    """Three seconds on flat ground."""
    config = load(None, [f"recorder.profile={profile}", "sim.lidar_step=8"], scene="flat")
    log = folder / f"{profile}.mcap"
    with Lockstep(config, Lockstep.open_log(config, log)) as stack:
        stack.run(3.0)
    return log


def payloads(log: Path) -> dict[str, list[bytes]]:
    found: dict[str, list[bytes]] = {}
    for entry in read_run(log):
        found.setdefault(entry.topic, []).append(entry.data)
    return found


def test_a_standard_log_is_run_again_to_the_bytes_of_a_full_one(tmp_path: Path) -> None:
    full, standard = recorded(tmp_path, "full"), recorded(tmp_path, "standard")
    derived = {
        topic.name for topic in (t.CLOUD, t.HEAD_CLOUD, t.MAP_WINDOW, t.MAP_UPDATE, t.POSE, t.WHEEL_ODOM)
    }
    before, after = payloads(full), payloads(standard)
    assert set(before) - set(after) == derived
    rerun(standard, ["odometry", "elevation"], tmp_path / "again.mcap")
    again = payloads(tmp_path / "again.mcap")
    for name in derived:
        assert len(before[name]) > 5, name
        assert again[name] == before[name], name
    assert standard.stat().st_size < 0.4 * full.stat().st_size


def test_a_lean_log_holds_the_map_and_no_clouds(tmp_path: Path) -> None:
    lean = payloads(recorded(tmp_path, "lean"))
    assert t.MAP_UPDATE.name in lean
    assert t.ODOM.name in lean
    assert not {topic.name for topic in (*t.SWEEPS.values(), *t.CLOUDS.values())} & set(lean)
