"""Robots are folders: what ours say of themselves holds, and nothing else of the product knows one of them."""

from __future__ import annotations

import ast
import re
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml

from hal.limbs import LEGS, MOTORS, wheel_centres, wheel_jacobians
from hal.named import NamedError
from hal.robots import DEFAULT, Robot, RobotError, describe, envelope_file, names, urdf
from hal.robots.check import findings
from hal.types import Extrinsics
from tests.places import ROOT

KNOWS = ("hal/robots", "hal/mujoco", "hal/unitree")
NAMES = re.compile(r"go2w?\b|jackal", re.IGNORECASE)


def words(tree: ast.AST) -> list[str]:
    """Names that code uses and texts that it holds, but not what docstrings tell."""
    told = {
        id(node.body[0].value)
        for node in ast.walk(tree)
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef)
        and node.body
        and isinstance(node.body[0], ast.Expr)
    } | {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    found = []
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom):
            found += [node.module or "", *(alias.name for alias in node.names)]
        elif isinstance(node, ast.Import):
            found += [alias.name for alias in node.names]
        elif isinstance(node, ast.Name):
            found.append(node.id)
        elif isinstance(node, ast.Attribute):
            found.append(node.attr)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in told:
            found.append(node.value)
    return found


@pytest.mark.parametrize("floor", ["hal", "mapping", "planning", "rbtrg_robot"])
def test_no_module_but_the_robots_and_the_backends_names_one(floor: str) -> None:
    named = {}
    for file in sorted((ROOT / floor).rglob("*.py")):
        place = file.relative_to(ROOT)
        found = [text for text in words(ast.parse(file.read_text())) if NAMES.search(text)]
        if found and not place.as_posix().startswith(KNOWS):
            named[place.as_posix()] = found
    # The name of a robot on the network, where nobody gives it another one.
    allowed = {"rbtrg_robot/scope.py": ["go2w"]}
    assert {place: found for place, found in named.items() if found != allowed.get(place)} == {}


@pytest.mark.parametrize("name", names())
def test_what_a_robot_says_of_itself_holds(name: str) -> None:
    robot = describe(name)
    assert [finding.words for finding in findings(robot) if finding.verdict == "wrong"] == []
    text = urdf(robot)
    assert all(f'joint name="{motor}"' in text for motor in MOTORS)
    for controller in robot.controllers:
        able = robot.capabilities(controller)
        assert (able.length, able.width) == (robot.body.length, robot.body.width)
        assert robot.envelope_file(controller).is_file()
        assert robot.lanes(controller).within["step"] <= able.max_step


def test_jacobians_are_the_derivatives_of_the_places() -> None:
    rng = np.random.default_rng(4)
    for name in names():
        limbs = describe(name).limbs
        q, step = rng.uniform(-0.8, 0.8, 16), 1e-6
        jacobian = wheel_jacobians(limbs, q)
        for leg in range(len(LEGS)):
            for joint in range(3):
                moved = q.copy()
                moved[3 * leg + joint] += step
                change = (wheel_centres(limbs, moved) - wheel_centres(limbs, q)) / step
                np.testing.assert_allclose(jacobian[leg, :, joint], change[leg], atol=1e-5)


# --- folders of others -----------------------------------------------------------------------------------------


def folder(tmp_path: Path, **changes: object) -> Path:
    """A copy of the second robot's description, changed."""
    values = yaml.safe_load((describe("jackal").folder / "robot.yaml").read_text())
    values["simulated"] = "hal.robots.jackal.simulated:JACKAL"
    for key, value in changes.items():
        if value is None:
            del values[key]
        else:
            values[key] = value
    (tmp_path / "robot.yaml").write_text(yaml.safe_dump(values))
    return tmp_path


