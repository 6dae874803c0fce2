"""Frames of the legs against the kinematics."""

from __future__ import annotations

import numpy as np

from hal.robots.go2w import facts as go2w
from hal.robots.go2w.urdf import urdf
from hal.rotation import rotation
from rbtrg_robot import msg
from rbtrg_robot.bridge.legs import Legs
from rbtrg_robot.wire.convert import xyz, xyzw
from rbtrg_robot.wire.messages import header


def test_the_wheels_are_where_the_kinematics_put_them() -> None:
    q = np.random.default_rng(1).uniform(-1.0, 1.0, 16)
    state = msg.JointState(header=header(7, "base_link"), name=list(go2w.MOTORS), position=q)
    told = {
        x.child_frame_id: (
            x.header.frame_id,
            xyz(x.transform.translation),
            rotation(xyzw(x.transform.rotation)),
        )
        for x in Legs(urdf()).frames(state).transforms
    }
    assert len(told) == 20

    def place(frame: str) -> tuple[np.ndarray, np.ndarray]:
        if frame == "base_link":
            return np.zeros(3), np.eye(3)
        parent, offset, turn = told[frame]
        origin, attitude = place(parent)
        return origin + attitude @ offset, attitude @ turn

    for leg, name in enumerate(go2w.LEGS):
        origin, attitude = place(f"{name}_wheel")
        tread = origin + attitude @ [0.0, go2w.TREAD_Y * go2w.SIGN_Y[leg], 0.0]
        np.testing.assert_allclose(tread, go2w.wheel_centres(q)[leg], atol=1e-9)


def test_a_joint_nobody_names_stands_at_zero() -> None:
    frames = Legs(urdf()).frames(msg.JointState()).transforms
    assert all(x.transform.rotation.w == 1.0 for x in frames)
