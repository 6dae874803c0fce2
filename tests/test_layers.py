"""The house has five floors: no file imports from a floor above its own, and heavy imports stay where they belong."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
FLOORS = {"hal": 0, "mapping": 1, "planning": 2, "rbtrg_robot": 3, "tools": 4}
FILES = [f for floor in FLOORS for f in sorted((ROOT / floor).rglob("*.py"))]
FORBIDDEN_IN_LIBRARIES = {"zenoh", "mcap", "typer", "rosbags", "rich", "subprocess", "multiprocessing"}

ALLOWED = {"hal/unitree/guardian.py": {"subprocess"}, "hal/mujoco/render.py": {"subprocess"}}
"""A robot that keeps the last velocity for a second can only be stopped by somebody who outlives its driver; and whether EGL works can
only be tried in a process that is thrown away."""


def imported(file: Path) -> set[str]:
    """Top-level names of all absolute imports of a file."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            names.add(node.module.split(".")[0])
    return names


@pytest.mark.parametrize("file", FILES, ids=lambda f: str(f.relative_to(ROOT)))
def test_imports_only_from_floors_below(file: Path) -> None:
    own = FLOORS[file.relative_to(ROOT).parts[0]]
    climbing = {name for name in imported(file) if FLOORS.get(name, -1) > own}
    assert not climbing


@pytest.mark.parametrize("floor", ["hal", "mapping", "planning"])
def test_libraries_know_nothing_of_the_middleware(floor: str) -> None:
    for file in (ROOT / floor).rglob("*.py"):
        allowed = ALLOWED.get(str(file.relative_to(ROOT)), set())
        assert not imported(file) & FORBIDDEN_IN_LIBRARIES - allowed, file


def test_planning_never_imports_a_simulator() -> None:
    for file in (ROOT / "planning").rglob("*.py"):
        assert not imported(file) & {"mujoco", "open3d"}, file


def test_no_stage_listens_to_ground_truth() -> None:
    for file in (ROOT / "rbtrg_robot" / "stages").rglob("*.py"):
        text = file.read_text()
        for line in text.splitlines():
            assert not ("TRUTH" in line and "inputs" in line), file
