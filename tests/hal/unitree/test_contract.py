"""The Unitree backend keeps the contract over DDS, with the simulated Go2-W as the robot behind the wire."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from tests.hal.contract_suite import ContractSuite, Rig, campaign

pytest.importorskip("cyclonedds", reason="the unitree extra is not installed")
from cyclonedds.domain import DomainParticipant

from hal.lidar.config import only
from hal.robots import describe
from hal.scenes import Scene
from hal.unitree.api import Request, Response
from hal.unitree.config import UnitreeConfig
from hal.unitree.connect import open_link
from hal.unitree.factory import make_backend
from tests.hal.unitree.peer import Peer
from tests.hal.unitree.peer_process import PeerProcess
from tests.hal.unitree.robot import MujocoBody
from tests.hal.unitree.world import World

DOMAIN = 20 + os.getpid() % 200
XT16 = UnitreeConfig(lidars=only("xt16"))
GO2 = UnitreeConfig(robot_model="go2", motion_mode="mcf", lidars=only("xt16"))


def walled_floor() -> Scene:
    """12 x 12 m of flat ground between low walls."""
    height = np.zeros((241, 241), np.float32)
    height[:6] = height[-6:] = height[:, :6] = height[:, -6:] = 0.8
    return Scene("floor", height, 0.05, (-6.0, -6.0), (-2.0, 0.0, 0.0), {})


class DdsWorld(World):
    """The backend's own DDS endpoints against the peer's, on one clock: what is written is there at once."""

    def __init__(self, options: UnitreeConfig = XT16, **how: Any) -> None:
        body = MujocoBody(walled_floor(), lidar_step=20, **how)
        super().__init__(options=options, body=body, rate=250)  # an IMU sample from each
        self._dds = open_link("lo", DOMAIN, options)
        self._peer = Peer(DomainParticipant(DOMAIN), self.robot, options.topic(options.lidars[0]))

    def send(self, service: str, request: Request) -> None:
        self._dds.send(service, request)

    def responses(self, service: str) -> list[Response]:
        return self._dds.responses(service)

    def take(self, topic: str) -> list[bytes]:
        return self._dds.take(topic)

    def speakers(self, topic: str) -> list[int]:
        return self._dds.speakers(topic)

    def reachable(self, service: str) -> bool:
        return self._dds.reachable(service)

    def clouds(self) -> dict[str, str]:
        return self._dds.clouds()

    def advance(self, seconds: float) -> None:
        end = self.elapsed + round(seconds * 1e9)
        while self.elapsed < end:
            self.elapsed = min(end, self.elapsed + self._step)
            self._peer.advance(self.elapsed)

    def leave(self) -> None:
        """Give the domain back for the next test."""
        self._dds.close()


class TestUnitree(ContractSuite):
    def world(self) -> DdsWorld:
        return DdsWorld()

    @pytest.fixture
    def rig(self) -> Iterator[Rig]:
        world = self.world()

        def tick() -> int:
            world.advance(0.01)
            return world.now

        def fall() -> None:
            world.faults.fallen = True

        def hinder(on: bool) -> None:
            world.faults.stuck = on

        robot = world.backend.options.robot
        yield Rig(world.backend, tick, fall, hinder, robot, x=None if robot.wheeled else lambda: world.body.x)
        world.leave()


class TestGo2(TestUnitree):
    """On feet: its speed comes from its own estimate, and the wheels' slots of LowState tell nothing."""

    def world(self) -> DdsWorld:
        return DdsWorld(GO2, robot=describe("go2"), controller="trot")

    # Of postures wheels and feet tell the same; the Go2-W's are daily.
    test_a_transition_that_does_not_come_to_its_end_is_a_fault_in_time = campaign(
        ContractSuite.test_a_transition_that_does_not_come_to_its_end_is_a_fault_in_time
    )
    test_sits_down_and_stands_up_again = campaign(ContractSuite.test_sits_down_and_stands_up_again)
    test_a_latched_stop_keeps_a_lying_robot_down = campaign(
        ContractSuite.test_a_latched_stop_keeps_a_lying_robot_down
    )
    test_damp_ends_a_fault_and_a_damped_robot_may_lie_as_it_likes = campaign(
        ContractSuite.test_damp_ends_a_fault_and_a_damped_robot_may_lie_as_it_likes
    )
    test_sitting_and_damped_show_from_the_request_on = campaign(
        ContractSuite.test_sitting_and_damped_show_from_the_request_on
    )
    test_getting_up_is_neither_started_over_nor_turned_into_sitting = campaign(
        ContractSuite.test_getting_up_is_neither_started_over_nor_turned_into_sitting
    )


@pytest.mark.skipif(
    not os.environ.get("UNITREE_CONTRACT_LIVE"), reason="takes two minutes: set UNITREE_CONTRACT_LIVE=1"
)
class TestUnitreeLive(ContractSuite):
    """The same with everything as in the field: the robot in another process, the guardian, the clock on the wall."""

    live = True
    scan_hits = 500

    @pytest.fixture
    def rig(self) -> Iterator[Rig]:
        peer = PeerProcess(DOMAIN, "--body", "mujoco")
        backend = make_backend("lo", options=XT16.model_copy(update={"domain": DOMAIN}))

        def tick() -> int:
            time.sleep(0.01)
            return time.time_ns()

        try:
            yield Rig(
                backend,
                tick,
                lambda: peer.say("fault fallen=1"),
                lambda on: peer.say(f"fault stuck={int(on)}"),
            )
        finally:
            backend.close()
            peer.end()
