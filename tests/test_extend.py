"""`docs/extend.md`: the planner that it shows plans, drives, and stands in the study; its controller drives, its finder
finds."""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mapping.relocalise import Submap
from mapping.relocalise.door import FinderError, OwnFinder
from planning.errors import NoRoute, PlanningError
from planning.search import PlanRequest, door
from planning.tracking.door import OwnTracker
from planning.tracking.types import TrackerConfig, TrackPhase
from rbtrg_robot.config import ConfigError, load
from rbtrg_robot.hosts.judging import Suite
from rbtrg_robot.hosts.plan import MapPlanner
from tests.places import ROOT, extension
from tools.bench.closed_loop import routes as study
from tools.bench.closed_loop.pictures import draw
from tools.bench.static.study import survey_grid

METHOD = "straight_of_the_docs:plan"


@pytest.fixture(scope="module", autouse=True)
def modules(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """The code of the page as modules."""
    folder = tmp_path_factory.mktemp("own")
    for name in ("straight", "pursuit", "corner"):
        (folder / f"{name}_of_the_docs.py").write_text(extension(name))
    sys.path.insert(0, str(folder))
    yield
    sys.path.remove(str(folder))


def test_it_plans_on_a_map_without_a_robot() -> None:
    planner = MapPlanner("flat", load(None, [f"planner.method={METHOD}"]))
    x, y, yaw = planner.start
    route = planner.plan((x, y), (x + 2.0, y + 0.5), yaw)
    assert route.ok
    assert route.length == pytest.approx(math.hypot(2.0, 0.5), abs=0.02)


def test_the_stack_drives_its_line_as_it_drives_ours(tmp_path: Path) -> None:
    """By the file of the page."""
    text = (ROOT / "docs" / "extend.md").read_text().split("```yaml\n")[1].split("```")[0]
    file = tmp_path / "beside.yaml"
    file.write_text(text.replace("straight:plan", METHOD))
    results = list(Suite(file).run())
    assert [r.case for r in results] == ["planner.method=rb_trg", f"planner.method={METHOD}"]
    assert all(r.holds for r in results), results


def test_it_stands_in_the_study_and_its_pictures(tmp_path: Path) -> None:
    found = study.routes("rescue_slopes", 0, [METHOD], ["policy"])
    assert [r.method for r in found] == [METHOD]
    record = {
        "scene": "rescue_slopes",
        "query": 0,
        "method": METHOD,
        "controller": "policy",
        "colliders": "all",
    }
    draw(tmp_path, [record | {"eligible": True, "success": False}], found)
    assert (tmp_path / "success_policy_all.png").stat().st_size > 1000


def test_what_a_planner_does_wrong_is_told_and_ends_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    grid = survey_grid(study.scene_of("rescue_slopes"))
    x, y = (grid.extent[0] + grid.extent[2]) / 2, (grid.extent[1] + grid.extent[3]) / 2
    request = PlanRequest((x, y), (x + 1.0, y))
    with pytest.raises(PlanningError, match="no planner 'moon': use rb_trg, or"):
        door.planner_of("moon")
    with pytest.raises(PlanningError, match="PYTHONPATH"):
        door.planner_of("nowhere_at_all:plan")
    answers = {
        "failed: ZeroDivisionError": lambda *_: 1 / 0,
        "failed: ValueError": lambda *_: [[x, y], [x + 1.0]],
        "neither a Plan nor a line": lambda *_: np.full((3, 2), np.nan),
        "does not lead to the goal": lambda *_: np.array([[x, y], [x + 9.0, y]]),
    }
    import straight_of_the_docs as own

    for words, function in answers.items():
        monkeypatch.setattr(own, "plan", function)
        with pytest.raises(PlanningError, match=words):
            door.planner_of(METHOD)(grid, request)
    monkeypatch.setattr(own, "plan", lambda *_: None)
    with pytest.raises(NoRoute):
        door.planner_of(METHOD)(grid, request)


def test_the_controller_drives_through_the_stack(tmp_path: Path) -> None:
    file = tmp_path / "drive.yaml"
    file.write_text(
        "drive: {scene: flat, goals: [[1.5, 0.6]], timeout: 40}\n"
        "set: {sim.lidar_step: 8, tracker.method: 'pursuit_of_the_docs:drive'}\n"
        "assert: [last goal.state == reached, max tracker.cross_track < 0.3, max tilt < 5]\n"
    )
    [result] = Suite(file).run()
    assert result.holds, result


def test_a_controller_that_fails_holds_the_robot_and_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    import pursuit_of_the_docs as own

    line = np.column_stack([np.linspace(0.0, 2.0, 101), np.zeros(101)])

    def moved(answer: Any, seconds: float = 1.0) -> Any:
        monkeypatch.setattr(own, "drive", answer)
        tracker = OwnTracker("pursuit_of_the_docs:drive", TrackerConfig())
        tracker.set_path(line, np.zeros(101), np.full(101, 0.5))
        for k in range(round(50 * seconds)):
            out = tracker.step(k * 20_000_000, 0.0, 0.0, 0.0, 0.0, 0.0)
        return out

    fast = moved(lambda *_: (9.0, -9.0))
    assert (fast.vx, fast.wz) == pytest.approx((0.5, -0.8)), "cut to the limits of path and tracker"
    assert moved(lambda *_: (9.0, 0.0), 0.1).vx < 0.1, "and slewed"
    for words, answer in {
        "ZeroDivisionError": lambda *_: 1 / 0,
        "no velocity": lambda *_: (math.nan, 0.0),
        "TypeError": lambda *_: 0.3,
    }.items():
        held = moved(answer)
        assert (held.vx, held.wz) == (0.0, 0.0)
        assert words in held.fault
    assert moved(lambda *_: None).phase is TrackPhase.DONE
    with pytest.raises(PlanningError, match="no tracker 'moon': use line_of_sight, or package"):
        OwnTracker("moon", TrackerConfig())


def test_the_finder_finds_and_what_it_does_wrong_is_told(monkeypatch: pytest.MonkeyPatch) -> None:

    rng = np.random.default_rng(0)
    side, up = rng.uniform(0.0, 5.0, 4000), rng.uniform(0.0, 2.0, 4000)
    cloud = np.where(rng.random((4000, 1)) < 0.4, np.c_[side, 0 * side, up], np.c_[0 * side, side, up])
    submap = Submap()
    x, y, yaw = 2.0, 1.5, 0.4
    c, s = math.cos(yaw), math.sin(yaw)
    seen = (cloud - (x, y, 0.4)) @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    submap.add(seen.astype(np.float32), np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]), np.zeros(3), 0.4)
    finder = OwnFinder("corner_of_the_docs:find")
    found = finder.locate(cloud.astype(np.float32), submap, (x + 0.3, y - 0.2, yaw))
    assert found.answer == "located"
    best = found.candidates[0].place
    assert (best.x, best.y) == pytest.approx((x, y), abs=0.11)
    monkeypatch.setattr(finder, "_find", lambda *_: [(x, y, 0.0, 0.9), (x + 3.0, y, 0.0, 0.8)])
    assert finder.locate(cloud, submap).answer == "ambiguous"
    assert finder.locate(cloud, submap, (x + 3.0, y, 0.0), told=True).candidates[0].place.x == x + 3.0
    monkeypatch.setattr(finder, "_find", lambda *_: None)
    assert finder.locate(cloud, submap).answer == "not_found"
    monkeypatch.setattr(finder, "_find", lambda *_: [(1.0, 2.0)])
    with pytest.raises(FinderError, match="corner_of_the_docs:find failed: ValueError"):
        finder.locate(cloud, submap)


def test_a_name_that_is_none_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"planner\.method"):
        load(None, ["planner.method=a b"])
