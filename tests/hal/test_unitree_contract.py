"""The Unitree backend keeps the contract, with the simulated Go2-W as the robot behind the wire."""

from __future__ import annotations

import numpy as np
import pytest
from contract_suite import ContractSuite, Rig

from hal.scenes import Scene
from hal.unitree.options import UnitreeOptions
from tests.unitree_robot import MujocoBody
from tests.unitree_world import World


def walled_floor() -> Scene:
    """12 x 12 m of flat ground between low walls."""
    height = np.zeros((241, 241), np.float32)
    height[:6] = height[-6:] = height[:, :6] = height[:, -6:] = 0.8
    return Scene("floor", height, 0.05, (-6.0, -6.0), (-2.0, 0.0, 0.0), {})


class TestUnitree(ContractSuite):
    scan_hits = 1000

    @pytest.fixture
    def rig(self) -> Rig:
        body = MujocoBody(walled_floor(), lidar_step=10, caster="numba")
        world = World(options=UnitreeOptions(lidar="xt16"), body=body)

        def tick() -> int:
            world.advance(0.01)
            return world.now

        return Rig(world.backend, tick)
