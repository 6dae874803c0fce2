"""The walk over nested loops, against one that writes every round out."""

from __future__ import annotations

from typing import Any

from hypothesis import given
from hypothesis import strategies as st

from rbtrg_robot.msg import MissionLoop
from rbtrg_robot.stages.mission.cursor import Cursor, nested

Tree = list[Any]
"""Steps (None) and loops (times, tree)."""
TREES = st.recursive(
    st.lists(st.none(), min_size=1, max_size=3),
    lambda inner: st.lists(st.one_of(st.none(), st.tuples(st.integers(1, 3), inner)), min_size=1, max_size=3),
    max_leaves=6,
)


def flat(tree: Tree, loops: list[MissionLoop], first: int = 1) -> int:
    """Number the steps from `first` and collect the loops, outer ones first; the number after the last step."""
    for node in tree:
        if node is None:
            first += 1
            continue
        loop = MissionLoop(first, 0, node[0])
        loops.append(loop)
        first = flat(node[1], loops, first)
        loop.last = first - 1
    return first


def written_out(tree: Tree, first: int = 1) -> tuple[list[int], int]:
    """The oracle: the numbers of the steps in the order in which they are done."""
    order: list[int] = []
    for node in tree:
        if node is None:
            order.append(first)
            first += 1
            continue
        once, after = written_out(node[1], first)
        order += once * node[0]
        first = after
    return order, first


@given(TREES)
def test_steps_come_as_if_every_round_were_written_out(tree: Tree) -> None:
    loops: list[MissionLoop] = []
    count = flat(tree, loops) - 1
    assert nested(loops)
    expected, _ = written_out(tree)
    cursor = Cursor(count, loops)
    walked = [cursor.at]
    while cursor.advance() is not None:
        walked.append(cursor.at)
        cursor = Cursor(count, loops, cursor.at, cursor.rounds)  # a restart on the way changes nothing
    assert walked == expected


def test_a_loop_for_ever_does_not_end() -> None:
    cursor = Cursor(3, [MissionLoop(2, 3, 0)])
    walked = [cursor.at]
    for _ in range(101):
        assert cursor.advance() is not None
        walked.append(cursor.at)
    assert walked == [1] + [2, 3] * 50 + [2]


def test_loops_that_cross_are_seen() -> None:
    assert nested([MissionLoop(1, 4, 2), MissionLoop(2, 3, 2), MissionLoop(4, 4, 2)])
    assert not nested([MissionLoop(1, 3, 2), MissionLoop(2, 4, 2)])
    assert not nested([MissionLoop(2, 4, 2), MissionLoop(1, 3, 2)])
