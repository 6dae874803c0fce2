"""What tells why a study came out as it did, and the row that the whole stack drives."""

from __future__ import annotations

import json

import numpy as np
import pytest

from hal.scenes import load_scene
from tools.bench.closed_loop import lrc, protocol, stack
from tools.bench.closed_loop.cases import cases, end_of
from tools.bench.closed_loop.routes import Route
from tools.bench.closed_loop.why import costs, markdown

SCENE = "rescue_platform"


def step(body: float, risk: float = 0.0) -> dict[str, float]:
    return {"length": 1.0, "risk": risk, "body": body, "unknown": 0.5, "cost": 0.0}


def route(method: str, second: tuple[float, float], body: float) -> Route:
    vertices = [[0.0, 0.0], [1.0, 0.0], list(second), [3.0, 0.0]]
    return Route(
        SCENE, 0, method, "", line=vertices, vertices=vertices, length=3.0,
        transitions=[step(0.1), step(body), step(0.2)]
    )  # fmt: skip


def driven(method: str, draw: int, success: bool, x: float) -> dict[str, object]:
    """To `x` [m] at 0.5 m/s, then 10 s there."""
    trace = [
        [t, min(0.5 * t, x), 0.0, 0.3, 0.0, 0.0, 0.0, 0.5]
        for t in np.arange(0.0, 2.0 * x + 10.0, 0.2).tolist()
    ]
    return {
        "scene": SCENE, "query": 0, "method": method, "draw": draw, "controller": "policy", "colliders": "all",
        "success": success,
        "eligible": True, "end": "arrived" if success else "stalled", "cause": "" if success else "wedged",
        "time": 2.0 * x,
        "pitch95": 12.0, "contact_trunk": 0.25, "contact_leg": 0.0, "trace": trace,
    }  # fmt: skip


def test_a_lost_drive_is_laid_on_the_transition_where_it_ended() -> None:
    routes = [route("native", (2.0, 0.0), 2.5), route("full", (2.0, 1.0), 0.4)]
    records = [driven("native", 0, False, 1.5), driven("full", 0, True, 3.0)]
    records += [driven("native", 1, True, 3.0), driven("full", 1, True, 3.0)]
    records += [driven("full", 2, True, 3.0)]
    (case,) = cases(records, routes, ("native", "full"), ("policy", "all"))
    assert len(case.draws) == 2, "a draw that only one method drove is no pair"
    assert len(case.parted) == 1
    assert case.shared == 2
    end = end_of(records[0], routes[0])
    assert end is not None
    assert end.transition == 1
    assert end.place == pytest.approx((1.5, 0.0))
    assert end.time == pytest.approx(2.4, abs=0.21), "0.3 m before the place where it stayed"
    text = markdown([case], ("native", "full"))
    assert "| native | 1 | 1 | 2.50 | 0.20 | 0.40 | 1 |" in text
    assert f"## {SCENE} 0: native 1 of 2, full 2 of 2" in text
    assert "part at (1.00, 0.00)" in text
    assert (
        "draw 0: wedged after 2.4 s at (1.50, 0.00), transition 1; pitch up to 12 deg, trunk or legs touch 25 %"
        in text
    )
    assert not cases(
        records, [routes[0], route("full", (2.0, 0.0), 2.5)], ("native", "full"), ("policy", "all")
    )
    assert end_of({"trace": []}, routes[0]) is None


def test_a_transition_costs_more_under_full_by_its_body_risk_and_unknown_ground() -> None:
    native, full = costs(step(2.0, risk=0.1))
    assert native == pytest.approx(1.3)
    assert full == pytest.approx(1.3 + 2.0 + 0.5)


def test_the_stack_gets_the_survey_and_no_truth_as_its_map() -> None:
    ground, survey = (np.load(file) for file in stack.files(SCENE))
    scene = load_scene(SCENE)
    cells = round(protocol.APRON_WIDTH / scene.resolution)
    np.testing.assert_array_equal(ground["height"][cells:-cells, cells:-cells], scene.height)
    np.testing.assert_array_equal(survey["height"][cells:-cells, cells:-cells], scene.survey)
    assert np.isnan(survey["height"][:cells]).all()


def test_the_stack_drives_a_query_and_its_record_fits_the_tables(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(protocol, "TIME_BUDGET", 2.0)
    start, goal = load_scene(SCENE).pairs[3]
    record = stack.drive(
        protocol.Trial(SCENE, 3, "ours-mapped", "vmc", "all", 0),
        Route(SCENE, 3, "ours", "vmc", line=[list(start), list(goal)]),
    )
    assert (record["routed"], record["eligible"], record["success"], record["end"]) == (
        True,
        True,
        False,
        "timeout",
    )
    assert record["time"] == pytest.approx(2.0, abs=0.03)
    first, last = (np.array(record["trace"][k]) for k in (0, -1))
    assert np.abs(last[[1, 2, 4]] - first[[1, 2, 4]]).max() > 0.1, "it turned towards its path or drove"
    assert record["rmse"] is None
    assert json.loads(json.dumps(record))["told"]["state"] in ("planning", "moving")


def test_to_and_fro_counts_traverses_falls_and_interventions(monkeypatch: pytest.MonkeyPatch) -> None:
    xs = np.arange(7.0, 7.7, 0.02)
    way = Route(
        SCENE,
        0,
        "ours",
        "vmc",
        line=[[x, 1.3] for x in xs.tolist()],
        speed=[0.4] * 34 + [0.0],
        least=[0.1] * 35,
    )
    fro = lrc.back(way)
    assert (fro.line[0], fro.line[-1]) == (way.line[-1], way.line[0])
    assert fro.speed[0] == lrc.SLOWEST_SPEED
    assert fro.speed[1:] == [*[0.4] * 33, 0.0]
    driven = []

    def follow(driver, tracker, route):
        driven.append(route.line[0])
        lost = len(driven) == 2
        return {"success": not lost, "cause": "fall" if lost else ""}

    monkeypatch.setattr(lrc, "follow", follow)
    record = lrc.drive(protocol.Trial(SCENE, 0, "ours", "vmc", "all", 0), way)
    assert (record["traverses"], record["falls"], record["interventions"]) == (9, 1, 1)
    ends = [way.line[0], way.line[-1]]
    assert driven == [ends[0], ends[1], ends[1], *ends * 3, ends[0]], "the lost traverse is begun anew"
    rows = {r.key: r for r in lrc.report([record]).rows}
    assert rows[f"lrc.ours.{SCENE}.traverses"].value == 9
    assert (rows["lrc.ours.all.rate"].value, rows["lrc.ours.all.rate"].trials) == (0.9, 10)
    none = lrc.drive(
        protocol.Trial(SCENE, 0, "ours", "vmc", "all", 0), Route(SCENE, 0, "ours", "vmc", error="no route")
    )
    assert (none["traverses"], none["interventions"], none["why"]) == (0, 0, "no route")
