"""The MuJoCo robot keeps the contract."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from contract_suite import ContractSuite, Rig

from hal.mujoco.backend import MujocoBackend
from hal.scenes import Scene

POLICY = Path(__file__).resolve().parents[2].parent / "shared" / "data" / "policies" / "go2w_rl_sar"


def walled_floor() -> Scene:
    """12 x 12 m of flat ground between low walls."""
    height = np.zeros((241, 241), np.float32)
    height[:6] = height[-6:] = height[:, :6] = height[:, -6:] = 0.8
    return Scene("floor", height, 0.05, (-6.0, -6.0), (-2.0, 0.0, 0.0), {})


class TestMujoco(ContractSuite):
    scan_hits = 1000

    @pytest.fixture
    def rig(self) -> Rig:
        clock = [0]

        def tick() -> int:
            clock[0] += 10_000_000
            return clock[0]

        return Rig(MujocoBackend(walled_floor(), lidar_step=10, caster="numba"), tick)


@pytest.mark.skipif(not POLICY.is_dir(), reason="no policy folder beside the repository")
class TestMujocoWithPolicy(ContractSuite):
    scan_hits = 1000

    @pytest.fixture
    def rig(self) -> Rig:
        clock = [0]

        def tick() -> int:
            clock[0] += 10_000_000
            return clock[0]

        backend = MujocoBackend(
            walled_floor(), controller="policy", policy_dir=str(POLICY), lidar_step=10, caster="numba"
        )
        return Rig(backend, tick)
