"""The MuJoCo robot keeps the contract."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import pytest

from hal.mujoco.backend import MujocoBackend
from hal.robots import describe
from hal.robots.go2.simulated import JOINT_RANGE as GO2_RANGE
from hal.scenes import Scene
from hal.types import ModeRequest, Phase
from tests.hal.contract_suite import ContractSuite, Rig
from tests.places import POLICY, needs_shared


def walled_floor() -> Scene:
    """12 x 12 m of flat ground between low walls."""
    height = np.zeros((241, 241), np.float32)
    height[:6] = height[-6:] = height[:, :6] = height[:, -6:] = 0.8
    return Scene("floor", height, 0.05, (-6.0, -6.0), (-2.0, 0.0, 0.0), {})


def rig_of(**options: Any) -> Rig:
    """The simulated robot, its clock, and what its physics can do to it."""
    robot = options.setdefault("robot", describe())
    backend = MujocoBackend(walled_floor(), lidar_step=20, **options)
    sim = backend.simulation
    follow = sim.apply
    clock = [0]

    def tick() -> int:
        clock[0] += 10_000_000
        return clock[0]

    def fall() -> None:
        sim.data.qpos[2] += 0.25
        sim.data.qpos[3:7] = [np.sqrt(0.5), np.sqrt(0.5), 0.0, 0.0]
        sim.data.qvel[:] = 0.0
        mujoco.mj_forward(sim.model, sim.data)
        backend.placed()

    def hinder(on: bool) -> None:
        """The motors hold what they were last told."""
        sim.apply = (lambda _command: None) if on else follow  # type: ignore[method-assign]

    def lift() -> None:
        x, y = sim.position[:2].tolist()
        now = sim.data.time
        sim.reset(x, y, settle=0.0)
        sim.data.time = now
        backend.placed()

    return Rig(backend, tick, fall, hinder, robot, None if robot.name == "go2w" else lift)


class TestMujoco(ContractSuite):
    @pytest.fixture
    def rig(self) -> Rig:
        return rig_of()


@needs_shared
@pytest.mark.campaign
class TestMujocoWithPolicy(ContractSuite):
    @pytest.fixture
    def rig(self) -> Rig:
        return rig_of(controller="policy", policy_dir=str(POLICY))


@needs_shared
class TestMujocoHybrid(ContractSuite):
    @pytest.fixture
    def rig(self) -> Rig:
        return rig_of(controller="hybrid", policy_dir=str(POLICY))


class TestJackal(ContractSuite):
    """Its wheels sit on its body: sitting and standing move nothing."""

    legs = False
    joint_range = np.zeros((12, 2))
    scan_hits = 300

    @pytest.fixture
    def rig(self) -> Rig:
        return rig_of(robot=describe("jackal"), controller="drive")

    def test_a_transition_that_does_not_come_to_its_end_is_a_fault_in_time(self, rig: Rig) -> None:
        rig.seated()
        rig.hinder(True)
        rig.backend.request(ModeRequest.STAND)
        rig.until(Phase.READY, seconds=2.0)
        rig.backend.request(ModeRequest.SIT)
        rig.until(Phase.SITTING, seconds=0.1)


@pytest.mark.campaign
class TestGo2(ContractSuite):
    """It stands on feet, and cannot turn itself over."""

    joint_range = GO2_RANGE

    @pytest.fixture
    def rig(self) -> Rig:
        return rig_of(robot=describe("go2"), controller="trot")
