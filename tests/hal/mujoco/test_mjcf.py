"""A robot of ours in an MJCF of somebody else: one that names, weighs and limits things in its own way."""

from __future__ import annotations

import os
from pathlib import Path

import mujoco
import numpy as np
import pytest

from hal.mujoco.driver import Driver
from hal.mujoco.mjcf import Foreign, ModelError
from hal.mujoco.sim import Simulation
from hal.robots import describe

VENDOR = Path(os.environ.get("UNITREE_MUJOCO", "-")) / "unitree_robots" / "go2w"
"""Of a checkout of the vendor's public simulator."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Our model as a file in a vendor's style: other names, a mesh to look at, two shapes on a wheel, weak wheels."""
    place = tmp_path_factory.mktemp("theirs")
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    spec.option.impratio = 50.0
    root = describe().model().add(spec, friction=0.7, payload=0.0, housings=False, looks=False)
    root.name = "trunk"
    root.mass += 1.0
    for actuator in list(spec.actuators):
        spec.delete(actuator)
    for joint in spec.joints:
        if joint.name != "base":
            joint.name += "_joint"
            limit = 15.0 if "wheel" in joint.name else 20.0
            motor = spec.add_actuator(name=joint.name.removesuffix("_joint"), target=joint.name)
            motor.trntype = mujoco.mjtTrn.mjTRN_JOINT
            motor.ctrlrange = [-limit, limit]
    for geom in list(spec.geoms):
        if geom.name.endswith("_wheel"):
            inner = geom.parent.add_geom(type=geom.type, size=0.9 * geom.size, pos=geom.pos, quat=geom.quat)
            inner.friction[0] = 0.4
            geom.condim, geom.friction[2] = 6, 0.01
    corners = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]
    spec.add_mesh(name="shell", uservert=np.array(corners, float).ravel())
    root.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname="shell", contype=0, conaffinity=0)
    spec.compile()
    (place / "theirs.xml").write_text(spec.to_xml())
    return place


def flat(robot: Foreign, friction: float = 0.6) -> Simulation:
    return Simulation(np.zeros((200, 300), np.float32), 0.02, (-2.0, -2.0), friction, robot=robot)


def test_what_stands_in_the_file_counts(folder: Path) -> None:
    robot = Foreign(folder, describe().model())
    sim = flat(robot)
    model = sim.model
    assert robot.name == f"{folder.name}/theirs"
    assert model.body_mass.sum() == pytest.approx(describe().body.mass + 1.0, abs=1e-3)
    assert model.opt.integrator == mujoco.mjtIntegrator.mjINT_EULER, "the torque law is explicit"
    assert (model.opt.impratio, model.opt.timestep) == (50.0, 0.005)
    assert model.nmesh == 0, "what touches nothing is left out"
    assert set(robot.torque_limit[:12]) == {20.0}
    assert set(robot.torque_limit[12:]) == {15.0}
    assert model.actuator("FL_wheel").forcerange[1] == 15.0
    for name in ("FL_wheel", "FL1_wheel"):
        assert model.geom(name).friction[0] == 0.6, "every shape of a wheel has the trial's friction"
        assert model.geom(name).condim <= 4, "no wheel spends its grip on rolling"


def test_the_model_based_controller_drives_it(folder: Path) -> None:
    robot = Foreign(folder / "theirs.xml", describe().model())
    sim = flat(robot, 0.8)
    sim.reset()
    driver = Driver(sim, robot.controller("vmc", "", sim.timestep))
    driver.settle(0.4)
    for _ in range(400):
        driver.step(0.5)
    assert 0.7 < sim.position[0] < 1.1
    for _ in range(200):
        driver.step(0.5, 0.8)
    driver.settle(0.6)
    rest = []
    for _ in range(40):
        driver.step()
        rest.append(sim.low_state().tau)
    assert np.abs(np.diff(rest, axis=0)).max() < 1.0, "no joint rings under the explicit law"


def test_a_file_that_is_no_model_of_the_robot_says_what_it_lacks(folder: Path, tmp_path: Path) -> None:
    own = describe().model()
    with pytest.raises(ModelError, match="must be an MJCF"):
        Foreign(tmp_path, own)
    (tmp_path / "a.xml").write_text("<mujoco")
    with pytest.raises(ModelError, match="cannot read"):
        Foreign(tmp_path, own)
    text = (folder / "theirs.xml").read_text()
    (tmp_path / "a.xml").write_text(text.replace("RL_calf_joint", "RL_shin"))
    with pytest.raises(ModelError, match="no joint RL_calf"):
        Foreign(tmp_path, own)
    (tmp_path / "a.xml").write_text(text.replace('name="imu"', 'name="other"'))
    with pytest.raises(ModelError, match="no site `imu`"):
        Foreign(tmp_path, own)


@pytest.mark.skipif(not VENDOR.is_dir(), reason="UNITREE_MUJOCO names no checkout of the vendor's simulator")
def test_the_vendors_own_model_is_read() -> None:
    robot = Foreign(VENDOR / "go2w.xml", describe().model())
    sim = flat(robot)
    assert sim.model.body_mass.sum() == pytest.approx(19.126, abs=0.01)
    assert set(robot.torque_limit[12:]) == {15.0}
    assert sim.model.opt.impratio == 100.0
