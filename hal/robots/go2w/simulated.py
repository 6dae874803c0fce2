"""The Go2-W for MuJoCo, built from the facts with primitive shapes only.

Unlike in the vendor's MJCF the wheel-motor housings collide: they leave only 36 mm below them and decide what the
robot can straddle."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np

from hal.lidar.simulator import GO2W_BODY
from hal.lowlevel import Locomotion
from hal.mujoco.robot import (
    ALONG_Y,
    BOX,
    CAPSULE,
    CYLINDER,
    SPHERE,
    collider,
    load,
    motor,
    tread,
)
from hal.robots.go2w import facts as go2w
from hal.robots.go2w.facts import Link
from hal.robots.go2w.locomotion.controllers import controller_of
from hal.robots.go2w.looks import dress_leg, dress_trunk
from hal.robots.go2w.righting import LEGS


class Go2W:
    """`hal.mujoco.robot.Simulated`."""

    limbs = go2w.LIMBS
    torque_limit, speed_limit = go2w.TORQUE_LIMIT, go2w.SPEED_LIMIT
    stand, legs = go2w.STAND, LEGS
    blocks = GO2W_BODY

    def add(
        self, spec: mujoco.MjSpec, *, friction: float, payload: float, housings: bool, looks: bool
    ) -> mujoco.MjsBody:
        """The robot over the origin. Without `housings` the collider set is that of the vendor's MJCF."""
        base = spec.worldbody.add_body(name="base_link", pos=[0.0, 0.0, go2w.stand_height(go2w.STAND)])
        base.add_freejoint(name="base")
        _set_inertia(base, go2w.BASE_LINK, 1.0, 1.0)
        base.add_site(name="imu", pos=go2w.IMU_POSITION)
        _trunk(base)
        if looks:
            dress_trunk(base)
        load(base, payload, [-0.08, 0.0, 0.13])
        for leg, name in enumerate(go2w.LEGS):
            _leg(base, name, leg, friction, housings, looks)
        for name, torque in zip(go2w.MOTORS, go2w.TORQUE_LIMIT.tolist(), strict=True):
            motor(spec, name, torque)
        return base

    def controller(self, name: str, policy: str | Path, period: float) -> Locomotion:
        """Of `hal.robots.go2w.locomotion`. Raises PolicyError."""
        return controller_of(name, policy, period)


GO2W = Go2W()


def _set_inertia(body: mujoco.MjsBody, link: Link, sx: float, sy: float) -> None:
    """Inertia of the leg at (sx, sy), mirrored from the front left one; products change sign with the mirrored axes."""
    x, y, z = link.com
    xx, yy, zz, xy, xz, yz = link.inertia
    body.explicitinertial = True
    body.mass = link.mass
    body.ipos = [x * sx, y * sy, z]
    body.fullinertia = [xx, yy, zz, xy * sx * sy, xz * sx, yz * sy]


def _merge(a: Link, b: Link) -> Link:
    """One rigid body from two."""
    mass = a.mass + b.mass
    ca, cb = np.array(a.com), np.array(b.com)
    com = (a.mass * ca + b.mass * cb) / mass
    total = np.zeros((3, 3))
    for link, centre in ((a, ca), (b, cb)):
        xx, yy, zz, xy, xz, yz = link.inertia
        d = centre - com
        total += np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        total += link.mass * (d @ d * np.eye(3) - np.outer(d, d))
    return Link(
        mass,
        (float(com[0]), float(com[1]), float(com[2])),
        (total[0, 0], total[1, 1], total[2, 2], total[0, 1], total[0, 2], total[1, 2]),
    )


def _trunk(base: mujoco.MjsBody) -> None:
    collider(base, type=BOX, size=[0.188, 0.04675, 0.057])
    collider(base, type=CYLINDER, size=[0.05, 0.045, 0.0], pos=[0.285, 0.0, 0.01])
    collider(base, type=SPHERE, size=[0.047, 0.0, 0.0], pos=[0.293, 0.0, -0.06])


def _hinge(body: mujoco.MjsBody, motor: str, axis: list[float]) -> None:
    low, high = go2w.JOINT_RANGE[go2w.MOTORS.index(motor)]
    limits: dict[str, object] = {}
    if np.isfinite(low):
        limits = {"range": [low, high], "limited": mujoco.mjtLimited.mjLIMITED_TRUE}
    body.add_joint(
        name=motor,
        type=mujoco.mjtJoint.mjJNT_HINGE,
        axis=axis,
        armature=go2w.MOTOR_ARMATURE,
        damping=[go2w.JOINT_DAMPING, 0.0, 0.0],
        frictionloss=go2w.JOINT_FRICTION,
        **limits,
    )


def _leg(base: mujoco.MjsBody, name: str, leg: int, friction: float, housings: bool, looks: bool) -> None:
    sx, sy = float(go2w.SIGN_X[leg]), float(go2w.SIGN_Y[leg])
    hip = base.add_body(name=f"{name}_hip", pos=[go2w.HIP_X * sx, go2w.HIP_Y * sy, 0.0])
    _hinge(hip, f"{name}_hip", [1.0, 0.0, 0.0])
    _set_inertia(hip, go2w.HIP_LINK, sx, sy)
    collider(hip, type=CYLINDER, size=[0.046, 0.02, 0.0], pos=[0.0, 0.08 * sy, 0.0], quat=ALONG_Y)

    thigh = hip.add_body(name=f"{name}_thigh", pos=[0.0, go2w.THIGH_Y * sy, 0.0])
    _hinge(thigh, f"{name}_thigh", [0.0, 1.0, 0.0])
    _set_inertia(thigh, go2w.THIGH_LINK, 1.0, sy)
    collider(
        thigh,
        type=BOX,
        size=[0.017, 0.01225, 0.1065],
        pos=[0.0, 0.0, -go2w.THIGH / 2],
    )

    calf = thigh.add_body(name=f"{name}_calf", pos=[0.0, 0.0, -go2w.THIGH])
    _hinge(calf, f"{name}_calf", [0.0, 1.0, 0.0])
    _set_inertia(calf, _merge(go2w.CALF_LINK, go2w.WHEEL_MOTOR), 1.0, sy)
    axle = [0.0, 0.01 * sy, -go2w.CALF]
    if housings:
        collider(calf, name=f"{name}_housing", type=CYLINDER, size=[0.05, 0.025, 0.0], pos=axle, quat=ALONG_Y)
    collider(calf, type=CAPSULE, size=[0.013, 0.0, 0.0], fromto=[0, 0, -0.02, 0, 0, -0.18])

    wheel = calf.add_body(name=f"{name}_wheel", pos=[0.0, 0.0, -go2w.CALF])
    _hinge(wheel, f"{name}_wheel", [0.0, 1.0, 0.0])
    _set_inertia(wheel, go2w.WHEEL_LINK, 1.0, sy)
    tread(wheel, f"{name}_wheel", go2w.LIMBS, go2w.TREAD_Y * sy, friction)
    if looks:
        dress_leg(hip, thigh, calf, wheel, sx, sy)
