"""Which runs stay on the disk: the newest, and those an operator marked, as far as the quota allows.

A run is a folder below the log folder that holds `config.yaml`. A file `KEEP` in it marks it.
"""

from __future__ import annotations

import contextlib
import shutil
from dataclasses import dataclass
from pathlib import Path

from rbtrg_robot.log.read import CONFIG, LogError, is_being_written

MARK = "KEEP"
GIGABYTE = 1_000_000_000


@dataclass(frozen=True, slots=True)
class Run:
    """One run on the disk."""

    folder: Path
    size: int
    """Bytes."""
    kept: bool
    """Marked by an operator: never removed."""
    active: bool
    """Its log is being written."""


def runs(base: Path) -> list[Run]:
    """All runs below `base`, oldest first (their names begin with the date)."""
    found = sorted(path.parent for path in base.glob(f"*/{CONFIG}"))
    return [_run(folder) for folder in found]


def mark(folder: Path, keep: bool = True) -> None:
    """Keep a run, or no longer. Raises LogError when `folder` is no run."""
    if not (folder / CONFIG).is_file():
        raise LogError(f"{folder} is no run: name a folder that holds config.yaml")
    if keep:
        (folder / MARK).touch()
    else:
        (folder / MARK).unlink(missing_ok=True)


def prune(base: Path, quota: float, spare: Path | None = None) -> list[Path]:
    """Remove the oldest unmarked runs until all of them take at most `quota` [GB]; returns what was removed.

    Runs that are being written, marked runs and `spare` stay, whatever they take.
    """
    known = runs(base)
    total = sum(run.size for run in known)
    removed = []
    for run in known:
        if total <= quota * GIGABYTE:
            break
        if run.kept or run.active or run.folder == spare:
            continue
        _remove(run.folder)
        if not run.folder.exists():
            total -= run.size
            removed.append(run.folder)
    return removed


def _remove(folder: Path) -> None:
    """What makes it a run goes last: a removal that is cut short goes on at the next."""
    for path in folder.rglob("*"):
        if path.is_file() and path.name != CONFIG:
            with contextlib.suppress(OSError):
                path.unlink()
    shutil.rmtree(folder, ignore_errors=True)


def _run(folder: Path) -> Run:
    files = [path for path in folder.rglob("*") if path.is_file()]
    size = 0
    for path in files:
        try:
            size += path.stat().st_size
        except OSError:  # it was removed meanwhile
            continue
    logs = [path for path in files if path.suffix == ".mcap"]
    return Run(folder, size, (folder / MARK).exists(), any(_is_active(path) for path in logs))


def _is_active(log: Path) -> bool:
    try:
        return is_being_written(log)
    except FileNotFoundError:  # another stack removed it meanwhile
        return False
    except OSError:  # of somebody else: nobody here can tell
        return True
