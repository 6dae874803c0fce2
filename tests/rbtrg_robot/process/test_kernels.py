"""What `up` says of the kernels that a first start compiles."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from rbtrg_robot.process import kernels
from rbtrg_robot.process.kernels import KERNEL_FILES, SURE_KERNELS, Compiling, kept_in


def keep(folder: Path, count: int, second: int = 2) -> None:
    """As if numba had compiled `count` kernels in this second."""
    for number in range(count):
        path = folder / "__pycache__" / f"kernels.k{number}-1.py311.nbi"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
        os.utime(path, (second, second))


def test_a_first_start_tells_how_many_of_all_and_how_long_they_take(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    compiling = Compiling([tmp_path])
    assert compiling.words() == ""
    keep(tmp_path, SURE_KERNELS - 1)
    assert (
        compiling.words() == f"compiling kernels for this machine, once: {SURE_KERNELS - 1} of {KERNEL_FILES}"
    )
    keep(tmp_path, 57)
    began = compiling._began
    monkeypatch.setattr(kernels.time, "monotonic", lambda: began + 20.0)
    left = 20.0 * (KERNEL_FILES - 57) / 57
    said, seconds = compiling.words().rsplit(", about ", 1)
    assert said == f"compiling kernels for this machine, once: 57 of {KERNEL_FILES}"
    assert 0.0 <= int(seconds.removesuffix(" s")) - left < 5.0
    keep(tmp_path, KERNEL_FILES + 3)
    assert compiling.words().endswith(f"once: {KERNEL_FILES + 3} so far")


def test_after_an_upgrade_it_tells_how_many_so_far_and_a_warm_start_says_nothing(tmp_path: Path) -> None:
    keep(tmp_path, KERNEL_FILES, second=1)
    compiling = Compiling([tmp_path])
    assert compiling.words() == ""
    keep(tmp_path, 30)
    assert compiling.words() == "compiling kernels for this machine, once: 30 so far"


def test_it_looks_where_numba_keeps_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    assert kept_in() == (tmp_path,)
    monkeypatch.delenv("NUMBA_CACHE_DIR")
    from hal.rotation import up_of

    kept = Path(up_of.stats.cache_path)
    assert any(kept.is_relative_to(folder) for folder in kept_in())
