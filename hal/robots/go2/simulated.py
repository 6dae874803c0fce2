"""The Go2 for MuJoCo, of primitive shapes only."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np

from hal.lidar.caster import OrientedBox
from hal.limbs import LEGS, MOTORS, SIGN_X, SIGN_Y
from hal.lowlevel import Locomotion
from hal.mujoco.robot import (
    ALONG_Y,
    BOX,
    CAPSULE,
    CYLINDER,
    DARK,
    LENS,
    SHELL,
    SPHERE,
    collider,
    load,
    motor,
    on_ground,
    sun,
    visual,
)
from hal.postures.legs import Legs
from hal.robots.folders import describe
from hal.types import Array

from .trot import Trot, leg_angles

TRUNK_MASS, HIP_MASS, THIGH_MASS, CALF_MASS = 6.921, 0.678, 1.152, 0.194
"""Masses [kg]; the calf with its foot."""
TRUNK_INERTIA = (0.0245, 0.0981, 0.107)
"""[kg m^2]"""
JOINT_RANGE = np.array([(-1.0472, 1.0472), (-1.5708, 3.4907), (-2.7227, -0.83776)] * 4)
"""(12, 2) [rad]; rear thighs turn further, which a trot does not need."""
MOST_TORQUE, FASTEST_JOINT = (23.7, 23.7, 45.43), (30.1, 30.1, 15.7)
"""[Nm], [rad/s] of hip, thigh, calf."""
JOINT_ARMATURE, JOINT_DAMPING, JOINT_FRICTION = 0.01, 0.1, 0.2
"""[kg m^2], [Nm s/rad], [Nm] of each joint."""
SEAT_POSE = (0.0, 1.36, -2.65)
FOOT_CONTACT = [0.01, 1.0]
"""Contact of a foot: time constant [s] and damping ratio. MuJoCo's own 0.02 s lets a foot of this size sink below the
heightfield, which then holds it on all sides."""


class Go2:
    """`hal.mujoco.robot.Simulated`."""

    def __init__(self) -> None:
        self._robot = describe(str(Path(__file__).parent))
        self.limbs, self.stand = self._robot.limbs, self._robot.pose
        self.torque_limit = np.array([*MOST_TORQUE * 4, *[0.0] * 4])
        self.speed_limit = np.array([*FASTEST_JOINT * 4, *[np.inf] * 4])
        seat = np.array([*SEAT_POSE * 4, *[0.0] * 4])
        x, y = self.limbs.hip_x, self.limbs.hip_y + self.limbs.thigh_y
        hips = [(x, y), (x, -y), (-x, y), (-x, -y)]
        self.blocks = (
            OrientedBox((0.0, 0.0, 0.0), (0.40, 0.20, 0.114)),
            OrientedBox((0.285, 0.0, 0.02), (0.11, 0.10, 0.08)),
            *(OrientedBox((*hip, -0.15), (0.22, 0.06, 0.28)) for hip in hips),
        )
        self.legs: Legs | None = Legs(self.limbs, self.stand, seat, tall=0.20, angles=self._angles)

    def _angles(self, centres: Array) -> Array:
        """Inside the joints' limits."""
        q = leg_angles(self.limbs, centres)
        q[:12] = np.clip(q[:12], JOINT_RANGE[:, 0], JOINT_RANGE[:, 1])
        return q

    def add(
        self, spec: mujoco.MjSpec, *, friction: float, payload: float, housings: bool, looks: bool
    ) -> mujoco.MjsBody:
        """The robot over the origin; it has no housings that stand out."""
        base = spec.worldbody.add_body(name="base_link", pos=[0.0, 0.0, self._robot.height])
        base.add_freejoint(name="base")
        base.explicitinertial = True
        base.mass, base.ipos, base.inertia = TRUNK_MASS, [0.0211, 0.0, -0.0054], TRUNK_INERTIA
        base.add_site(name="imu", pos=self._robot.imu.translation)
        collider(base, type=BOX, size=[0.188, 0.04675, 0.057])
        collider(base, type=CYLINDER, size=[0.05, 0.045, 0.0], pos=[0.285, 0.0, 0.01])
        if looks:
            sun(base)
            visual(base, SHELL, type=BOX, size=[0.20, 0.052, 0.055])
            visual(base, DARK, type=SPHERE, size=[0.055, 0.0, 0.0], pos=[0.28, 0.0, 0.0])
            visual(base, LENS, type=SPHERE, size=[0.044, 0.0, 0.0], pos=[0.29, 0.0, -0.05])
        load(base, payload, [-0.08, 0.0, 0.13])
        for leg, name in enumerate(LEGS):
            self._leg(base, name, float(SIGN_X[leg]), float(SIGN_Y[leg]), friction, looks)
        for k, name in enumerate(MOTORS[:12]):
            motor(spec, name, MOST_TORQUE[k % 3])
        return base

    def _leg(
        self, base: mujoco.MjsBody, name: str, sx: float, sy: float, friction: float, looks: bool
    ) -> None:
        limbs = self.limbs
        hip = self._link(
            base, f"{name}_hip", [limbs.hip_x * sx, limbs.hip_y * sy, 0.0], [1.0, 0.0, 0.0], HIP_MASS
        )
        hip.ipos = [-0.0054 * sx, 0.0019 * sy, 0.0]
        collider(hip, type=CYLINDER, size=[0.046, 0.02, 0.0], pos=[0.0, 0.08 * sy, 0.0], quat=ALONG_Y)
        thigh = self._link(hip, f"{name}_thigh", [0.0, limbs.thigh_y * sy, 0.0], [0.0, 1.0, 0.0], THIGH_MASS)
        thigh.ipos = [-0.0037, -0.0223 * sy, -0.0327]
        collider(thigh, type=BOX, size=[0.017, 0.01225, 0.1065], pos=[0.0, 0.0, -limbs.thigh / 2])
        calf = self._link(thigh, f"{name}_calf", [0.0, 0.0, -limbs.thigh], [0.0, 1.0, 0.0], CALF_MASS)
        calf.ipos = [0.0055, 0.0, -0.13]
        collider(calf, type=CAPSULE, size=[0.012, 0.0, 0.0], fromto=[0, 0, -0.02, 0, 0, -0.17])
        foot = {"size": [limbs.radius, 0.0, 0.0], "pos": [0.0, 0.0, -limbs.calf], "solref": FOOT_CONTACT}
        on_ground(calf, f"{name}_wheel", friction, type=SPHERE, **foot)
        if looks:
            visual(hip, DARK, type=CYLINDER, size=[0.046, 0.03, 0.0], pos=[0.0, 0.07 * sy, 0.0], quat=ALONG_Y)
            visual(thigh, SHELL, type=CAPSULE, size=[0.026, 0.0, 0.0], fromto=[0, 0, -0.02, 0, 0, -0.19])
            visual(calf, DARK, type=CAPSULE, size=[0.014, 0.0, 0.0], fromto=[0, 0, -0.01, 0, 0, -0.20])

    def _link(
        self, parent: mujoco.MjsBody, name: str, place: list[float], axis: list[float], mass: float
    ) -> mujoco.MjsBody:
        low, high = JOINT_RANGE[MOTORS.index(name)]
        body = parent.add_body(name=name, pos=place)
        body.add_joint(
            name=name,
            type=mujoco.mjtJoint.mjJNT_HINGE,
            axis=axis,
            armature=JOINT_ARMATURE,
            damping=[JOINT_DAMPING, 0.0, 0.0],
            frictionloss=JOINT_FRICTION,
            range=[low, high],
            limited=mujoco.mjtLimited.mjLIMITED_TRUE,
        )
        body.explicitinertial = True
        body.mass = mass
        slim = 0.25 * mass * 0.03**2
        body.inertia = [mass * 0.2**2 / 12.0, mass * 0.2**2 / 12.0, slim] if axis[1] else [slim, slim, slim]
        return body

    def controller(self, name: str, policy: str | Path, period: float) -> Locomotion:
        """The one that it has."""
        return Trot(self.limbs, self.stand, self._robot.body.mass, period)


GO2 = Go2()
