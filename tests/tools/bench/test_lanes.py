"""The lanes' bench: its table, its bounds, and one drive whose record is true."""

import json
from math import comb, isnan

import pytest

from hal.mujoco.sim import Simulation
from hal.scenes.lanes import lane
from tools.bench import goals
from tools.bench.lanes.table import table
from tools.bench.lanes.trial import Trial, Watch, drive
from tools.bench.records import numbers
from tools.bench.report import least_rate


def record(**fields):
    base = {
        "controller": "vmc", "map": "prior", "level": 1, "seed": 0, "outcome": "reached", "tried": False, "driven": 5.0,
        "shortest": 4.0, "time": 10.0, "wall_body": 0, "wall_wheels": 0, "simulated": 20.0, "cpu": 10.0,
        "raised": [],
    }  # fmt: skip
    return base | fields


def test_the_bound_of_a_rate_is_the_one_of_clopper_and_pearson() -> None:
    assert least_rate(10, 10) == pytest.approx(0.2**0.1, abs=1e-9)
    assert least_rate(0, 10) == 0.0
    for hits, trials in ((28, 30), (137, 200), (1, 5)):
        p = least_rate(hits, trials)
        tail = sum(comb(trials, k) * p**k * (1 - p) ** (trials - k) for k in range(hits, trials + 1))
        assert tail == pytest.approx(0.2, abs=1e-9)


def test_the_table_counts_by_controller_map_and_level() -> None:
    records = [record(seed=k, level=1 + k % 3) for k in range(9)]
    records += [
        record(seed=9, level=2, outcome="fell", wall_body=2),
        record(level=4, outcome="aborted", raised=["frozen LiDAR"]),
    ]
    records += [record(seed=k, level=5, outcome="refused", driven=0.0) for k in range(3)]
    records += [record(seed=3, level=5, outcome="fell", tried=True)]
    records += [record(map="seen", seed=0, level=1, time=25.0)]
    rows = {r.key: r for r in table(records).rows}
    assert (rows["lanes.vmc.prior.2.reached"].value, rows["lanes.vmc.prior.2.reached"].trials) == (0.75, 4)
    assert rows["lanes.vmc.prior.1-3.reached"].value == 0.9
    assert rows["lanes.vmc.prior.1-3.reached"].limit == 0.97
    assert not rows["lanes.vmc.prior.1-3.reached"].ok
    assert rows["lanes.vmc.prior.4.reached"].value == 0.0
    assert rows["lanes.vmc.prior.5.refused"].value == 0.75
    assert rows["lanes.vmc.prior.1-4.false_alarms"].value == pytest.approx(1 / 11)
    assert rows["lanes.vmc.prior.5.tried"].value == 0.25
    assert rows["lanes.vmc.prior.all.falls"].value == pytest.approx(2 / 15)
    assert rows["lanes.vmc.prior.all.falls"].bound == pytest.approx(1 - least_rate(13, 15))
    assert rows["lanes.vmc.prior.all.wall_body"].value == 2
    assert rows["lanes.vmc.prior.all.length"].value == 1.25
    assert rows["lanes.vmc.seen.all.time"].value == 2.5
    assert "lanes.vmc.prior.1-4.failed" not in rows, "these records tell no chance"
    told = {r.key: r for r in table([r | {"p_fail": 0.1} for r in records]).rows}
    assert told["lanes.vmc.prior.1-4.told_to_fail"].value == pytest.approx(0.1)
    assert (told["lanes.vmc.prior.1-4.failed"].value, told["lanes.vmc.prior.1-4.failed"].trials) == (
        2 / 11,
        11,
    )
    other = table([record(controller="jackal/drive"), record(controller="jackal/drive", outcome="fell")])
    rows = {r.key: r for r in other.rows}
    assert rows["lanes.jackal/drive.prior.1-3.reached"].value == 0.5
    assert rows["lanes.jackal/drive.prior.1-3.reached"].limit is None
    assert "of 4" in table(records).to_text()
    assert '"trials": 4' in table(records).to_json()


