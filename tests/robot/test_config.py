"""Configuration: layers, and errors that name the key."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from rbtrg_robot.config import ConfigError, StackConfig, load


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
    ],
)
def test_wrong_keys_and_values_are_named(sets: list[str], named: str) -> None:
    with pytest.raises(ConfigError, match=named.replace(".", r"\.")):
        load(None, sets)


@pytest.mark.parametrize("text", ["a: [", "- 1\n- 2\n", "\x00"])
def test_a_file_that_is_no_configuration(tmp_path: Path, text: str) -> None:
    file = tmp_path / "c.yaml"
    file.write_text(text)
    with pytest.raises(ConfigError, match=r"c\.yaml"):
        load(file)
    with pytest.raises(ConfigError, match="cannot read"):
        load(tmp_path / "none.yaml")
