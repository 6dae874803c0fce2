"""Configuration: layers, and errors that name the key."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pytest
import yaml

from hal.contract import BackendError
from hal.envelope import stored
from hal.mujoco.config import SimConfig
from hal.types import Extrinsics, MountedLidar
from hal.unitree.config import UnitreeConfig
from mapping.odometry.own import OwnPart
from rbtrg_robot.config import ConfigError, StackConfig, load, of_log
from rbtrg_robot.hosts.robot import build
from rbtrg_robot.stages.planner import build as build_planner
from rbtrg_robot.wire.clock import SourceClock


def test_later_layers_win(tmp_path: Path) -> None:
    file = tmp_path / "c.yaml"
    file.write_text("seed: 1\nport: 8000\ntracker:\n  max_speed: 0.4\n")
    config = load(file, ["port=9000", "navigator.back_out=0.9"], seed=3, scene=None)
    assert (config.seed, config.port, config.scene) == (3, 9000, "yard")
    assert config.tracker.max_speed == 0.4
    assert config.navigator.back_out == 0.9


def test_what_is_shown_loads_again(tmp_path: Path) -> None:
    file = tmp_path / "c.yaml"
    file.write_text(load(None, ["elevation.resolution=0.05"]).to_yaml())
    again = load(file)
    assert again.elevation.resolution == 0.05
    assert yaml.safe_load(again.to_yaml()) == yaml.safe_load(file.read_text())
    assert StackConfig.model_validate(again.model_dump(mode="json")) == again


@pytest.mark.parametrize(
    ("sets", "named"),
    [
        (["trakcer.max_speed=1"], "trakcer"),
        (["tracker.max_sped=1"], "tracker.max_sped"),
        (["port=80"], "port"),
        (["seed=-1"], "seed"),
        (["port"], "a.b=c"),
        (["port.x.y=1", "port.x=[", ""], "port"),
        (["backend=gazebo"], "backend"),
        (["sim.seed=3"], "sim.seed"),
        (["sim.controller=policy"], "sim.controller"),
        (["planner.seed=3"], "planner.seed"),
        # A limit so long that it never trips is a check switched off.
        (["gate.guard_timeout=30"], "gate.guard_timeout"),
        (["gate.sensor_timeout.lidar=1e9"], "gate.sensor_timeout.lidar"),
        (["gate.max_tilt=3.2"], "gate.max_tilt"),
        (["gate.max_motor_temperature=1e6"], "gate.max_motor_temperature"),
        (["gate.moving_stop=1e6"], "gate.moving_stop"),
        (["backend=unitree", "without=[guard]"], "guard"),
        (["guard.reaction=1e-9"], "guard.reaction"),
        (
            ["backend=unitree", "unitree.max_vx=1.5", "guard.reaction=1.0", "guard.deceleration=0.5"],
            "guard.reaction",
        ),
        (["guard.margin=0"], "guard.margin"),
        (["gate.min_battery=0"], "gate.min_battery"),
        (["gate.future=1e9"], "gate.future"),
        (["gate.fence_horizon=1e-9"], "gate.fence_horizon"),
        (["odometry.health.gap_lost=1e9"], "odometry.health.gap_lost"),
        (["odometry.health.sigma_lost=1e9"], "odometry.health.sigma_lost"),
        (["odometry.health.overlap_lost=1e9"], "odometry.health.overlap_lost"),
        (["odometry.health.inliers_lost=1e9"], "odometry.health.inliers_lost"),
        (["body.width=0.1"], "body"),
        (["unitree.ignored_timeout=1e9"], "unitree.ignored_timeout"),
        (["guard.pose_timeout=1e6"], "guard.pose_timeout"),
        (["guard.window_timeout=1e6"], "guard.window_timeout"),
        (["guard.deceleration=1e6"], "guard.deceleration"),
        (["freshness.pose=.inf"], "freshness.pose"),
        (["freshness.map=1e6"], "freshness.map"),
        (["navigator.input_timeout=.inf"], "navigator.input_timeout"),
        (["unitree.state_timeout=.inf"], "unitree.state_timeout"),
        (["unitree.sport_timeout=1e6"], "unitree.sport_timeout"),
    ],
)
def test_wrong_keys_and_values_are_named(sets: list[str], named: str) -> None:
    with pytest.raises(ConfigError, match=named.replace(".", r"\.")):
        load(None, sets)


def test_one_key_of_a_group_leaves_the_defaults_of_the_others(tmp_path: Path) -> None:
    assert load(None, ["sim.noise=false"]).sim == StackConfig().sim.model_copy(update={"noise": False})
    assert load(None, ["tracker.lookahead=0.4"]).tracker.max_speed == StackConfig().tracker.max_speed
    file = tmp_path / "c.yaml"
    file.write_text("sim: {noise: false}\n")
    config = load(file)
    assert config.sim.lidar_step == StackConfig().sim.lidar_step != SimConfig().lidar_step


def test_obstacles_and_pushes_reach_the_processes_as_they_were_given() -> None:
    config = load(None, ["sim.obstacles=[{centre: [1, 0, 0.2], size: [0.2, 0.2, 0.4], appear: 3}]"])
    told = json.loads(json.dumps(config.model_dump(mode="json")))
    assert load(base=told) == config
    assert load(base=yaml.safe_load(config.to_yaml())).sim.obstacles[0].disappear == math.inf


def test_everything_random_follows_the_one_seed() -> None:
    config = load(None, ["seed=5"], scene="flat")
    assert build_planner(config)._map.seed == 5


def test_a_file_goes_over_what_a_log_was_made_with(tmp_path: Path) -> None:
    made = yaml.safe_load(load(None, ["elevation.resolution=0.05", "seed=4"]).to_yaml())
    made["elevation"]["gone_by_now"] = 3
    made["coffee"] = {"sugar": 1}
    base, unknown = of_log(yaml.safe_dump(made).encode())
    assert sorted(unknown) == ["coffee", "elevation.gone_by_now"]
    file = tmp_path / "c.yaml"
    file.write_text("tracker:\n  max_speed: 0.4\n")
    config = load(file, ["planner.variant=native"], base=base)
    assert (config.elevation.resolution, config.seed, config.tracker.max_speed) == (0.05, 4, 0.4)
    assert config.planner.variant == "native"
    made["tracker"]["max_speed"] = -1.0
    with pytest.raises(ConfigError, match=r"tracker\.max_speed"):
        load(base=of_log(yaml.safe_dump(made).encode())[0])


@pytest.mark.parametrize("text", ["a: [", "- 1\n- 2\n", "\x00"])
def test_a_file_that_is_no_configuration(tmp_path: Path, text: str) -> None:
    file = tmp_path / "c.yaml"
    file.write_text(text)
    with pytest.raises(ConfigError, match=r"c\.yaml"):
        load(file)
    with pytest.raises(ConfigError, match="cannot read"):
        load(tmp_path / "none.yaml")


def test_the_settings_of_the_real_robot_reach_its_backend(monkeypatch: pytest.MonkeyPatch) -> None:
    got: dict[str, Any] = {}

    def make_backend(
        interface: str, dry_run: bool, options: UnitreeConfig, clock: SourceClock, **_: str
    ) -> None:
        got.update(interface=interface, dry_run=dry_run, options=options, clock=clock)
        raise BackendError("no robot here")

    monkeypatch.setattr("hal.unitree.factory.make_backend", make_backend)
    sets = [
        "backend=unitree", "interface=eth7", "unitree.domain=3", "unitree.imu_yaw=1.57", "unitree.max_vx=0.5",
        "lidars=[{model: mid360, topic: rt/mid, mount: {translation: [0.1, 0, 0.2], rpy: [0, 0.3, 0]}}]",
    ]  # fmt: skip
    with pytest.raises(BackendError, match="no robot here"):
        build(load(None, sets), clock=SourceClock(77))
    assert (got["interface"], got["dry_run"], got["clock"].offset) == ("eth7", False, 77)
    options = got["options"]
    (lidar,) = options.lidars
    assert (options.topic(lidar), options.domain, options.imu_yaw, options.max_vx) == ("rt/mid", 3, 1.57, 0.5)
    assert options.mounted() == (
        MountedLidar("main", "mid360", Extrinsics((0.1, 0.0, 0.2), (0.0, 0.3, 0.0))),
    )
    assert options.capabilities().max_vx == 0.5


def test_mapping_and_backend_agree_on_where_the_lidar_is() -> None:
    sets = ["backend=unitree", "unitree.l1_yaw=-2.15"]
    for mount in ("", ", mount: {translation: [0.3, 0.0, 0.0], rpy: [0.0, 2.8, 0.1]}"):
        config = load(None, [*sets, f"lidars=[{{name: main}}, {{name: head, model: l1{mount}}}]"])
        main, head = config.mounted_lidars()
        assert (main, head) == config.unitree_options().capabilities().lidars
        assert (main.model, head.model) == ("xt16", "l1")
        assert abs(head.mount.rpy[2]) > 0.5


def test_every_robot_has_one_main_lidar() -> None:
    assert [lidar.name for lidar in load().lidars] == ["main", "head"]
    for wrong in ("[]", "[{name: head, model: l1}]", "[{name: main}, {name: main, model: l1}]"):
        with pytest.raises(ConfigError, match="lidars"):
            load(None, [f"lidars={wrong}"])


def test_the_lidars_of_a_real_robot_are_set_in_one_place() -> None:
    with pytest.raises(ConfigError, match=r"not `unitree\.lidars`"):
        load(None, ["unitree.lidars=[]"])
    config = load(None, ["lidars=[{name: main, model: l1}]"], backend="unitree", interface="lo")
    assert [lidar.model for lidar in config.unitree_options().lidars] == ["l1"]
    assert "lidars" not in yaml.safe_load(config.to_yaml())["unitree"]


@pytest.mark.parametrize(
    "area",
    [
        "[]",
        "[[0, 0], [1, 1]]",
        "[[.nan, 0], [1, 1], [2, 0]]",
        "[[0, 0], [1, 1], [0, 1], [1, 0]]",
        "[[1.0e+308, 0], [0, 1.0e+308], [-1.0e+308, 0]]",
    ],
)
def test_an_area_that_fences_nothing_is_refused(area: str) -> None:
    """An empty one meant no fence at all."""
    with pytest.raises(ConfigError, match="'area'"):
        load(sets=[f"area={area}"])


@pytest.mark.parametrize("value", [".nan", ".inf", "-.inf"])
@pytest.mark.parametrize("key", ["odometry.health.overlap_lost", "elevation.gate"])
def test_a_limit_that_is_no_number_is_refused(key: str, value: str) -> None:
    with pytest.raises(ConfigError, match=key):
        load(sets=[f"{key}={value}"])


@pytest.mark.parametrize("attached", [b"[1]", b"text", b"[", b"a: " + b"[" * 20_000, bytes(range(256))])
def test_a_log_with_a_broken_configuration_is_refused_in_words(attached: bytes) -> None:
    with pytest.raises(ConfigError, match="in the log"):
        of_log(attached)


def test_a_key_in_a_list_that_this_version_does_not_have_is_left_out() -> None:
    values, unknown = of_log(b"lidars: [{name: main, model: xt16, shape: round}]")
    assert unknown == ["lidars.0.shape"]
    assert load(base=values).lidars[0].model == "xt16"


@pytest.mark.parametrize(("model", "ahead"), [("go2w", 0.65), ("jackal", 0.55)])
def test_own_parts_stick_out_of_this_robot_by_thirty_centimetres_at_most(model: str, ahead: float) -> None:
    def parts(x: float) -> tuple[OwnPart, ...]:
        box = f"{{low: [0.3, -0.1, 0.0], high: [{x}, 0.1, 0.2]}}"
        return load(None, [f"own_parts=[{box}]"], robot_model=model).own_parts

    assert parts(ahead - 0.01)[0].high[0] == ahead - 0.01
    with pytest.raises(ConfigError, match=f"own_parts: a part of the robot lies within {ahead:.2f} m ahead"):
        parts(ahead + 0.02)


def test_at_the_motors_the_envelope_of_our_controller_counts() -> None:
    for level, whose in (("low", "hybrid"), ("sport", "sport")):
        config = load(None, ["backend=unitree", "interface=lo", f"unitree.level={level}"])
        assert config.envelope() is stored(whose)
