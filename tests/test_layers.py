"""The house: which room may import which. The table is the plan; a file in the wrong room fails here."""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path

import pytest

from rbtrg_robot import topics as t
from rbtrg_robot.config import load
from rbtrg_robot.hosts.lockstep import build_stages
from rbtrg_robot.processes import PROCESSES
from tests.places import ROOT

ROOMS: dict[str, str] = {
    # room: the rooms it may import, beside itself; a room stands below all that import it
    "hal.safety.monitors": "",
    "hal.safety.slope": "",
    "hal": "hal.safety.monitors",
    "hal.safety": "hal hal.safety.monitors hal.safety.slope",
    "hal.lidar": "hal",
    "hal.robots": "hal hal.lidar",
    "hal.envelope": "hal hal.robots",
    "hal.scenes": "hal hal.lidar hal.robots",
    "hal.postures": "hal",
    "hal.mujoco.robot": "hal hal.lidar hal.postures",
    "hal.robots.go2w": "hal hal.lidar hal.robots hal.postures hal.mujoco.robot",
    "hal.robots.jackal": "hal hal.lidar hal.robots hal.mujoco.robot",
    "hal.robots.go2": "hal hal.lidar hal.robots hal.postures hal.mujoco.robot",
    "hal.mujoco": "hal hal.lidar hal.robots hal.scenes hal.postures hal.mujoco.robot",
    "hal.robots.check": "hal hal.envelope hal.robots hal.mujoco",
    "hal.mujoco.view": "hal hal.scenes hal.robots hal.mujoco",
    "hal.unitree": "hal hal.lidar hal.robots hal.robots.go2w hal.postures hal.safety.monitors hal.safety.slope",
    "mapping": "hal",  # which says where numba keeps kernels
    "mapping.odometry.registration": "hal",
    "mapping.odometry": "hal hal.robots hal.safety.monitors mapping.odometry.registration",
    "mapping.relocalise": "hal mapping",
    "mapping.elevation": "hal hal.robots hal.lidar hal.safety.monitors hal.scenes mapping",
    "mapping.closing": "hal mapping mapping.elevation mapping.relocalise",
    "planning": "hal",
    "planning.graph": "hal hal.envelope mapping planning",
    "planning.risk": "hal mapping planning planning.graph",
    # turns are made, and a path backward ends, where the guard would let the robot and hold it: one rule
    "planning.search": "hal hal.safety mapping planning planning.graph planning.risk",
    "planning.path": "hal hal.safety mapping planning planning.graph planning.risk planning.search",
    "planning.tracking": "hal planning",
    "rbtrg_robot": "hal hal.envelope hal.robots hal.lidar hal.mujoco hal.safety hal.scenes hal.unitree "
    "mapping mapping.elevation mapping.odometry "
    "planning.graph planning.risk planning.tracking",
    "rbtrg_robot.wire": "hal hal.safety.monitors mapping mapping.elevation rbtrg_robot",
    "rbtrg_robot.access": "hal rbtrg_robot rbtrg_robot.wire",
    "rbtrg_robot.stages.stage": "rbtrg_robot",
    "rbtrg_robot.stages.navigation": "hal hal.safety hal.safety.monitors rbtrg_robot rbtrg_robot.wire "
    "rbtrg_robot.stages.stage",
    "rbtrg_robot.stages.mission": "hal rbtrg_robot rbtrg_robot.wire rbtrg_robot.stages.stage "
    "rbtrg_robot.stages.navigation",
    "rbtrg_robot.stages": "hal hal.robots hal.safety hal.safety.monitors mapping "
    "mapping.closing mapping.elevation mapping.odometry mapping.relocalise planning planning.graph "
    "planning.path "
    "planning.risk planning.search planning.tracking rbtrg_robot rbtrg_robot.wire rbtrg_robot.stages.stage "
    "rbtrg_robot.stages.navigation",
    "rbtrg_robot.missions": "hal rbtrg_robot rbtrg_robot.stages.mission",
    "rbtrg_robot.orders": "hal mapping.elevation rbtrg_robot rbtrg_robot.wire rbtrg_robot.stages.navigation "
    "rbtrg_robot.missions",
    "rbtrg_robot.bridge": "hal rbtrg_robot rbtrg_robot.wire rbtrg_robot.orders",
    "rbtrg_robot.log": "hal hal.scenes mapping.elevation hal.mujoco.view rbtrg_robot rbtrg_robot.wire",
    "rbtrg_robot.importer": "hal mapping hal.lidar hal.unitree rbtrg_robot rbtrg_robot.wire rbtrg_robot.log",
    "rbtrg_robot.hosts": "hal hal.scenes mapping mapping.closing mapping.elevation mapping.odometry planning "
    "planning.path planning.risk hal.mujoco hal.mujoco.view hal.safety hal.unitree rbtrg_robot "
    "rbtrg_robot.wire "
    "rbtrg_robot.stages.stage rbtrg_robot.stages.navigation rbtrg_robot.stages rbtrg_robot.log",
    "rbtrg_robot.process": "hal hal.safety hal.safety.monitors hal.unitree rbtrg_robot rbtrg_robot.wire "
    "rbtrg_robot.access rbtrg_robot.stages.stage rbtrg_robot.stages.navigation rbtrg_robot.stages.mission "
    "rbtrg_robot.log rbtrg_robot.hosts",
    "rbtrg_robot.console": "hal hal.safety mapping mapping.elevation rbtrg_robot rbtrg_robot.wire rbtrg_robot.access "
    "rbtrg_robot.stages.navigation rbtrg_robot.missions rbtrg_robot.orders rbtrg_robot.log rbtrg_robot.hosts "
    "rbtrg_robot.process",
    "rbtrg_robot.cli": "hal hal.robots.check hal.robots hal.mujoco.view hal.scenes hal.unitree "
    "mapping.elevation planning.search rbtrg_robot "
    "rbtrg_robot.wire rbtrg_robot.access rbtrg_robot.stages.navigation rbtrg_robot.missions "
    "rbtrg_robot.bridge rbtrg_robot.orders rbtrg_robot.log rbtrg_robot.importer rbtrg_robot.hosts "
    "rbtrg_robot.process "
    "rbtrg_robot.console",
}
FLOORS = ("hal", "mapping", "planning", "rbtrg_robot", "tools")
FILES = [f.relative_to(ROOT) for floor in FLOORS for f in sorted((ROOT / floor).rglob("*.py"))]
OUTSIDE = {"zenoh", "mcap", "typer", "rosbags", "rich", "subprocess", "multiprocessing"}
"""What the libraries (hal, mapping, planning) know nothing of."""
EXCEPT = {
    "hal/unitree/guardian.py": {"subprocess"},
    "hal/unitree/low/handle.py": {"subprocess"},
    "hal/unitree/low/process.py": {"subprocess"},
    "hal/mujoco/view/render.py": {"subprocess"},
}
"""A robot that keeps the last velocity for a second can only be stopped by somebody who outlives its driver; and
whether EGL works can only be tried in a process that is thrown away. A robot that balances by our commands needs a loop
that waits for nobody."""


