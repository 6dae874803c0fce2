"""Benches that no other test runs: a few seconds of each, with its limits."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hal.scenes.scene import Scene
from tools.bench import kill, lockstep, rules, stop
from tools.bench.outside import bench as outside
from tools.bench.perception import bench as perception
from tools.bench.perception import open_ground
from tools.bench.planning import bench as planning
from tools.bench.planning import crossings, query, watch


def test_bags_and_files_of_others_are_read_or_refused_with_words_that_help() -> None:
    report = outside.run([])
    assert not [row for row in report.rows if not row.ok]
    assert len(report.rows) == 50


def test_open_ground_and_a_crowd_are_driven_within_their_limits(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in (
        ("OPEN_WAY", 0.4),
        ("REST_TIME", 1.2),
        ("CROWD_SECONDS", 2.0),
        ("SIGHTS", ("field_wall",)),
    ):
        monkeypatch.setattr(open_ground, name, value)
    monkeypatch.setattr(open_ground, "CROWDS", ("field_posts",))
    report = perception.run(["--only", "open", "--open", "1"])
    assert not [
        row for row in report.rows if not row.ok and row.unit != "%"
    ]  # of so short a way a share says nothing
    assert [row.key for row in report.rows] == [
        "open.field_wall.yaw_deg",
        "open.field_wall.way_pct",
        "open.field_wall.held",
        *(
            f"crowd.field_posts.{what}"
            for what in ("standing_m", "standing_deg", "stood", "driving_m", "drove")
        ),
    ]


def test_a_goal_is_driven_in_lockstep_and_judged() -> None:
    report = lockstep.run(
        ["--scene", "flat", "--goals", "a", "--set", "sim.lidar_step=8", "--set", "record=false"]
    )
    rows = {row.key: row for row in report.rows}
    assert rows["reached.a"].ok
    assert rows["error_m.a"].ok
    assert {"goal_s.a", "speed", "cpu.robot", "cpu.wire"} <= rows.keys()


def test_a_tracker_that_dies_in_lockstep_lets_the_robot_rest() -> None:
    report = kill.run(["--lockstep", "--only", "tracker"])
    assert report.rows
    assert not [row for row in report.rows if not row.ok]


def test_a_stop_is_heard_on_the_bus(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))  # which the bench sets, too
    report = stop.run(["--rounds", "1"])
    assert [row.key for row in report.rows] == ["stop.first_on_bus.median", "stop.first_on_bus.worst"]


def test_graphs_and_queries_of_a_small_map_have_every_row(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(planning, "LARGE_SIDE", 8.0)
    monkeypatch.setattr(planning, "cpu_seconds", lambda _work, _repeats: 1.0)
    monkeypatch.setattr(query, "PAIR_COUNT", 4)
    monkeypatch.setattr(query, "UPDATE_COUNT", 4)
    for part in (watch, crossings):
        monkeypatch.setattr(part, "rows", lambda report: None)
    report = planning.run([])
    keys = {row.key for row in report.rows}
    assert keys >= {"build_ms.native_8m", "update_ms", "large.memory_mb", "query_ms.p50", "replan_ms"}
    assert keys >= {f"large.stack_{what}_s" for what in ("prepared", "cold", "warm", "moving")}


def test_no_path_leads_over_what_stands_there(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(watch, "WORLD_COUNT", 1)
    monkeypatch.setattr(watch, "PATH_COUNT", 2)
    report = planning.run(["--only", "watch"])
    assert not [row for row in report.rows if not row.ok]


def test_a_rule_that_is_left_out_changes_what_it_is_for_and_comes_back() -> None:
    report = rules.run(["--without", "straighten", "--without", "give_up", "--only", "pit_0"])
    rows = {row.key: row.value for row in report.rows}
    assert (rows["rules.straighten.changed"], rows["rules.give_up.changed"]) == (1, 0), "one rule at a time"
    first = {row.key: row.baseline for row in report.rows}
    assert rows["rules.straighten.pit_0.turned"] != first["rules.straighten.pit_0.turned"]
    assert rows["rules.give_up.pit_0.driven"] == first["rules.straighten.pit_0.driven"]


def test_behind_a_crest_nobody_sees_the_ground() -> None:
    height = np.zeros((80, 80), np.float32)
    height[:, 50:] = -0.3
    world = rules._World(Scene("ledge", height, 0.04, (0.0, 0.0), (0.6, 1.6, 0.0), {}))
    world.look(0.6, 1.6)
    assert world.seen[40, 45]
    assert not world.seen[40, 52]
    assert world.grid().virtual[40, 54:70].all(), "rays passed low over it"
