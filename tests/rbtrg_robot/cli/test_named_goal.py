"""A named goal of a scene asks for the heading that the scene gives it, and for none where it gives none."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from rbtrg_robot.cli.drive import _target
from rbtrg_robot.cli.stack import placed
from rbtrg_robot.config import ConfigError, load
from rbtrg_robot.stages.navigation.goal import goal_request


@pytest.mark.parametrize("words", [[], ["1"], ["1", "b"], ["1", "2", "3"], ["nowhere"]], ids=str)
def test_what_is_no_goal_is_told_what_a_goal_is(words: list[str]) -> None:
    with pytest.raises(ConfigError, match="a goal is X Y in metres or a NAME"):
        _target(words, lambda: ("flat", {}))


@pytest.mark.parametrize(("name", "asks"), [("a", True), ("far", False)])
def test_a_named_goal_without_a_heading_asks_for_none(name: str, asks: bool) -> None:
    x, y, yaw, called = _target([name], lambda: ("flat", {}))
    request = goal_request(0, "one", x, y, yaw, name=called)
    assert (request.name, request.has_yaw) == (name, asks)


def test_a_goal_is_found_from_another_folder_whoever_named_the_scene(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "site").mkdir()
    np.save(tmp_path / "site" / "dem.npy", np.zeros((40, 60), np.float32))
    (tmp_path / "site" / "stack.yaml").write_text("scene: dem.npy\nscene_options: {resolution: 0.1}\n")
    monkeypatch.chdir(tmp_path / "site")
    config = placed(load(Path("stack.yaml")))
    monkeypatch.chdir(tmp_path)
    x, y, _, name = _target(["far"], lambda: (config.scene, config.scene_options))
    assert name == "far"
    assert 0.0 < x < 6.0
    assert 0.0 < y < 4.0
    assert placed(load(scene="yard")).scene == "yard"
