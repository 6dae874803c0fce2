"""Looks of the simulated Go2-W: shapes that do not collide (group 2)."""

from __future__ import annotations

from math import pi

import mujoco
import numpy as np

from hal.mujoco.robot import (
    ALONG_X,
    ALONG_Y,
    BOX,
    CAPSULE,
    CYLINDER,
    DARK,
    ELLIPSOID,
    LAMP,
    LENS,
    SHELL,
    SPHERE,
    STEEL,
    sun,
    visual,
)
from hal.robots.go2w import facts as go2w


def dress_trunk(base: mujoco.MjsBody) -> None:
    """Shell with sloped shoulders, dark belly, rails, head with lamp and the L1 below it, XT16 on a mast; the sun
    above."""
    sun(base)
    visual(base, SHELL, type=BOX, size=[0.185, 0.052, 0.040], pos=[0.0, 0.0, 0.016])
    visual(base, SHELL, type=CAPSULE, size=[0.046, 0.170, 0.0], pos=[0.0, 0.0, 0.022], quat=ALONG_X)
    visual(base, DARK, type=BOX, size=[0.188, 0.046, 0.030], pos=[0.0, 0.0, -0.028])
    for side in (-1.0, 1.0):
        visual(
            base, DARK, type=CAPSULE, size=[0.007, 0.16, 0.0], pos=[0.0, 0.040 * side, 0.066], quat=ALONG_X
        )
        visual(base, STEEL, type=BOX, size=[0.060, 0.003, 0.024], pos=[0.0, 0.053 * side, 0.012])
    for end in (-1.0, 1.0):
        visual(base, DARK, type=BOX, size=[0.028, 0.058, 0.044], pos=[0.193 * end, 0.0, 0.0])
    visual(base, SHELL, type=ELLIPSOID, size=[0.075, 0.052, 0.046], pos=[0.262, 0.0, 0.020])
    visual(base, DARK, type=ELLIPSOID, size=[0.046, 0.042, 0.036], pos=[0.302, 0.0, 0.006])
    visual(base, LAMP, type=SPHERE, size=[0.010, 0.0, 0.0], pos=[0.344, 0.0, 0.012])
    visual(base, LENS, type=SPHERE, size=[0.044, 0.0, 0.0], pos=[0.290, 0.0, -0.052])
    visual(base, DARK, type=CYLINDER, size=[0.046, 0.012, 0.0], pos=[0.288, 0.0, -0.026])
    x, y, z = go2w.XT16_MOUNT.translation
    visual(base, STEEL, type=CYLINDER, size=[0.040, 0.010, 0.0], pos=[x, y, z - 0.048])
    visual(base, DARK, type=CYLINDER, size=[0.046, 0.034, 0.0], pos=[x, y, z - 0.004])
    visual(base, LENS, type=CYLINDER, size=[0.0465, 0.016, 0.0], pos=[x, y, z])
    visual(base, STEEL, type=CYLINDER, size=[0.046, 0.006, 0.0], pos=[x, y, z + 0.032])


def dress_leg(
    hip: mujoco.MjsBody,
    thigh: mujoco.MjsBody,
    calf: mujoco.MjsBody,
    wheel: mujoco.MjsBody,
    sx: float,
    sy: float,
) -> None:
    """Motors, links and the wheel of the leg at sx (front +1), sy (left +1)."""
    visual(
        hip,
        STEEL,
        type=CYLINDER,
        size=[0.041, 0.026, 0.0],
        pos=[-0.022 * sx, 0.004 * sy, 0.0],
        quat=ALONG_X,
    )
    visual(hip, DARK, type=CYLINDER, size=[0.046, 0.024, 0.0], pos=[0.0, 0.076 * sy, 0.0], quat=ALONG_Y)
    visual(thigh, STEEL, type=CYLINDER, size=[0.045, 0.020, 0.0], pos=[0.0, -0.030 * sy, 0.0], quat=ALONG_Y)
    visual(thigh, SHELL, type=CYLINDER, size=[0.042, 0.014, 0.0], quat=ALONG_Y)
    visual(thigh, SHELL, type=CAPSULE, size=[0.025, 0.0, 0.0], fromto=[0.006, 0, -0.02, 0.002, 0, -0.19])
    visual(thigh, DARK, type=CYLINDER, size=[0.026, 0.017, 0.0], pos=[0.0, 0.0, -go2w.THIGH], quat=ALONG_Y)
    axle = [0.0, 0.01 * sy, -go2w.CALF]
    visual(calf, DARK, type=CAPSULE, size=[0.016, 0.0, 0.0], fromto=[0.004, 0, -0.01, 0.002, 0, -0.19])
    visual(calf, DARK, type=CYLINDER, size=[0.049, 0.025, 0.0], pos=axle, quat=ALONG_Y)
    visual(
        calf,
        STEEL,
        type=CYLINDER,
        size=[0.038, 0.003, 0.0],
        pos=[0, -0.017 * sy, -go2w.CALF],
        quat=ALONG_Y,
    )
    face = go2w.TREAD_Y + go2w.TREAD_WIDTH / 2
    visual(
        wheel,
        STEEL,
        type=CYLINDER,
        size=[0.056, 0.002, 0.0],
        pos=[0, (face + 0.001) * sy, 0],
        quat=ALONG_Y,
    )
    visual(
        wheel, DARK, type=CYLINDER, size=[0.020, 0.003, 0.0], pos=[0, (face + 0.002) * sy, 0], quat=ALONG_Y
    )
    for k in range(5):
        angle = 2.0 * pi * k / 5
        spoke = [0.036 * np.cos(angle), (face + 0.002) * sy, 0.036 * np.sin(angle)]
        visual(wheel, DARK, type=CYLINDER, size=[0.010, 0.002, 0.0], pos=spoke, quat=ALONG_Y)
