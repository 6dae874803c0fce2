"""Whom a stack finds on the router that it joins."""

from __future__ import annotations

import pytest

from rbtrg_robot.config import load
from rbtrg_robot.process.router import open_bus
from rbtrg_robot.process.runfiles import RobotTaken
from rbtrg_robot.wire.session import stack_id
from tools.bench.ports import free_port


def test_a_second_stack_of_the_same_robot_is_refused_and_one_of_another_robot_is_not() -> None:
    port = free_port()
    joins = {"port": port, "network": {"join": True}}
    with open_bus(load(port=port), stack=stack_id()):
        with pytest.raises(RobotTaken, match="end that one, or give this one another --robot"):
            open_bus(load(**joins), stack=stack_id())
        open_bus(load(**joins, robot="other"), stack=stack_id()).close()
        open_bus(load(**joins, domain=7), stack=stack_id()).close()
