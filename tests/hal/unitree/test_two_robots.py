"""Two robots on one DDS domain: neither is driven, and both are named."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hal.contract import BackendError
from hal.safety.monitors import TWO_ROBOTS, taken_out
from hal.types import NS, Phase
from hal.unitree.api import Sport
from hal.unitree.turns import FLOOR_TIME, Turns
from tests.hal.unitree.robot import Faults, KinematicBody, RobotSide
from tests.hal.unitree.world import World

MS = NS // 1000
A, B = (1, "11-0"), (2, "22-0")


def other(**faults: object) -> RobotSide:
    return RobotSide(KinematicBody(), Faults(serial=22, epoch=0.0, **faults))  # type: ignore[arg-type]


@pytest.mark.parametrize("serial", [22, 11, 0])
def test_it_does_not_start_beside_another_robot(serial: int) -> None:
    world = World(Faults(serial=11 if serial else 0))
    world.other = RobotSide(KinematicBody(), Faults(serial=serial))
    with pytest.raises(BackendError) as refused:
        world.backend.connect()
    assert not refused.value.retry
    assert "more than one robot on this DDS domain" in str(refused.value)
    assert "11-0" in str(refused.value) or not serial
    assert f"{serial}-0" in str(refused.value)
    assert "unitree.domain" in str(refused.value)
    assert world.sent == []


def test_it_does_not_start_where_a_service_answers_twice() -> None:
    world = World()
    world.other = other(low_silent=True)
    with pytest.raises(BackendError, match=r"service '(sport|motion_switcher)' answered a request twice"):
        world.backend.connect()
    assert Sport.MOVE not in world.apis()


def test_another_robot_that_comes_while_it_drives_is_a_fault_and_both_stop() -> None:
    world = World(Faults(serial=11))
    world.backend.connect()
    world.until(Phase.MOVING, 5.0, vx=0.5)
    world.other = other()
    world.advance(1.0)
    world.other.step(world.elapsed)
    x, began = world.body.x, world.elapsed
    world.until(Phase.FAULT, 1.0, vx=0.5)
    assert (world.elapsed - began) / NS < 0.2
    assert "serial numbers 11-0 and 22-0" in world.cause
    world.run(1.0, vx=0.5)
    assert abs(world.body.v) < 0.05
    assert abs(world.other.body.v) < 0.05
    assert world.backend.diagnostics()["robot_restarts"] == 0, "the tick of the other is no restart"
    assert world.body.x - x < 0.5
    world.other = None
    world.run(2.0)
    world.backend.request("recover")  # type: ignore[arg-type]
    world.until(Phase.READY, 10.0)


def test_without_the_monitor_both_would_drive() -> None:
    world = World(Faults(serial=11))
    world.other = other()
    with taken_out(TWO_ROBOTS.name):
        world.backend.connect()
        world.run(2.0, vx=0.5)
    assert world.other.body.v > 0.4


def test_a_robot_that_was_restarted_is_one_robot() -> None:
    turns, now = Turns(), 0
    for _ in range(100):
        now += 2 * MS
        assert turns.counts(A, now)
    for wait in (1 * MS, FLOOR_TIME, 3 * NS):
        now += wait
        taken = 0
        new = (wait, "11-0")
        for _ in range(500):
            now += 2 * MS
            taken += turns.counts(new, now)
            assert turns.several(now) == []
        assert taken >= 240, "it has the floor when the one of before was silent for half a second"


@given(st.lists(st.sampled_from([A, B]), min_size=30, max_size=100).filter(lambda x: len(set(x[:20])) == 2))
@settings(max_examples=100, deadline=None)
def test_two_that_take_turns_are_two_and_one_of_them_counts(order: list) -> None:
    turns, counted = Turns(), set()
    for k, who in enumerate([*order, A, B, A, B]):
        if turns.counts(who, 2 * MS * k):
            counted.add(who)
    assert len(counted) == 1
    assert set(turns.several(2 * MS * k)) == {A, B}
    assert turns.several(2 * MS * k + 2 * NS) == []
