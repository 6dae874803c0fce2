"""The closed-loop study: its draws, its walls, its statistics, its records, and that it goes on where it was cut
off."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from hal.scenes import load_scene
from rbtrg_robot import topics
from rbtrg_robot.config import load
from rbtrg_robot.hosts.lockstep import Lockstep
from rbtrg_robot.wire.convert import yaw_of
from tools.bench.closed_loop import bench, protocol, stack
from tools.bench.closed_loop.protocol import Trial, conditions, trials
from tools.bench.closed_loop.routes import Route, crosses_wall, routes
from tools.bench.closed_loop.statistics import difference, interval, mean, resampled
from tools.bench.closed_loop.tables import MEANS, markdown, report
from tools.bench.closed_loop.trial import distance, drive

SCENE = "rescue_platform"
QUERY = 1


def made_up(method, scene, query, draw, success, eligible=True):
    return {
        "key": f"{scene}.{query}.{method}.{draw}", "scene": scene, "query": query, "method": method, "draw": draw,
        "controller": "vmc", "colliders": "all", "routed": True, "eligible": eligible, "success": success,
        "strict": success,
        "end": "arrived" if success else "stalled", "cause": "" if success else "wedged", "wall": query == 0,
        "time": 10.0,
        "length": 5.0, "rmse": 0.05 if method == "full" else 0.06, "contact": 0.1, "contact_housing": 0.1,
        "contact_trunk": 0.0,
        "contact_leg": 0.0, "slip": 0.2, "pitch95": 10.0, "roll95": 5.0, "cpu": 1.0, "simulated": 13.0,
    }  # fmt: skip


def study():
    """Native arrives for every other query, full for three of four."""
    cells = product(protocol.SCENES, range(10), range(2))
    return [
        made_up(method, scene, query, draw, query % 2 == 0 if method == "native" else query % 4 != 3)
        for scene, query, draw in cells
        for method in ("native", "full")
    ]


def test_all_methods_meet_the_same_friction_and_offset_and_draws_differ() -> None:
    all_of = trials(["native", "full"], ["vmc", "policy"], ["all"], [SCENE], 2)
    assert len({t.key for t in all_of}) == len(all_of) == 80
    given = {}
    for t in all_of:
        given.setdefault((t.query, t.draw), []).append(conditions(t))
    assert all(c == group[0] for group in given.values() for c in group)
    assert len({group[0]["friction"] for group in given.values()}) == 20
    values = np.array([list(group[0].values()) for group in given.values()])
    assert (values[:, 0] >= 0.6).all()
    assert (values[:, 0] <= 1.0).all()
    assert np.abs(values[:, 1:3]).max() <= 0.05
    assert 0.02 < np.abs(values[:, 3]).max() <= np.radians(5.0)


def test_a_wall_is_seen_under_the_line_and_a_ramp_is_none() -> None:
    scene = load_scene(SCENE)
    assert crosses_wall(scene, np.array([[4.0, 3.6], [4.0, 4.6]])), "through the border of the platform"
    assert not crosses_wall(scene, np.array([[1.0, 3.6], [4.5, 3.6]])), "up the ramp"
    assert not crosses_wall(scene, np.array([[2.0, 1.3], [7.0, 1.3]])), "over the curbs"


def test_distances_are_those_of_the_polyline() -> None:
    line = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 2.0]])
    points = np.array([[0.5, 0.3], [1.5, 1.0], [-0.3, -0.4], [1.0, 2.0], [0.8, 0.1]])
    np.testing.assert_allclose(distance(points, line), [0.3, 0.5, 0.5, 0.0, 0.1], atol=1e-12)


def test_resamples_draw_whole_queries_within_their_scene() -> None:
    scenes = {"a": np.array([[2.0, 2.0], [0.0, 2.0]]), "b": np.array([[2.0, 2.0]] * 3)}
    ratios = resampled(scenes)
    assert set(np.round(ratios * 5, 9)) == {3.0, 4.0, 5.0}, "scene b never varies, scene a by whole queries"
    assert mean(scenes) == pytest.approx(0.8)
    counts = [np.mean(np.isclose(ratios * 5, k)) for k in (3, 4, 5)]
    np.testing.assert_allclose(counts, [0.25, 0.5, 0.25], atol=0.02)


def test_a_paired_difference_that_never_varies_has_no_spread_and_eligibility_is_joint() -> None:
    records = study()
    found = difference(records, "full", "native", value=lambda r: r["rmse"])
    assert found is not None
    assert (found.value, found.low, found.high) == pytest.approx((-0.01, -0.01, -0.01))
    whole = difference(records, "full", "native")
    assert whole is not None
    assert whole.value == pytest.approx(0.8 - 0.5)
    assert 0.1 < whole.low < whole.least < whole.value < whole.high < 0.5
    assert whole.trials == 80
    some = [r | {"eligible": r["draw"] == 0} if r["method"] == "native" else r for r in records]
    joint = difference(some, "full", "native", counts=lambda r: r["eligible"])
    assert joint is not None
    assert joint.trials == 40
    assert difference(records, "mean-only", "native") is None
    low, high = interval([r for r in records if r["method"] == "native"])
    assert low < 0.5 < high


def test_the_tables_and_rows_tell_rates_bounds_walls_and_causes() -> None:
    records = study()
    text = markdown(records)
    assert "| native | 100.0 (80/80, >= 98.0) |" in text
    assert "**50.0 (40/80, >= 44.7)**" in text
    assert "full | +30.0 [" in text
    assert "| native | 4 | 100.0 (8/8, >= 81.8) | 44.4 (32/72, >= 38.9) |" in text
    assert "| native | 40 |" in text, "causes"
    rows = {r.key: r for r in report(records).rows}
    assert rows["vmc.all.full.rescue_steps.e2e"].value == 0.8
    assert rows["vmc.all.full.rescue_steps.e2e"].trials == 20
    assert rows["vmc.all.full.all.rmse"].value == pytest.approx(0.05)
    assert rows["simulated_per_cpu"].value == 13.0
    assert markdown([]) == "No trials.\n"


@pytest.fixture(scope="module")
def planned() -> dict[str, Route]:
    return {r.method: r for r in routes(SCENE, QUERY, ["native", "full", "guarded", "ours"], ["policy"])}


def test_variants_share_graph_and_ends_and_our_planner_has_the_real_ones(planned: dict[str, Route]) -> None:
    start, goal = load_scene(SCENE).pairs[QUERY]
    native, full = planned["native"], planned["full"]
    assert native.line[0] == full.line[0] == planned["guarded"].line[0]
    assert native.line[-1] == full.line[-1] == planned["guarded"].line[-1]
    assert 0.0 < np.hypot(*np.subtract(native.line[0], start)) <= 0.5
    np.testing.assert_allclose(planned["ours"].line[0], start, atol=1e-5)
    np.testing.assert_allclose(planned["ours"].line[-1], goal, atol=1e-5)
    assert len(planned["ours"].speed) == len(planned["ours"].line)
    assert not native.speed
    assert len(native.transitions) == len(native.vertices) - 1


def test_a_short_drive_arrives_and_its_record_does_not_depend_on_what_was_driven_before() -> None:
    line = [[x, 1.3] for x in np.arange(7.0, 7.7, 0.02).tolist()]
    route = Route(SCENE, 0, "native", "", line=line, length=0.7)
    trial = Trial(SCENE, 0, "native", "vmc", "all", 0)
    first = drive(trial, route)
    assert first["eligible"], first["why"]
    assert first["success"]
    assert first["strict"]
    assert 0.5 < first["time"] < 5.0
    assert first["rmse"] < 0.06
    assert first["contact"] == 0.0
    other = drive(replace(trial, draw=1), replace(route, line=line[:10], length=0.2))
    again = drive(trial, route)
    assert {k: v for k, v in first.items() if k != "cpu"} == {k: v for k, v in again.items() if k != "cpu"}
    assert other["friction"] != first["friction"]
    assert json.loads(json.dumps(first)) == first
    none = drive(trial, Route(SCENE, 0, "native", "", error="no route"))
    assert (none["routed"], none["eligible"], none["success"]) == (False, False, False)


def test_a_robot_put_on_a_wall_is_not_eligible() -> None:
    line = [[4.0, y] for y in np.arange(4.2, 4.7, 0.02).tolist()]
    record = drive(Trial(SCENE, 0, "native", "vmc", "all", 0), Route(SCENE, 0, "native", "", line=line))
    assert not record["eligible"]
    assert not record["success"]
    assert record["end"] == "not eligible"
    assert record["lift"] > 0.0


def test_a_study_goes_on_where_it_was_cut_off(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    driven: list[str] = []

    def quick(trial: Trial, route: Route, policy: str) -> dict[str, object]:
        driven.append(trial.key)
        return made_up(trial.method, trial.scene, trial.query, trial.draw, True) | {"key": trial.key}

    monkeypatch.setattr(bench, "drive", quick)
    monkeypatch.setattr(
        bench, "plan_query", lambda *a: {"routes": [vars_of(Route(a[0], a[1], m, "")) for m in a[2]]}
    )
    monkeypatch.setattr("tools.bench.closed_loop.pictures.draw", lambda *a: None)
    args = [
        "--out",
        str(tmp_path),
        "--controller",
        "vmc",
        "--scenes",
        SCENE,
        "--workers",
        "0",
        "--queries",
        "2",
    ]
    bench.run([*args, "--draws", "1"])
    assert len(driven) == 4
    with (tmp_path / "trials.jsonl").open("a") as file:
        file.write('{"key": "cut o')
    bench.run([*args, "--draws", "2"])
    assert len(driven) == len(set(driven)) == 8, "what was there was not driven again"
    lines = (tmp_path / "trials.jsonl").read_text().splitlines()
    assert len([json.loads(line) for line in lines]) == 8
    assert "8 trials, 2 draws" in (tmp_path / "tables.md").read_text()


@pytest.mark.campaign
def test_a_small_study_gives_the_same_numbers_with_two_workers_as_with_one(tmp_path: Path) -> None:
    args = ["--controller", "vmc", "--scenes", SCENE, "--queries", "2", "--draws", "1"]
    records, rows = {}, {}
    for workers in ("0", "2"):
        out = tmp_path / workers
        told = bench.run([*args, "--out", str(out), "--methods", "native,ours", "--workers", workers])
        rows = {row.key: row for row in told.rows}
        records[workers] = {
            r["key"]: {k: v for k, v in r.items() if k != "cpu"} for r in bench.read(out / "trials.jsonl")
        }
        planned = [(r["query"], r["method"], r["controller"]) for r in bench.read(out / "routes.jsonl")]
        assert sorted(planned) == sorted(
            (query, *line) for query in (0, 1) for line in (("native", ""), ("ours", "vmc"))
        )
        assert "4 trials" in (out / "tables.md").read_text()
        assert list(out.glob("*.png"))
    assert records["2"] == records["0"]
    wanted = trials(["native", "ours"], ["vmc"], ["all"], [SCENE], 1, 2)
    assert set(records["0"]) == {trial.key for trial in wanted}
    driven = [r for r in records["0"].values() if r["eligible"]]
    assert {r["method"] for r in driven} == {"native", "ours"}, "of each method one drove"
    for record in driven:
        assert record["simulated"] > protocol.SETTLE_TIME + record["time"] - 0.1 > protocol.SETTLE_TIME
        assert record["success"] == (record["end"] == "arrived") == (record["cause"] == "")
        assert all(isinstance(record[name], float) for name in MEANS)
    for method in ("native", "ours"):
        mine = [r for r in records["0"].values() if r["method"] == method]
        eligible = [r for r in mine if r["eligible"]]
        for scene in (SCENE, "all"):
            key = f"vmc.all.{method}.{scene}"
            hits = sum(r["success"] for r in mine)
            assert rows[f"{key}.coverage"].value == sum(r["routed"] for r in mine) / 2
            assert rows[f"{key}.eligible"].value == len(eligible) / 2
            assert (rows[f"{key}.e2e"].value, rows[f"{key}.e2e"].trials) == (hits / 2, 2)
            assert rows[f"{key}.conditional"].value == hits / len(eligible)
            for name in MEANS:
                assert rows[f"{key}.{name}"].value == pytest.approx(np.mean([r[name] for r in eligible]))


def vars_of(route: Route) -> dict[str, object]:
    return {name: getattr(route, name) for name in Route.__slots__}


def test_wrong_names_are_refused(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    for args, word in (
        (["--methods", "best"], "best"),
        (["--draws", "1"], "policy get go2w_rl_sar"),
        (["--controller", "vmc", "--queries", "41"], "1..40"),
    ):
        with pytest.raises(SystemExit):
            bench.run(["--out", "x", *args])
        assert word in capsys.readouterr().err


def test_the_stack_is_told_where_the_robot_stands_after_taking_its_stance() -> None:
    placed = (3.62, 0.79, 0.9)  # among posts: it turns while it stands up
    config = load(None, [], scene="rescue_steps", origin=placed)
    x, y, yaw = stack.stands(config, placed)
    assert 0.005 < np.hypot(x - placed[0], y - placed[1]) < 0.2
    with Lockstep(config.model_copy(update={"without": stack.WITHOUT})) as run:
        run.run_until(lambda: topics.ODOM in run.newest, 15.0, "odometry")
        run.run(0.5)
        truth, odom = run.newest[topics.TRUTH].pose.pose, run.newest[topics.ODOM].pose.pose
    along = np.exp(1j * yaw) * complex(odom.position.x, odom.position.y) + complex(x, y)
    assert abs(along - complex(truth.position.x, truth.position.y)) < 0.01
    assert yaw + yaw_of(odom.orientation) == pytest.approx(yaw_of(truth.orientation), abs=0.01)