def test_a_folder_is_a_robot(tmp_path: Path) -> None:
    place = folder(tmp_path, name="mine", title="Mine")
    robot = describe(str(place))
    assert (robot.name, robot.folder) == ("mine", place)
    assert envelope_file(f"{place}/drive") == place / "drive.envelope.json"
    told = {finding.verdict: finding.words for finding in findings(robot)}
    assert "drive: no envelope at" in told["wrong"]
    assert "python -m tools.bench envelope --robot-model" in told["wrong"]


def test_a_copied_folder_is_a_robot_of_its_own(tmp_path: Path) -> None:
    """Whatever its name, wherever it lies, and beside ours."""
    copy = tmp_path / "my robot"
    shutil.copytree(describe("jackal").folder, copy, ignore=shutil.ignore_patterns("__pycache__"))
    for file, ours, mine in (
        ("robot.yaml", "name: jackal", "name: mine"),
        (
            "simulated.py",
            "WHEEL_TORQUE, FASTEST_WHEEL = 8.0, 22.0",
            "WHEEL_TORQUE, FASTEST_WHEEL = 9.0, 22.0",
        ),
        ("drive.py", "HOLD_KP = 60.0", "HOLD_KP = 70.0"),
    ):
        text = (copy / file).read_text()
        assert ours in text
        (copy / file).write_text(text.replace(ours, mine))
    mine, ours = describe(str(copy)).model(), describe("jackal").model()
    assert (mine.torque_limit.max(), ours.torque_limit.max()) == (9.0, 8.0)
    holds = [
        sys.modules[type(robot.controller("drive", "", 0.005)).__module__].HOLD_KP for robot in (mine, ours)
    ]
    assert holds == [70.0, 60.0], "its parts import each other"
    assert [f.words for f in findings(describe(str(copy))) if f.verdict == "wrong"] == []
    (copy / "drive.py").unlink()
    broken = describe(str(copy.rename(tmp_path / "broken")))
    with pytest.raises(NamedError, match=r"\.simulated:JACKAL: .*drive.*; it is looked for in"):
        broken.model()


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"limbs": None}, "limbs: Field required"),
        ({"wings": 2}, "wings: Extra inputs are not permitted"),
        ({"moves": ["FR_wheel", "tail"]}, "tail is no joint; there are FR_hip"),
        ({"mounts": {}}, "mounts: say where the vlp16 sits"),
        ({"simulated": ""}, "simulated: name what MuJoCo builds it from"),
        (
            {"controllers": {"drive": {"what": "x", "envelope": "e", "capabilities": {"max_z": 1.0}}}},
            "'max_z' is no field",
        ),
    ],
)
def test_a_wrong_description_is_told_with_its_file_and_what_is_wrong(
    tmp_path: Path, changes: dict[str, object], words: str
) -> None:
    with pytest.raises(RobotError) as error:
        describe(str(folder(tmp_path, **changes)))
    assert str(tmp_path / "robot.yaml") in str(error.value)
    assert words in str(error.value)


def test_who_names_no_robot_of_ours_and_no_folder_reads_which_there_are(tmp_path: Path) -> None:
    with pytest.raises(
        RobotError, match=r"no robot 'rover': use .*go2w.*, or a folder that holds robot.yaml"
    ):
        describe("rover")
    (tmp_path / "robot.yaml").write_text("- a list")
    with pytest.raises(RobotError, match="must hold `key: value` lines"):
        describe(str(tmp_path))


def test_a_robot_without_a_model_cannot_be_simulated(tmp_path: Path) -> None:
    with pytest.raises(RobotError, match="cannot be simulated"):
        describe(str(folder(tmp_path, simulated="", backends=["mine"]))).model()


def test_lidars_sit_where_is_said_else_where_the_robot_usually_carries_them() -> None:
    robot: Robot = describe(DEFAULT)
    own = Extrinsics((0.1, 0.0, 0.3))
    placed = robot.mounted((robot.lidars[0], robot.lidars[1].model_copy(update={"mount": own})))
    assert [lidar.mount for lidar in placed] == [robot.mounts["xt16"], own]
