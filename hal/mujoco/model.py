"""The Go2-W and its ground as a MuJoCo model, built from the facts in `hal.go2w` with primitive shapes only.

Contact follows the vendor's MJCF (unitreerobotics/unitree_mujoco): elliptic cones, impratio 100, wheels of priority 1 with
friction mu and .02 m against spinning on the spot. Unlike it, wheels have no rolling friction: that shares the friction cone with
sliding, so a wheel that rolls has no grip left until it slips, and covers 0.90 to 1.01 of its circumference, by speed, direction and time
step. Without it, it covers 0.998 to 1.000. Unlike it, too, the wheel-motor housings collide: they leave only 36 mm below them and decide
what the robot can straddle. Geoms of group 3 collide and are not drawn; group 2 is drawn and does not collide; group 1 does both.
The robot does not collide with itself.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from hal import go2w
from hal.camera import MountedCamera
from hal.go2w import Link
from hal.mujoco.looks import (
    ALONG_Y,
    BOX,
    CAPSULE,
    CYLINDER,
    SPHERE,
    STEEL,
    TYRE,
    dress_leg,
    dress_trunk,
    dress_world,
    visual,
)

BODY_FRICTION = 0.4
"""Sliding friction of everything but the wheels."""
SPIN_FRICTION = 0.02
"""Of a wheel that turns about the contact's normal [m]."""
BASE_THICKNESS = 0.5
"""Ground below the lowest point of the terrain [m]."""
HIDDEN = (0.0, 0.0, -100.0)
"""Where obstacles wait [m]."""


def build(
    height: NDArray[np.float32],
    resolution: float,
    origin: tuple[float, float],
    *,
    friction: float = 0.8,
    timestep: float = 0.005,
    payload: float = 0.0,
    boxes: Sequence[tuple[float, float, float]] = (),
    housings: bool = True,
    looks: bool = True,
    camera: MountedCamera | None = None,
) -> mujoco.MjModel:
    """Robot on terrain.

    `height`: (rows, cols) [m], cell [0, 0] centred on `origin` (x, y [m]); `friction`: sliding friction of the wheels;
    `payload`: mass [kg] fixed on top of the trunk; `boxes`: full lengths [m] of mocap boxes (`box0`...) kept out of sight below the
    ground until they are placed; `housings`: the wheel-motor housings collide. False is the collider set of the vendor's MJCF.
    `looks`: with the parts that are only drawn; `camera`: one on the trunk to look through.

    Actuator i drives motor i of `hal.go2w.MOTORS` with force = ctrl + biasprm[1] q + biasprm[2] dq, clipped by the motor's
    torque limit; the simulation writes the gains of the current command into `actuator_biasprm`.
    """
    spec = mujoco.MjSpec()
    spec.modelname = "go2w"
    spec.compiler.degree = False
    spec.compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_FALSE
    option = spec.option
    option.timestep = timestep
    # Damping and motor gains enter implicitly: kd 5 on a calf of 0.012 kg m2 is unstable explicitly at 5 ms.
    option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    option.impratio = 100.0
    # Four wheels give 60 to 120 constraint rows on 22 velocities: sparse is a third faster than the default for so few.
    option.jacobian = mujoco.mjtJacobian.mjJAC_SPARSE
    if looks:
        dress_world(spec)
    _terrain(spec, np.asarray(height, np.float64), resolution, origin, looks)
    _robot(spec, friction, payload, housings, looks)
    if camera is not None:
        quat = np.empty(4)
        mujoco.mju_mat2Quat(
            quat, (camera.rotation * (1.0, -1.0, -1.0)).ravel()
        )  # MuJoCo looks along -z, y up
        spec.body("base_link").add_camera(
            name=camera.name, pos=camera.mount.translation, quat=quat, fovy=math.degrees(camera.vertical_fov)
        )
    for index, size in enumerate(boxes):
        _obstacle(spec, index, size)
    return spec.compile()


def _terrain(
    spec: mujoco.MjSpec,
    height: NDArray[np.float64],
    resolution: float,
    origin: tuple[float, float],
    looks: bool,
) -> None:
    rows, cols = height.shape
    low = float(height.min())
    span = max(float(height.max()) - low, 1e-3)
    # MuJoCo spreads n samples over 2 * size: only (n - 1) * resolution / 2 keeps the map unscaled.
    half = 0.5 * resolution * np.array([cols - 1, rows - 1])
    spec.add_hfield(
        name="terrain",
        nrow=rows,
        ncol=cols,
        size=[half[0], half[1], span, BASE_THICKNESS],
        userdata=((height - low) / span).astype(np.float32).ravel(),
    )
    spec.worldbody.add_geom(
        name="terrain",
        type=mujoco.mjtGeom.mjGEOM_HFIELD,
        hfieldname="terrain",
        pos=[origin[0] + half[0], origin[1] + half[1], low],
        **({"material": "ground"} if looks else {}),
        contype=2,
        conaffinity=1,
        friction=[BODY_FRICTION, 0.005, 0.0001],
        group=0,
    )


def _obstacle(spec: mujoco.MjSpec, index: int, size: tuple[float, float, float]) -> None:
    body = spec.worldbody.add_body(name=f"box{index}", mocap=True, pos=HIDDEN)
    body.add_geom(
        name=f"box{index}",
        type=BOX,
        size=0.5 * np.asarray(size),
        rgba=[0.75, 0.42, 0.18, 1.0],
        contype=2,
        conaffinity=1,
        friction=[BODY_FRICTION, 0.005, 0.0001],
        group=1,
    )


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