def module_of(file: Path) -> str:
    """Dotted name of a file."""
    return ".".join(file.with_suffix("").parts).removesuffix(".__init__")


MODULES = {module_of(file) for file in FILES}


@cache
def imported(file: Path) -> tuple[str, ...]:
    """Dotted names of all absolute imports of a file, submodules resolved."""
    found = []
    for node in ast.walk(ast.parse((ROOT / file).read_text())):
        if isinstance(node, ast.Import):
            found += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            for alias in node.names:
                full = f"{node.module}.{alias.name}"
                found.append(full if full in MODULES else node.module)
    return tuple(found)


def room_of(module: str, rooms: dict[str, str] = ROOMS) -> str:
    """The room with the longest name that holds a module; empty for one of no room."""
    return max((r for r in rooms if module == r or module.startswith(f"{r}.")), key=len, default="")


def test_the_plan_is_a_stack() -> None:
    below: set[str] = set()
    for room, allowed in ROOMS.items():
        assert set(allowed.split()) <= below, f"{room} imports from above"
        below.add(room)


@pytest.mark.parametrize("file", FILES, ids=str)
def test_a_file_imports_from_its_room_and_those_below(file: Path) -> None:
    module = module_of(file)
    room = room_of(module)
    if file.parts[0] == "tools":
        return  # the top floor; nothing else may import it, which the rooms below say
    assert room, f"{file} is in no room of the plan"
    allowed = {room, *ROOMS[room].split()}
    for name in imported(file):
        if name.split(".")[0] in FLOORS:
            assert room_of(name) in allowed, f"{file} imports {name}"


def test_no_wall_of_the_plan_is_open_without_need() -> None:
    used: dict[str, set[str]] = {room: set() for room in ROOMS}
    for file in FILES:
        if file.parts[0] != "tools":
            used[room_of(module_of(file))] |= {room_of(name) for name in imported(file)}
    for room, allowed in ROOMS.items():
        assert not set(allowed.split()) - used[room], f"{room} may import what it does not need"


@pytest.mark.parametrize("floor", ["hal", "mapping", "planning"])
def test_libraries_know_nothing_of_the_middleware(floor: str) -> None:
    for file in FILES:
        if file.parts[0] == floor:
            names = {name.split(".")[0] for name in imported(file)}
            assert not names & OUTSIDE - EXCEPT.get(str(file), set()), file


def test_planning_never_imports_a_simulator() -> None:
    for file in FILES:
        if file.parts[0] == "planning":
            assert not {name.split(".")[0] for name in imported(file)} & {"mujoco", "open3d"}, file


def test_no_stage_is_given_the_truth() -> None:
    config = load(None, [], scene="flat")
    stages = build_stages(config, [p.name for p in PROCESSES if p.hosted])
    assert len(stages) >= 5
    for name, (stage, _period) in stages.items():
        assert t.TRUTH not in stage.inputs, name
        assert t.TRUTH not in stage.outputs, name
        stage.close()


def test_files_import_each_other_without_a_circle() -> None:
    needs = {module_of(f): {n for n in imported(f) if n in MODULES} for f in FILES}
    done: set[str] = set()

    def visit(module: str, path: tuple[str, ...]) -> None:
        assert module not in path, " -> ".join((*path, module))
        if module not in done:
            for other in needs[module] - {module}:
                visit(other, (*path, module))
            done.add(module)

    for module in needs:
        visit(module, ())
