"""The URDF, read by MuJoCo's own parser and held against the facts it was written from."""

from __future__ import annotations

from xml.etree import ElementTree as Xml

import mujoco
import numpy as np
import pytest

from hal.robots.go2w import facts as go2w
from hal.robots.go2w.urdf import ROOT, urdf


@pytest.fixture(scope="module")
def model() -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(urdf())


def test_joints_are_the_motors_with_their_limits(model: mujoco.MjModel) -> None:
    names = {model.joint(k).name: k for k in range(model.njnt)}
    assert set(names) == set(go2w.MOTORS)
    for number, motor in enumerate(go2w.MOTORS):
        limited = np.isfinite(go2w.JOINT_RANGE[number, 0])
        assert bool(model.jnt_limited[names[motor]]) == limited
        if limited:
            np.testing.assert_allclose(model.jnt_range[names[motor]], go2w.JOINT_RANGE[number])


@pytest.mark.parametrize("seed", range(5))
def test_the_wheels_are_where_the_kinematics_put_them(model: mujoco.MjModel, seed: int) -> None:
    random = np.random.default_rng(seed)
    low, high = np.clip(go2w.JOINT_RANGE, -3.0, 3.0).T
    q = random.uniform(low, high)
    data = mujoco.MjData(model)
    for number, motor in enumerate(go2w.MOTORS):
        data.joint(motor).qpos = q[number]
    mujoco.mj_kinematics(model, data)
    for leg, name in enumerate(go2w.LEGS):
        wheel = data.body(f"{name}_wheel")
        tread = wheel.xpos + wheel.xmat.reshape(3, 3) @ [0.0, go2w.TREAD_Y * go2w.SIGN_Y[leg], 0.0]
        np.testing.assert_allclose(tread, go2w.wheel_centres(q)[leg], atol=1e-9)


def test_it_weighs_what_the_robot_weighs(model: mujoco.MjModel) -> None:
    robot = Xml.fromstring(urdf())
    masses = [float(mass.attrib["value"]) for mass in robot.iter("mass")]
    assert sum(masses) == pytest.approx(go2w.ROBOT_MASS)
    # MuJoCo takes the root for the world and leaves its mass out.
    assert model.body_mass.sum() == pytest.approx(go2w.ROBOT_MASS - go2w.BASE_LINK.mass)
    assert ROOT in {link.attrib["name"] for link in robot.iter("link")}


def test_left_and_right_mirror_each_other(model: mujoco.MjModel) -> None:
    for part in ("hip", "thigh", "wheel"):
        right, left = (model.body(f"{leg}_{part}").ipos for leg in ("FR", "FL"))
        np.testing.assert_allclose(right * [1, -1, 1], left, atol=1e-9)
