"""Kept kernels after an upgrade in place: none with something in it that is no longer there."""

from __future__ import annotations

import ast
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from hal.kernel_cache import PACKAGES, file_of, imported
from tests.places import ROOT

FILES = {
    "hal/size.py": "WIDTH = 3\n",
    "hal/leg.py": "from numba import njit\n\n@njit(cache=True)\ndef leg(x):\n    return x + 1\n",
    "hal/other.py": "SOMETHING = 1\n",
    "mapping/body.py": (
        "from numba import njit\n\nfrom hal import (\n    leg,\n    size,\n)\n\nstep, width = leg.leg, size.WIDTH\n\n"
        "@njit(cache=True)\ndef body(x):\n    return step(x) * width\n"
    ),
    "planning/robot.py": "from numba import njit\n\nfrom mapping.body import body\n\n@njit(cache=True)\ndef "
    "robot(x):\n    return body(x)\n",
}


@pytest.fixture
def installed(tmp_path: Path) -> Path:
    """A small installation, its kernels kept in NUMBA_CACHE_DIR."""
    for name in (
        "hal/__init__.py",
        "hal/kernel_cache.py",
        "hal/compiler.py",
        "hal/errors.py",
        "mapping/__init__.py",
    ):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        if (ROOT / name).exists():
            shutil.copy(ROOT / name, tmp_path / name)
    for name, source in FILES.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(source)
    shutil.copy(ROOT / "planning" / "__init__.py", tmp_path / "planning")
    shutil.copy(ROOT / "planning" / "errors.py", tmp_path / "planning")
    return tmp_path


def environment(home: Path, **more: str) -> dict[str, str]:
    return {"PATH": "", "PYTHONPATH": str(home), "HOME": str(home), "PYTHONDONTWRITEBYTECODE": "1", **more}


def run(home: Path, script: str) -> list[str]:
    done = subprocess.run(
        [sys.executable, "-c", script],
        cwd=home,
        env=environment(home),
        capture_output=True,
        text=True,
        check=True,
        timeout=120,
    )
    return done.stdout.split()


FORKS = """
import os, sys
import numba
numba.njit(lambda x: x * 2 + 1)(1)
for script in sys.stdin:
    pid = os.fork()
    if not pid:
        exec(script)
        sys.stdout.flush()
        os._exit(0)
    os.waitpid(pid, 0)
"""
"""A process for each line: they share the import and the first steps of numba, which take longer than the rest."""


@contextmanager
def processes(home: Path, **more: str) -> Iterator[Callable[[str], list[str]]]:
    """What a line of Python says in a process of its own."""
    with subprocess.Popen(
        [sys.executable, "-c", FORKS],
        cwd=home,
        env=environment(home, **more),
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as server:

        def say(script: str) -> list[str]:
            assert server.stdin is not None
            assert server.stdout is not None
            print(script, file=server.stdin, flush=True)
            return server.stdout.readline().split()

        yield say


ASK = "from planning.robot import robot; print(robot(4), sum(robot.stats.cache_hits.values()))"


@pytest.mark.parametrize(
    "kept_in", [pytest.param("NUMBA_CACHE_DIR", marks=pytest.mark.campaign), "beside the sources"]
)
def test_a_kept_kernel_is_compiled_anew_when_what_it_calls_or_freezes_has_changed(
    installed: Path, kept_in: str
) -> None:
    where = {"NUMBA_CACHE_DIR": str(installed / "cache")} if kept_in == "NUMBA_CACHE_DIR" else {}
    with processes(installed, **where) as say:
        assert say(ASK) == ["15", "0"]
        (installed / "hal/other.py").write_text("SOMETHING = 2\n")
        assert say(ASK) == ["15", "1"]
        (installed / "hal/leg.py").write_text(FILES["hal/leg.py"].replace("+ 1", "+ 2"))
        assert say(ASK) == ["18", "0"]
        assert say(ASK) == ["18", "1"]
        (installed / "hal/size.py").write_text("WIDTH = 5\n")
        assert say(ASK) == ["30", "0"]
        assert say(ASK) == ["30", "1"]
    assert bool(list(installed.rglob("__pycache__/*.nbi"))) is (kept_in != "NUMBA_CACHE_DIR")


UPGRADE = (
    "from pathlib import Path; from hal.leg import leg; leg(1); file = Path('hal/leg.py'); "
    "file.write_text(file.read_text().replace('+ 1', '+ 2')); "
    "from planning.robot import robot; print(robot(4))"  # compiled with the old one, which this process holds
)


def test_a_process_that_runs_through_an_upgrade_leaves_no_stale_kernel(installed: Path) -> None:
    with processes(installed) as say:
        assert say(UPGRADE) == ["15"]
        assert say(ASK) == ["18", "0"]


@pytest.mark.parametrize("first", ["numba", "planning.robot"])
def test_whatever_is_imported_first_the_kernels_are_stamped(installed: Path, first: str) -> None:
    (name,) = run(
        installed,
        f"import {first}; from mapping.body import body; print(type(body._cache._impl.locator).__module__)",
    )
    assert name == "hal.kernel_cache"


@pytest.mark.parametrize("package", ["hal", "mapping", "planning"])
def test_each_package_names_the_stamps_before_numba_is_there(installed: Path, package: str) -> None:
    named, loaded = run(
        installed,
        f"import os, sys, {package}; print(os.environ['NUMBA_CACHE_LOCATOR_CLASSES'], 'numba' in sys.modules)",
    )
    assert named.startswith("hal.kernel_cache.")
    assert loaded == "False"


def test_every_import_of_a_file_with_kernels_is_seen() -> None:
    """The oracle reads the syntax tree; under `if`, `try` or in a function no kernel may get what it calls."""
    files = [f for package in PACKAGES for f in (ROOT / package).rglob("*.py") if "njit" in f.read_text()]
    assert len(files) > 50
    for file in files:
        needed = set()
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.ImportFrom) and not node.level and node.module:
                needed |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
            elif isinstance(node, ast.Import):
                needed |= {alias.name for alias in node.names}
            assert not (isinstance(node, ast.ImportFrom) and node.level), f"{file} imports relatively"
        ours = {file_of(name) for name in needed if name.split(".")[0] in PACKAGES} - {None}
        assert {file_of(name) for name in imported(file.read_text())} - {None} == ours, file