def test_the_table_of_goals_counts_by_scene_and_goal() -> None:
    outcomes = ["reached", "fell", "reached", "refused"]
    trials = [Trial(seed, 0, "vmc", "seen", goal="yard/a") for seed in range(4)]
    records = [
        record(key=x.key, outcome=o, time=10.0 * x.seed) for x, o in zip(trials, outcomes, strict=True)
    ]
    rows = {r.key: r for r in goals.table(records).rows}
    assert rows["goals.vmc.seen.yard.a.reached"].value == 0.5
    assert rows["goals.vmc.seen.yard.a.fell"].bound == pytest.approx(1 - least_rate(3, 4))
    assert rows["goals.vmc.seen.yard.a.refused"].trials == 4
    assert rows["goals.vmc.seen.yard.a.time"].value == 10.0
    assert trials[0].lane().scene.goals["a"][:2] == (-0.5, -4.4)


def test_no_trials_make_no_rate() -> None:
    report = table([])
    report.rate("x", 0, 0, 0.5)
    assert isnan(report.rows[0].value)
    assert not report.ok


def test_seeds_are_given_as_ranges_and_lists() -> None:
    assert numbers("0-2,7") == [0, 1, 2, 7]
    assert Trial(3, 4, "vmc", "prior").key == "vmc.prior.4.3"


def test_a_trial_of_chosen_elements_has_a_scene_and_a_key_of_its_own() -> None:
    trial = Trial(3, 4, "vmc", "prior", made_of="bars")
    assert trial.key == "vmc.prior.4.3.bars"
    assert trial.scene == "lanes:3,level=4,controller=vmc,map=bars"
    assert Trial(3, 4, "vmc", "prior").scene == "lanes:3,level=4,controller=vmc"


def test_a_robot_pushed_onto_a_wall_has_touched_it_and_one_on_a_bar_has_not() -> None:
    one = lane(0, level=1)
    sim = Simulation(one.scene.height, one.scene.resolution, one.scene.origin)
    sim.reset(one.scene.start[0], 0.0, settle=0.2)
    watch = Watch(one, sim)
    watch.look(0.0, None, None)
    assert watch.record()["wall_body"] == watch.record()["wall_wheels"] == 0
    sim.push((0.0, 400.0, 0.0), 1.0)
    for k in range(200):
        sim.step()
        watch.look(0.005 * k, None, None)
    assert watch.record()["wall_wheels"] + watch.record()["wall_body"] >= 1
    assert watch.record()["driven"] > 0.1


def test_a_record_can_be_written_and_says_whether_the_element_was_tried() -> None:
    one = lane(4, level=5)
    assert one.beyond is not None
    sim = Simulation(one.scene.height, one.scene.resolution, one.scene.origin)
    sim.reset(*one.scene.start, settle=0.0)
    watch = Watch(one, sim)
    watch.look(0.0, None, None)
    assert json.loads(json.dumps(watch.record()))["tried"] is False
    x0, _, y0, y1 = one.beyond
    sim.reset(x0 - 0.10, 0.5 * (y0 + y1), settle=0.0)
    watch.look(0.1, None, None)
    assert json.loads(json.dumps(watch.record()))["tried"] is True


def test_contacts_are_named_and_point_to_the_robot() -> None:
    one = lane(0, level=1)
    sim = Simulation(one.scene.height, one.scene.resolution, one.scene.origin)
    sim.reset(one.scene.start[0], 0.0)
    contacts = sim.contacts()
    assert set(contacts.bodies) == {f"{leg}_wheel" for leg in ("FR", "FL", "RR", "RL")}
    assert (contacts.normals[:, 2] > 0.9).all()
    assert abs(contacts.places[:, 2]).max() < 0.02


@pytest.mark.campaign
@pytest.mark.parametrize("seed", [7, 10])
def test_the_default_robot_does_not_fall_on_kerbs_at_its_limit(seed: int) -> None:
    end = drive(Trial(seed, 4, "hybrid", "prior", made_of="kerbs"))
    assert end["outcome"] == "reached"
    assert end["tilt"] < 40.0
