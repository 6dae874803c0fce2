"""Blocks of the map that are lost on their way to the planner, or come before the status that tells of their epoch."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from hal.types import NS
from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.config import load
from rbtrg_robot.hosts.live import Node
from rbtrg_robot.log.read import Entry
from rbtrg_robot.processes import BY_NAME
from rbtrg_robot.stages.planner import PlannerStage, build
from rbtrg_robot.topics import Topic
from rbtrg_robot.wire.messages import encode, header
from tests.rbtrg_robot.hosts.test_rerun import LateBus
from tests.rbtrg_robot.stages.test_planner import patch

Sent = tuple[Topic, int, Any]
"""Topic, number of its publisher, message."""


def block(number: int, column: int) -> Sent:
    return t.MAP_UPDATE, number, patch(np.zeros((64, 64)), cell=(0, 64 * column))


def status(number: int, epoch: int) -> Sent:
    return t.MAP_STATUS, number, msg.MapStatus(epoch=epoch)


def read_by(stage: PlannerStage, *sent: Sent) -> list[str]:
    """What a planner that takes all of it at once asks for."""
    clock = t.CLOCK, 1, msg.Clock(clock=header(NS, "").stamp)
    entries = [
        Entry(topic.name, topic.type, encode(message), NS, NS, number)
        for topic, number, message in (*sent, clock)
    ]
    bus: Any = LateBus(entries)
    Node(BY_NAME["planner"], stage, bus, simulated=True).run(lambda: bus.ended)
    return [topic.name for topic, *_ in bus.published if topic is t.MAP_REQUEST]


@pytest.mark.parametrize(
    ("numbers", "asks"),
    [((1, 2, 3), 0), ((1, 3, 4), 1), ((2, 3, 4), 1), ((1, 2, 1), 0), ((3, 4, 1), 1), ((1, 2, 2), 1)],
    ids=["all", "one lost", "the first lost", "elevation anew", "lost before that", "anew and lost"],
)
def test_a_planner_that_lost_a_block_of_the_map_asks_for_all_of_it(
    numbers: tuple[int, ...], asks: int
) -> None:
    stage = build(load(None, [], scene="flat"))
    blocks = [block(number, column) for column, number in enumerate(numbers)]

    assert len(read_by(stage, status(1, 1), *blocks)) == asks


def test_a_planner_that_was_busy_keeps_the_blocks_of_a_new_map_between_two_statuses() -> None:
    stage = build(load(None, [], scene="flat"))

    read_by(
        stage, status(1, 1), block(1, 0), status(2, 2), block(2, 1), block(3, 2), status(3, 2), block(4, 3)
    )

    assert stage._map.mirror.epoch == 2
    assert len(stage._map.mirror) == 3
