"""`docs/extend.md`: the planner that it shows plans, drives, and stands in the study."""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from planning.baselines import door
from planning.errors import NoRoute, PlanningError
from planning.search import PlanRequest
from rbtrg_robot import topics as t
from rbtrg_robot.config import ConfigError, load
from rbtrg_robot.hosts.lockstep import Lockstep
from rbtrg_robot.hosts.plan import MapPlanner
from tests.places import extension
from tools.bench.closed_loop import routes as study
from tools.bench.closed_loop.pictures import draw
from tools.bench.static.study import survey_grid

METHOD = "straight_of_the_docs:plan"


@pytest.fixture(scope="module", autouse=True)
def module(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """The code block of the page as a module."""
    folder = tmp_path_factory.mktemp("own")
    (folder / "straight_of_the_docs.py").write_text(extension(0))
    sys.path.insert(0, str(folder))
    yield
    sys.path.remove(str(folder))


def test_it_plans_on_a_map_without_a_robot() -> None:
    planner = MapPlanner("flat", load(None, [f"planner.method={METHOD}"]))
    x, y, yaw = planner.start
    route = planner.plan((x, y), (x + 2.0, y + 0.5), yaw)
    assert route.ok
    assert route.length == pytest.approx(math.hypot(2.0, 0.5), abs=0.02)


def test_the_stack_drives_its_line() -> None:
    config = load(None, [f"planner.method={METHOD}", "sim.lidar_step=8"], scene="flat")
    with Lockstep(config) as stack:
        stack.wait_ready()
        truth = stack.newest[t.TRUTH].pose.pose.position
        stack.send_goal(truth.x + 1.0, truth.y)
        assert stack.finish_goal(30.0).state == "reached"


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
    with pytest.raises(PlanningError, match="no planner 'moon': use rb_trg, t_hybrid, art"):
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


def test_a_name_that_is_none_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"planner\.method"):
        load(None, ["planner.method=a b"])