def _collider(body: mujoco.MjsBody, **shape: object) -> None:
    body.add_geom(
        contype=1,
        conaffinity=2,
        condim=3,
        friction=[BODY_FRICTION, 0.005, 0.0001],
        group=3,
        rgba=[0.8, 0.3, 0.3, 0.4],
        **shape,
    )


def _robot(spec: mujoco.MjSpec, friction: float, payload: float, housings: bool, looks: bool) -> None:
    base = spec.worldbody.add_body(name="base_link", pos=[0.0, 0.0, go2w.stand_height(go2w.STAND)])
    base.add_freejoint(name="base")
    _set_inertia(base, go2w.BASE, 1.0, 1.0)
    base.add_site(name="imu", pos=go2w.IMU_POSITION)
    _trunk(base)
    if looks:
        dress_trunk(base)
    if payload > 0.0:
        # High up, where it hurts balance most: a box of batteries on the rails.
        visual(base, STEEL, type=BOX, size=[0.10, 0.08, 0.05], pos=[-0.08, 0.0, 0.13])
        load = base.add_body(name="payload", pos=[-0.08, 0.0, 0.13])
        load.explicitinertial = True
        load.mass = payload
        load.inertia = payload / 12.0 * np.array([0.16**2 + 0.1**2, 0.2**2 + 0.1**2, 0.2**2 + 0.16**2])
    for leg, name in enumerate(go2w.LEGS):
        _leg(base, name, leg, friction, housings, looks)
    for motor, name in enumerate(go2w.MOTORS):
        limit = float(go2w.TORQUE_LIMIT[motor])
        spec.add_actuator(
            name=name,
            target=name,
            trntype=mujoco.mjtTrn.mjTRN_JOINT,
            gaintype=mujoco.mjtGain.mjGAIN_FIXED,
            biastype=mujoco.mjtBias.mjBIAS_AFFINE,
            gainprm=[1.0] + [0.0] * 9,
            forcelimited=True,
            forcerange=[-limit, limit],
        )
    spec.add_sensor(
        name="accelerometer",
        type=mujoco.mjtSensor.mjSENS_ACCELEROMETER,
        objtype=mujoco.mjtObj.mjOBJ_SITE,
        objname="imu",
    )


def _trunk(base: mujoco.MjsBody) -> None:
    _collider(base, type=BOX, size=[0.188, 0.04675, 0.057])
    _collider(base, type=CYLINDER, size=[0.05, 0.045, 0.0], pos=[0.285, 0.0, 0.01])
    _collider(base, type=SPHERE, size=[0.047, 0.0, 0.0], pos=[0.293, 0.0, -0.06])


def _hinge(body: mujoco.MjsBody, motor: str, axis: list[float]) -> None:
    low, high = go2w.JOINT_RANGE[go2w.MOTORS.index(motor)]
    limits: dict[str, object] = {}
    if np.isfinite(low):
        limits = {"range": [low, high], "limited": mujoco.mjtLimited.mjLIMITED_TRUE}
    body.add_joint(
        name=motor,
        type=mujoco.mjtJoint.mjJNT_HINGE,
        axis=axis,
        armature=go2w.ARMATURE,
        damping=[go2w.DAMPING, 0.0, 0.0],
        frictionloss=go2w.FRICTIONLOSS,
        **limits,
    )


def _leg(base: mujoco.MjsBody, name: str, leg: int, friction: float, housings: bool, looks: bool) -> None:
    sx, sy = float(go2w.SX[leg]), float(go2w.SY[leg])
    hip = base.add_body(name=f"{name}_hip", pos=[go2w.HIP_X * sx, go2w.HIP_Y * sy, 0.0])
    _hinge(hip, f"{name}_hip", [1.0, 0.0, 0.0])
    _set_inertia(hip, go2w.HIP, sx, sy)
    _collider(hip, type=CYLINDER, size=[0.046, 0.02, 0.0], pos=[0.0, 0.08 * sy, 0.0], quat=ALONG_Y)

    thigh = hip.add_body(name=f"{name}_thigh", pos=[0.0, go2w.THIGH_Y * sy, 0.0])
    _hinge(thigh, f"{name}_thigh", [0.0, 1.0, 0.0])
    _set_inertia(thigh, go2w.THIGH_LINK, 1.0, sy)
    _collider(
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
        _collider(
            calf, name=f"{name}_housing", type=CYLINDER, size=[0.05, 0.025, 0.0], pos=axle, quat=ALONG_Y
        )
    _collider(calf, type=CAPSULE, size=[0.013, 0.0, 0.0], fromto=[0, 0, -0.02, 0, 0, -0.18])

    wheel = calf.add_body(name=f"{name}_wheel", pos=[0.0, 0.0, -go2w.CALF])
    _hinge(wheel, f"{name}_wheel", [0.0, 1.0, 0.0])
    _set_inertia(wheel, go2w.WHEEL, 1.0, sy)
    tread = [0.0, go2w.TREAD_Y * sy, 0.0]
    wheel.add_geom(
        name=f"{name}_wheel",
        type=CYLINDER,
        size=[go2w.WHEEL_RADIUS, go2w.TREAD_WIDTH / 2, 0.0],
        pos=tread,
        quat=ALONG_Y,
        contype=1,
        conaffinity=2,
        condim=4,
        priority=1,
        friction=[friction, SPIN_FRICTION, 0.0],
        rgba=TYRE,
        group=1,
    )
    if looks:
        dress_leg(hip, thigh, calf, wheel, sx, sy)
