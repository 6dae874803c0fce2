"""The Jackal-like robot for MuJoCo: a box on four cylinders."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np

from hal.lidar.caster import OrientedBox
from hal.limbs import LEGS, MOTORS, SIGN_X, SIGN_Y, wheel_centres
from hal.lowlevel import Locomotion
from hal.mujoco.robot import (
    ALONG_Y,
    BOX,
    CYLINDER,
    DARK,
    LENS,
    SHELL,
    STEEL,
    collider,
    load,
    motor,
    sun,
    tread,
    visual,
)
from hal.robots.folders import describe

from .drive import Drive  # of this folder: of the copy, in a copy

CHASSIS_SIZE = 0.420, 0.310, 0.184
"""Full lengths [m]."""
WHEEL_MASS = 0.477
"""[kg]"""
WHEEL_TORQUE, FASTEST_WHEEL = 8.0, 22.0
"""Of a wheel [Nm], [rad/s]: 2 m/s."""
WHEEL_DAMPING, WHEEL_FRICTION, WHEEL_ARMATURE = 0.05, 0.1, 0.01
"""Of a wheel's drive [Nm s/rad], [Nm], [kg m^2]."""


class Jackal:
    """`hal.mujoco.robot.Simulated`."""

    def __init__(self) -> None:
        self._robot = describe(str(Path(__file__).parent))
        self.limbs, self.stand, self.legs = self._robot.limbs, self._robot.pose, None
        wheels = np.array([name.endswith("wheel") for name in MOTORS])
        self.torque_limit = np.where(wheels, WHEEL_TORQUE, 0.0)
        self.speed_limit = np.where(wheels, FASTEST_WHEEL, np.inf)
        wheel = 2.0 * self.limbs.radius, self.limbs.tread_width, 2.0 * self.limbs.radius
        centres = wheel_centres(self.limbs, self.stand).tolist()
        self.blocks = (
            OrientedBox((0.0, 0.0, 0.0), CHASSIS_SIZE),
            *(OrientedBox((x, y, z), wheel) for x, y, z in centres),
        )

    def add(
        self, spec: mujoco.MjSpec, *, friction: float, payload: float, housings: bool, looks: bool
    ) -> mujoco.MjsBody:
        """The robot over the origin; no housings stand out."""
        limbs, mass = self.limbs, self._robot.body.sprung_mass
        base = spec.worldbody.add_body(name="base_link", pos=[0.0, 0.0, self._robot.height])
        base.add_freejoint(name="base")
        base.explicitinertial = True
        base.mass = mass
        x, y, z = (side * side * mass / 12.0 for side in CHASSIS_SIZE)
        base.inertia = [y + z, x + z, x + y]
        base.add_site(name="imu", pos=self._robot.imu.translation)
        collider(base, type=BOX, size=np.array(CHASSIS_SIZE) / 2)
        if looks:
            sun(base)
            visual(base, SHELL, type=BOX, size=np.array(CHASSIS_SIZE) / 2 * (1.0, 1.0, 0.7))
            visual(base, DARK, type=BOX, size=[0.215, 0.09, 0.03], pos=[0.0, 0.0, 0.07])
            mast = self._robot.mounts["vlp16"].translation
            visual(base, STEEL, type=CYLINDER, size=[0.03, 0.05, 0.0], pos=[mast[0], mast[1], mast[2] - 0.08])
            visual(base, LENS, type=CYLINDER, size=[0.046, 0.034, 0.0], pos=mast)
        load(base, payload, [0.0, 0.0, 0.14])
        for leg, sx, sy in zip(LEGS, SIGN_X.tolist(), SIGN_Y.tolist(), strict=True):
            wheel = base.add_body(name=f"{leg}_wheel", pos=[limbs.hip_x * sx, limbs.hip_y * sy, limbs.hip_z])
            wheel.add_joint(
                name=f"{leg}_wheel",
                type=mujoco.mjtJoint.mjJNT_HINGE,
                axis=[0.0, 1.0, 0.0],
                armature=WHEEL_ARMATURE,
                damping=[WHEEL_DAMPING, 0.0, 0.0],
                frictionloss=WHEEL_FRICTION,
            )
            wheel.explicitinertial = True
            wheel.mass = WHEEL_MASS
            across = WHEEL_MASS * (3.0 * limbs.radius**2 + limbs.tread_width**2) / 12.0
            wheel.inertia = [across, 0.5 * WHEEL_MASS * limbs.radius**2, across]
            tread(wheel, f"{leg}_wheel", limbs, limbs.tread_y * sy, friction)
            if looks:
                face = [0.0, (limbs.tread_width / 2 + 0.001) * sy, 0.0]
                visual(wheel, STEEL, type=CYLINDER, size=[0.06, 0.002, 0.0], pos=face, quat=ALONG_Y)
            motor(spec, f"{leg}_wheel", WHEEL_TORQUE)
        return base

    def controller(self, name: str, policy: str | Path, period: float) -> Locomotion:
        """The one that it has."""
        return Drive(self.limbs, period)


JACKAL = Jackal()
