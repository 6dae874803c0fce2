"""The check that everything installs from wheels names what does not, and never passes unseen."""

from __future__ import annotations

import subprocess
import tomllib

import pytest

from tests.places import ROOT
from tools import resolve


def package(name: str, *tags: str, **more: object) -> dict:
    wheels = [{"url": f"index/{name}-1.0-{tag}.whl", "size": 2_000_000} for tag in tags]
    return {"name": name, "version": "1.0", "source": {"registry": "r"}, "wheels": wheels, **more}


def project(*dependencies: dict, **more: object) -> dict:
    return {
        "name": "robot",
        "version": "0",
        "source": {"editable": "."},
        "dependencies": list(dependencies),
        **more,
    }


NATIVE = package("native", "cp312-cp312-manylinux_2_28_aarch64", "cp312-cp312-manylinux_2_17_x86_64")
YOUNG = package("young", "cp312-cp312-manylinux_2_35_aarch64.manylinux_2_34_aarch64")
PURE = package("pure", "py3-none-any", dependencies=[{"name": "native"}])
STABLE = package("stable", "cp39-abi3-manylinux2014_aarch64")


def test_a_package_without_a_wheel_is_named_also_below_another() -> None:
    packages = [project({"name": "pure"}), PURE, package("native", "cp312-cp312-win_amd64")]
    assert resolve.examine(packages, (), "aarch64", 31, "3.12").missing == ("native 1.0",)


def test_glibc_processor_and_python_decide_which_wheels_fit() -> None:
    packages = [project({"name": "native"}, {"name": "young"}, {"name": "stable"}), NATIVE, YOUNG, STABLE]
    assert resolve.examine(packages, (), "aarch64", 35, "3.12") == resolve.Answer(3, 6.0, ())
    assert resolve.examine(packages, (), "aarch64", 31, "3.12").missing == ("young 1.0",)
    assert resolve.examine(packages, (), "x86_64", 35, "3.12").missing == ("stable 1.0", "young 1.0")
    assert resolve.examine(packages, (), "aarch64", 35, "3.13").missing == ("native 1.0", "young 1.0")


def test_extras_groups_and_markers_choose_what_is_needed() -> None:
    packages = [
        project(
            {"name": "pure", "marker": "platform_machine == 'x86_64'"},
            **{"optional-dependencies": {"sim": [{"name": "young"}]}},
            **{"dev-dependencies": {"dev": [{"name": "robot", "extra": ["sim"]}]}},
        ),
        PURE,
        NATIVE,
        YOUNG,
    ]
    names = lambda *a: {p["name"] for p in resolve.needed(packages, *a)}  # noqa: E731
    assert names((), "aarch64", "3.12") == set()
    assert names((), "x86_64", "3.12") == {"pure", "native"}
    assert names(("sim",), "aarch64", "3.12") == {"young"}
    assert names(("dev",), "aarch64", "3.12") == {"young"}


@pytest.mark.parametrize(
    "broken", [FileNotFoundError("uv"), subprocess.TimeoutExpired("uv", 50.0), "dns error"], ids=str
)
def test_without_an_answer_it_says_that_nothing_was_checked(
    broken: Exception | str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def run(*_: object, **__: object) -> subprocess.CompletedProcess[str]:
        if isinstance(broken, Exception):
            raise broken
        return subprocess.CompletedProcess([], 2, "", broken)

    monkeypatch.setattr(resolve.subprocess, "run", run)
    assert resolve.main() == 3
    assert "NOT CHECKED" in capsys.readouterr().err


def test_every_robot_computer_is_checked_with_every_python() -> None:
    told = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    low, high = (int(part.split(".")[1]) for part in told["requires-python"].split(","))
    assert tuple(f"3.{minor}" for minor in range(low, high)) == resolve.PYTHONS
    assert {(m, glibc) for m, glibc, _, _ in resolve.MACHINES} >= {
        ("aarch64", 31),
        ("aarch64", 35),
        ("x86_64", 31),
    }


def test_the_robot_needs_no_simulator() -> None:
    told = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    mandatory = " ".join(told["dependencies"])
    assert "mujoco" not in mandatory
    assert "open3d" not in mandatory
