"""Whether everything installs from wheels alone, on the robot's computer and on a desk, and how much is downloaded.

    python -m tools.resolve

uv resolves the project once for all platforms, in a folder that is thrown away; then each machine and each Python must
find a wheel of every package. No package is downloaded. Exit status 1 names what has no wheel; 3 says that uv could not
resolve, because the package index does not answer or the versions contradict each other.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from packaging.markers import Marker
from packaging.tags import Tag, compatible_tags, cpython_tags
from packaging.utils import parse_wheel_filename

ROOT = Path(__file__).parents[1]
PYTHONS = ("3.11", "3.12", "3.13")
MACHINES: tuple[tuple[str, int, str, tuple[str, ...]], ...] = (
    # processor, glibc 2.x, what, extras and groups beside the mandatory packages
    ("aarch64", 31, "JetPack 5: robot", ()),
    ("aarch64", 31, "JetPack 5: robot, simulator, tests", ("sim", "dev")),
    ("aarch64", 35, "JetPack 6: robot", ()),
    ("aarch64", 35, "JetPack 6: robot, simulator with open3d, tests", ("sim", "mesh", "dev")),
    ("x86_64", 31, "Ubuntu 20.04: robot, DDS", ("unitree",)),
    ("x86_64", 35, "Ubuntu 22.04: robot, DDS", ("unitree",)),
    ("x86_64", 35, "Ubuntu 22.04: what `uv sync` installs", ("sim", "dev")),
)
Package = dict[str, Any]


@dataclass(frozen=True, slots=True)
class Answer:
    """One machine with one Python."""

    packages: int
    megabytes: float
    """Of the wheels."""
    missing: tuple[str, ...]
    """Packages without a wheel, "name version"."""


class Unresolved(Exception):
    """uv gave no resolution; the message is its own."""


def lock() -> list[Package]:
    """Every package that any platform installs, with its wheels, as in `uv.lock`. Raises Unresolved."""
    with tempfile.TemporaryDirectory() as folder:
        shutil.copy(ROOT / "pyproject.toml", folder)
        if (ROOT / "uv.lock").exists():
            shutil.copy(ROOT / "uv.lock", folder)
        try:
            done = subprocess.run(
                ["uv", "lock", "--quiet"],
                cwd=folder,
                capture_output=True,
                text=True,
                timeout=50.0,
                check=False,
            )
        except FileNotFoundError as error:
            raise Unresolved("uv is not installed") from error
        except subprocess.TimeoutExpired as error:
            raise Unresolved("the package index did not answer in 50 s") from error
        if done.returncode != 0:
            raise Unresolved(done.stderr.strip() or f"uv ended with {done.returncode}")
        packages: list[Package] = tomllib.loads(Path(folder, "uv.lock").read_text())["package"]
    return packages


def tags(machine: str, glibc: int, python: str) -> frozenset[Tag]:
    """The wheel tags that pip accepts there."""
    version = tuple(int(part) for part in python.split("."))
    platforms = [f"manylinux_2_{minor}_{machine}" for minor in range(glibc, 4, -1)]
    platforms += [f"manylinux2014_{machine}", f"linux_{machine}"]
    if machine == "x86_64":  # the old names of glibc 2.12 and 2.5 (PEP 600)
        platforms += ["manylinux2010_x86_64", "manylinux1_x86_64"]
    interpreter = f"cp{python.replace('.', '')}"
    return frozenset(cpython_tags(version, platforms=platforms)) | frozenset(
        compatible_tags(version, interpreter=interpreter, platforms=platforms)
    )


def needed(packages: list[Package], extras: tuple[str, ...], machine: str, python: str) -> Iterator[Package]:
    """The packages installed there, each once; the project itself is not among them."""
    environment = {
        "python_version": python,
        "python_full_version": f"{python}.0",
        "platform_machine": machine,
        "sys_platform": "linux",
        "os_name": "posix",
        "platform_system": "Linux",
        "platform_python_implementation": "CPython",
        "implementation_name": "cpython",
    }
    root = next(p for p in packages if "editable" in p["source"] or "virtual" in p["source"])
    done: set[tuple[str, str, str]] = set()
    open_: list[tuple[Package, str]] = [(root, part) for part in ("", *extras)]
    given: set[int] = {id(root)}
    while open_:
        package, part = open_.pop()
        if (package["name"], package["version"], part) in done:
            continue
        done.add((package["name"], package["version"], part))
        if id(package) not in given:
            given.add(id(package))
            yield package
        lines = package.get("dependencies", []) if not part else None
        if lines is None:
            lines = package.get("optional-dependencies", {}).get(part, [])
            lines = lines + package.get("dev-dependencies", {}).get(part, [])
        for line in lines:
            if "marker" in line and not Marker(line["marker"]).evaluate(environment):
                continue
            chosen = [
                p
                for p in packages
                if p["name"] == line["name"] and line.get("version", p["version"]) == p["version"]
            ]
            assert len(chosen) == 1, f"{line['name']}: uv.lock is not understood"
            open_ += [(chosen[0], part) for part in ("", *line.get("extra", ()))]


def examine(
    packages: list[Package], extras: tuple[str, ...], machine: str, glibc: int, python: str
) -> Answer:
    """Whether each package has a wheel there, and the size of those wheels."""
    accepted = tags(machine, glibc, python)
    count, size, missing = 0, 0, []
    for package in needed(packages, extras, machine, python):
        count += 1
        fitting = [
            wheel
            for wheel in package.get("wheels", [])
            if parse_wheel_filename(wheel["url"].rsplit("/", 1)[1])[3] & accepted
        ]
        if fitting:
            size += min(wheel.get("size", 0) for wheel in fitting)
        else:
            missing.append(f"{package['name']} {package['version']}")
    return Answer(count, size / 1e6, tuple(sorted(missing)))


def main() -> int:
    """One line per machine and Python."""
    try:
        packages = lock()
    except Unresolved as error:
        print(f"NOT CHECKED: {error}", file=sys.stderr)
        return 3
    failed = False
    for machine, glibc, what, extras in MACHINES:
        for python in PYTHONS:
            answer = examine(packages, extras, machine, glibc, python)
            failed |= bool(answer.missing)
            verdict = f"NO WHEEL: {', '.join(answer.missing)}" if answer.missing else "ok"
            print(
                f"{machine}, glibc 2.{glibc}, Python {python}, {what}:"
                f" {answer.packages} packages, {answer.megabytes:.0f} MB: {verdict}"
            )
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
