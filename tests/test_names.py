"""Names of numbers: two words, so that a reader knows of what they are."""

from __future__ import annotations

import ast

import pytest

from tests.places import ROOT

KINDS = """
AGREED ALL ASSUMED AWAY B BESIDE BEST BLOCKED BOTTOM BOXES BRIDGED BUSY CELLS CENTIMETRE CLOCK CLOSED
CLUMPS CONFLICT CONTACT DARK DEGREE DEPTH EMPTY ENDED EXHAUSTED FACE FAILED FATAL FAULTS FIELD FIRST FOC
FOUND FREE GIGABYTE GRAVITY HARD HEAD HIGH HOLE JUDGED KINDS L2 LAMP LEAFY LENS LEVELS LIDAR LOOSE LOW
MACHINES MEASURED MEMORY MILLIMETRE NEW NEXT NODATA NONE NOTHING NS OBSTACLE OCCUPIED OVER OVERHANG
PASSING PLANTS POINTS POSTS PRIOR QPOS QVEL RAYS REACHED REPLACED RIM RUNS SHARED SHELL SITES SOME STAND
STEEL STOPS TABLE TICK TIP TOP TOUCHED TRACK TRAVERSABLE TYRE UNKNOWN UNSEEN UP USED VIRTUAL WEIGHT
WHEELS WIDE WORST X Y ZERO
"""
"""No numbers to be tuned: flags of a cell, kinds, codes of a protocol, colours, columns of an array, axes, units."""


def numbers(node: ast.expr) -> bool:
    """Whether an expression is of numbers that were typed. Tables with keys and records name theirs themselves."""
    match node:
        case ast.Constant(value=value):
            return isinstance(value, int | float)
        case ast.Tuple(elts=parts) | ast.List(elts=parts):
            return any(numbers(part) for part in parts)
        case ast.UnaryOp(operand=part):
            return numbers(part)
        case ast.BinOp(left=left, right=right):
            return numbers(left) or numbers(right)
        case ast.Call(func=ast.Attribute(value=ast.Name(id="math" | "np")), args=parts):
            return any(numbers(part) for part in parts)
    return False


def enumerated(line: ast.Assign) -> bool:
    """Whether several names are given whole numbers in one line."""
    match line:
        case ast.Assign(targets=[ast.Tuple()], value=ast.Tuple(elts=parts)):
            return all(isinstance(part, ast.Constant) and isinstance(part.value, int) for part in parts)
    return False


def constants(text: str) -> list[str]:
    """Of the head of a module."""
    found = []
    for line in ast.parse(text).body:
        if isinstance(line, ast.Assign) and numbers(line.value) and not enumerated(line):
            for target in line.targets:
                found += [part.id for part in ast.walk(target) if isinstance(part, ast.Name)]
    return [name for name in found if name.isupper()]


def test_one_word_is_found() -> None:
    assert constants("REACH, _WIDE_ENOUGH = 2.0, 0.5\nNAMES = ('a',)\n") == ["REACH", "_WIDE_ENOUGH"]


@pytest.mark.parametrize("folder", ["hal", "mapping", "planning", "rbtrg_robot"])
def test_constants_have_two_words(folder: str) -> None:
    short = [
        f"{file.relative_to(ROOT)}: {name}"
        for file in sorted((ROOT / folder).rglob("*.py"))
        for name in constants(file.read_text())
        if "_" not in name.strip("_") and name not in KINDS.split()
    ]
    assert short == []
