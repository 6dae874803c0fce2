"""What a command says when its first use compiles kernels."""

from __future__ import annotations

import threading
from pathlib import Path

import numba  # noqa: F401  a command that has not imported it compiles nothing
import pytest

from rbtrg_robot.cli import first_use
from rbtrg_robot.cli.first_use import tell_once


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where numba keeps its kernels."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(first_use, "LOOK_PERIOD", 0.01)
    return tmp_path


def test_a_command_that_compiles_says_so_once(folder: Path) -> None:
    said: list[str] = []
    heard = threading.Event()
    thread = tell_once(lambda line: (said.append(line), heard.set()))
    written = 0
    while (
        not heard.wait(0.02) and written < 500
    ):  # files that were there at the first look are none of its own
        (folder / f"kernels.k{written}-1.py311.nbi").touch()
        written += 1
    thread.join(5.0)
    assert not thread.is_alive()
    assert len(said) == 1
    assert said[0].startswith("compiling kernels for this machine, once")


def test_a_warm_command_says_nothing(folder: Path) -> None:
    (folder / "kernels.k-1.py311.nbi").touch()
    said: list[str] = []
    ended = threading.Event()
    thread = tell_once(said.append, ended)
    assert not ended.wait(0.3)
    ended.set()
    thread.join(5.0)
    assert not thread.is_alive()
    assert said == []
