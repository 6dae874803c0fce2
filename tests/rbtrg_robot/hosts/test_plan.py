"""Plans on a map without a robot."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path

import numpy as np
import pytest
import typer
from PIL import Image
from typer.testing import CliRunner

from hal.robots.go2w.facts import BODY_WIDTH
from hal.scenes import SceneError
from rbtrg_robot.cli import plan as plan_command
from rbtrg_robot.config import ConfigError, load
from rbtrg_robot.hosts.plan import STARTS_TRIED, MapPlanner, _apart


@pytest.fixture(scope="module")
def wall(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """8 x 6 m of level ground; a wall from the lower edge up leaves a gap of 2 m at the top."""
    height = np.zeros((150, 200), np.float32)
    height[:100, 98:102] = 1.0
    path = tmp_path_factory.mktemp("maps") / "wall.npz"
    np.savez(path, height=height, resolution=0.04, origin=(0.0, 0.0))
    return path


@pytest.fixture(scope="module")
def planner(wall: Path) -> MapPlanner:
    return MapPlanner(str(wall), load())


def test_what_the_robot_keeps_out_of_is_planned_around_and_is_no_goal(wall: Path) -> None:
    gap = {"gap": [(3.5, 3.9), (4.5, 3.9), (4.5, 6.2), (3.5, 6.2)]}
    closed = MapPlanner(str(wall), load(keepout=gap))
    assert not closed.plan((1.0, 1.0), (7.0, 1.0)).reaches_goal
    route = closed.plan((1.0, 1.0), (4.0, 5.0))
    assert (route.reason, route.detail) == ("keep_out_area", "the goal is in a keep-out area: by 0.5 m, gap")
    half = {"gap": [(3.5, 3.9), (4.5, 3.9), (4.5, 4.9), (3.5, 4.9)]}
    around = MapPlanner(str(wall), load(keepout=half)).plan((1.0, 1.0), (7.0, 1.0))
    assert around.reaches_goal
    assert min(y for x, y, *_ in around.path if 3.5 < x < 4.5) > 4.9 + 0.5 * BODY_WIDTH


def run(*words: str) -> tuple[int, str]:
    app = typer.Typer()
    plan_command.register(app)
    result = CliRunner().invoke(app, list(words), catch_exceptions=False)
    return result.exit_code, result.output


def test_a_route_goes_around_the_wall_and_depends_on_its_question_alone(planner: MapPlanner) -> None:
    first = planner.plan((2.0, 2.0), (6.0, 2.0))
    planner.plan((6.0, 5.0), (2.0, 1.0))
    again = planner.plan((2.0, 2.0), (6.0, 2.0))
    assert first == again
    assert first.ok
    assert first.reaches_goal
    assert max(y for _, y, *_ in first.path) > 4.0
    assert 6.0 < first.length < 9.0
    assert math.dist(first.path[-1][:2], (6.0, 2.0)) < 0.1


def test_what_cannot_be_planned_is_told_with_its_reason(planner: MapPlanner) -> None:
    off = planner.plan((2.0, 2.0), (60.0, 2.0))
    assert not off.ok
    assert "outside the map, which reaches from (" in off.detail
    walled = planner.plan((4.0, 1.0), (6.0, 2.0))
    assert walled.reason == "start_not_on_graph"
    assert "the start (4, 1)" in walled.detail
    assert "robot" not in walled.detail, "there is none"
    named = re.search(r"START ([-\d.]+),([-\d.]+),([-\d.]+) has a way$", walled.detail)
    assert named is not None, walled.detail
    x, y, yaw = map(float, named.groups())
    assert math.dist((x, y), (4.0, 1.0)) < 2.0
    assert planner.plan((x, y), (6.0, 2.0), math.radians(yaw)).reaches_goal
    assert "reaches from (-0.02, -0.02)" in planner.plan((-1.0, 2.0), (6.0, 2.0)).detail, (
        "as far as it is known"
    )
    blocked = planner.plan((2.0, 2.0), (4.0, 1.0))
    assert (blocked.ok, blocked.reason) == (False, "goal_in_obstacle")


def test_other_starts_are_looked_for_beyond_what_lies_near() -> None:
    """Within metres there may be nothing but a wall."""
    rows, cols = np.indices((100, 100))
    tried = _apart(0.1 * np.column_stack([cols.ravel(), rows.ravel()]), (5.0, 5.0))
    far = [math.dist(place, (5.0, 5.0)) for place in tried]
    assert (len(tried), far[0]) == (STARTS_TRIED, 0.0)
    assert far == sorted(far)
    assert sum(one > 3.0 for one in far) >= 5


def test_the_picture_shows_route_and_risk(planner: MapPlanner, tmp_path: Path) -> None:
    route = planner.plan((2.0, 2.0), (6.0, 2.0))
    planner.image(route).save(tmp_path / "plan.png")
    pixels = np.asarray(Image.open(tmp_path / "plan.png").convert("RGB"), int)
    assert (np.abs(pixels - (255, 170, 40)).sum(axis=2) < 40).sum() > 200
    assert (np.abs(pixels - (80, 200, 120)).sum(axis=2) < 40).sum() > 200


def test_the_command_answers_for_people_and_for_programs(wall: Path, tmp_path: Path) -> None:
    code, out = run(str(wall), "2,2", "6,2", "--json", "--geojson", str(tmp_path / "r.geojson"))
    assert code == 0
    told = json.loads(out)
    assert told["reaches_goal"]
    line = json.loads((tmp_path / "r.geojson").read_text())["features"][0]
    assert len(line["geometry"]["coordinates"]) == len(told["path"])
    (tmp_path / "pairs.txt").write_text("# two\n2 2 6 2\n2 2 4 1\n")
    code, out = run(str(wall), "--pairs", str(tmp_path / "pairs.txt"))
    assert code == 2
    assert "1 of 2 reach their goal" in out
    (tmp_path / "walled.txt").write_text("4 1 6 2\n4 2 6 2\n4 1.5 6 2\n")
    code, out = run(str(wall), "--pairs", str(tmp_path / "walled.txt"))
    assert code == 2
    assert (out.count("no route (start_not_on_graph)"), out.count("has a way")) == (3, 1), (
        "graphs are drawn once"
    )
    assert run(str(wall), "2,2", "40,2")[0] == 2
    assert "No such option" not in run(str(wall), "-1,2", "6,2")[1]
    assert run(str(wall), "2", "2", "6", "2") == run(str(wall), "2,2", "6,2")
    assert run(str(wall), "start", "6,2") == run(str(wall), "6", "2")
    (tmp_path / "many.txt").write_text("2 2 6 2\n" * 1_300_000)
    with pytest.raises(ConfigError, match=r"many.txt has more than 10 MB: split it"):
        run(str(wall), "--pairs", str(tmp_path / "many.txt"))


def test_a_picture_and_a_file_without_a_level_place_are_planned_on(tmp_path: Path) -> None:
    rough = (np.indices((80, 80)).sum(axis=0) % 2 * 255).astype(np.uint8)
    Image.fromarray(rough).save(tmp_path / "rough.png")
    how = ("--resolution", "0.05", "--height-range", "0", "0.5")
    with pytest.raises(SceneError, match=r"no level place .* `plan FILE X,Y`"):
        run(str(tmp_path / "rough.png"), "start", "2,2", *how)
    code, words = run(str(tmp_path / "rough.png"), "1,1", "2,2", *how)
    assert code in (0, 3), "a plan to the goal, or to where it has to be looked"
    assert "to arrive" in words
    with pytest.raises(SceneError, match="--height-range LOW HIGH"):
        run(str(tmp_path / "rough.png"), "1,1", "2,2")


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("moon", "0,0", "1,1"), "neither a file nor a scene"),
        (("flat", "start", "nowhere"), "goals here are"),
        (("flat", "a,b", "1,1"), "START is"),
        (("flat",), "say a goal"),
        (("flat", "0", "0", "1"), "GOAL is"),
        (("flat", "0,0", "1,1", "2,2"), "START and GOAL"),
        (("moon", "0,0", "1,1", "--png", "nowhere/a.png"), "cannot write nowhere/a.png: No such file"),
        (("moon", "0,0", "1,1", "--geojson", "nowhere/a.json"), "cannot write nowhere/a.json: No such file"),
    ],
)
def test_a_question_that_makes_no_sense_is_refused(words: tuple[str, ...], told: str) -> None:
    with pytest.raises(ConfigError, match=told):
        run(*words)
