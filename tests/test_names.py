"""Names of numbers: two words, so that a reader knows of what they are."""

from __future__ import annotations

import ast

import pytest

from tests.places import ROOT

KINDS = {
    *("AGREED", "ALL", "ASSUMED", "AWAY", "BESIDE", "BLOCKED", "BOTTOM", "BRIDGED", "CELLS"),
    *("CLOSED", "CONFLICT", "CONTACT", "DEPTH", "EMPTY", "EXHAUSTED", "FACE", "FAULTS", "FIELD"),
    *("FIRST", "FOUND", "FREE", "HARD", "HIGH", "HOLE", "JUDGED", "LEAFY", "LIDAR"),
    *("LOOSE", "LOW", "MACHINES", "MILLIMETRE", "NEW", "NEXT", "NODATA", "NONE", "OBSTACLE"),
    *("OCCUPIED", "OVER", "OVERHANG", "PLANTS", "POINTS", "POSTS", "PRIOR", "QPOS", "QVEL"),
    *("RAYS", "REACHED", "REPLACED", "RIM", "RUNS", "SHARED", "SITES", "SOME", "TABLE"),
    *("TIP", "TOP", "TOUCHED", "TRACK", "TRAVERSABLE", "UNKNOWN", "UNSEEN", "USED", "VIRTUAL"),
    *("WEIGHT", "WHEELS", "WIDE", "X", "Y", "ZERO"),
}
"""No numbers to be tuned: flags of a cell, kinds, columns of an array, axes, sentinels, rows of tables."""


def numbers(node: ast.expr) -> bool:
    """Whether an expression holds a number that was typed."""
    return any(
        isinstance(part, ast.Constant) and isinstance(part.value, int | float) for part in ast.walk(node)
    )


def constants(text: str) -> list[str]:
    """Of the head of a module."""
    found = []
    for line in ast.parse(text).body:
        if isinstance(line, ast.Assign) and numbers(line.value):
            for target in line.targets:
                found += [part.id for part in ast.walk(target) if isinstance(part, ast.Name)]
    return [name for name in found if name.isupper()]


def test_one_word_is_found() -> None:
    assert constants("REACH, _WIDE_ENOUGH = 2.0, 0.5\nNAMES = ('a',)\n") == ["REACH", "_WIDE_ENOUGH"]


@pytest.mark.parametrize(
    "folder", ["mapping", "planning", "rbtrg_robot/stages/mission", "rbtrg_robot/stages/navigation"]
)
def test_constants_have_two_words(folder: str) -> None:
    short = [
        f"{file.relative_to(ROOT)}: {name}"
        for file in sorted((ROOT / folder).rglob("*.py"))
        for name in constants(file.read_text())
        if "_" not in name.strip("_") and name not in KINDS
    ]
    assert short == []
