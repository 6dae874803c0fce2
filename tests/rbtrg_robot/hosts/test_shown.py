"""What a stage makes for listeners alone: nothing while nobody listens, twice a second while somebody does."""

from __future__ import annotations

import time

from hal.types import NS
from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.hosts.live import Node
from rbtrg_robot.processes import BY_NAME
from rbtrg_robot.stages.stage import Outputs
from rbtrg_robot.topics import Topic
from rbtrg_robot.wire.bus import Bus
from rbtrg_robot.wire.messages import header
from tools.bench.ports import free_endpoint


class Showing:
    """A stage that counts how often it was asked to show something."""

    inputs: tuple[Topic, ...] = ()
    outputs: tuple[Topic, ...] = (t.MAP_COST,)
    shown = t.MAP_COST

    def __init__(self) -> None:
        self.made = 0

    def warm_up(self) -> None:
        pass

    def close(self) -> None:
        pass

    def on(self, _topic: Topic, _message: object) -> Outputs:
        return []

    def tick(self, _now: int) -> Outputs:
        return []

    def show(self) -> Outputs:
        self.made += 1
        return [(t.MAP_COST, msg.OccupancyGrid(header=header(self.made, "map")))]


def test_it_is_made_twice_a_second_while_somebody_listens() -> None:
    where, stage, now = free_endpoint(), Showing(), 0
    with Bus(where, "elevation", router=True) as bus, Bus(where, "somebody") as other:
        node = Node(BY_NAME["elevation"], stage, bus, simulated=True)

        def second() -> None:
            nonlocal now
            for _ in range(100):
                now += NS // 100
                node.advance(now)

        second()
        assert stage.made == 0, "nobody listens"
        other.subscribe([t.MAP_COST])
        end = time.monotonic() + 10.0
        while not bus.advertise(t.MAP_COST).wanted:
            assert time.monotonic() < end
            time.sleep(0.005)
        second()
        assert 2 <= stage.made <= 3
        assert other.take(10.0)[0].topic is t.MAP_COST
