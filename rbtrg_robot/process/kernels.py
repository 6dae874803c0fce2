"""How far a first start has come with compiling: numba leaves a file for each kernel that it has compiled."""

from __future__ import annotations

import contextlib
import importlib
import math
import os
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from rbtrg_robot.processes import PROCESSES
from rbtrg_robot.stages.stage import Stage, WarmsLater, warm

if TYPE_CHECKING:
    from rbtrg_robot.config import StackConfig

KERNEL_FILES = 250
"""Files that a start leaves where none was kept, within a tenth: `python -m tools.warm` says so when it is off."""
INDEX = "*.nbi"
"""Numba's index of one compiled function, written anew with each compilation."""
SURE_KERNELS = 20
"""Kernels after which the remaining time is told."""
ROOT = Path(__file__).parents[2]
REST = "kernels"
"""The process that compiles what no first goal needs."""


def kept_in() -> tuple[Path, ...]:
    """Where numba may keep the kernels of this stack, see `hal/kernel_cache.py`."""
    if given := os.environ.get("NUMBA_CACHE_DIR"):
        return (Path(given),)
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return (*(ROOT / package for package in ("hal", "mapping", "planning")), cache / "numba")


def compile_rest(config: StackConfig) -> None:
    """What no first goal needs, while the robot drives already, in the time that the others leave."""
    os.nice(19)
    for row in PROCESSES:
        if row.hosted and row.name not in config.absent:
            module, function = row.entry.split(":")
            stage: Stage = getattr(importlib.import_module(module), function)(config)
            if isinstance(stage, WarmsLater):
                warm(stage)


class Compiling:
    """What was compiled since it was made."""

    def __init__(self, folders: Sequence[Path] | None = None) -> None:
        self._folders = kept_in() if folders is None else folders
        self._began = time.monotonic()
        self._kept = self._files()
        self.cold = len(self._kept) < KERNEL_FILES // 2
        """Hardly any was kept."""

    @property
    def done(self) -> int:
        """Kernels."""
        return sum(self._kept.get(path) != written for path, written in self._files().items())

    def words(self) -> str:
        """For an operator; empty where nothing had to be compiled. After an upgrade nobody knows how many kernels it
        takes."""
        done = self.done
        if not done:
            return ""
        said = f"compiling kernels for this machine, once: {done}"
        if not self.cold or done >= KERNEL_FILES:
            return f"{said} so far"
        left = (time.monotonic() - self._began) * (KERNEL_FILES - done) / done
        return f"{said} of {KERNEL_FILES}" + (
            f", about {5 * math.ceil(left / 5)} s" if done >= SURE_KERNELS else ""
        )

    def _files(self) -> dict[Path, int]:
        """When each was written [ns]."""
        found = {}
        for folder in self._folders:
            for path in folder.rglob(INDEX):
                with contextlib.suppress(FileNotFoundError):  # numba replaces them
                    found[path] = path.stat().st_mtime_ns
        return found
