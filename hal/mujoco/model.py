"""The Go2-W and its ground as a MuJoCo model, built from the facts in `hal.go2w` with primitive shapes only.

Contact follows the vendor's MJCF (unitreerobotics/unitree_mujoco): elliptic cones, impratio 100, wheels of priority 1 with
friction (mu, .02, .01). Unlike it, the wheel-motor housings collide: they leave only 36 mm below them and decide what the
robot can straddle. Geoms of group 3 collide and are not drawn; group 2 is drawn and does not collide; group 1 does both.
The robot does not collide with itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import pi

import mujoco
import numpy as np
from numpy.typing import NDArray

from hal import go2w
from hal.go2w import Link

BODY_FRICTION = 0.4
"""Sliding friction of everything but the wheels."""
BASE_THICKNESS = 0.5
"""Ground below the lowest point of the terrain [m]."""
HIDDEN = (0.0, 0.0, -100.0)
"""Where obstacles wait [m]."""

_SHELL = (0.80, 0.81, 0.83, 1.0)
_DARK = (0.13, 0.14, 0.16, 1.0)
_STEEL = (0.42, 0.44, 0.47, 1.0)
_TYRE = (0.06, 0.06, 0.07, 1.0)
_LENS = (0.02, 0.10, 0.16, 1.0)
_LAMP = (0.75, 0.93, 1.0, 1.0)

_BOX = mujoco.mjtGeom.mjGEOM_BOX
_CYLINDER = mujoco.mjtGeom.mjGEOM_CYLINDER
_CAPSULE = mujoco.mjtGeom.mjGEOM_CAPSULE
_SPHERE = mujoco.mjtGeom.mjGEOM_SPHERE
_ELLIPSOID = mujoco.mjtGeom.mjGEOM_ELLIPSOID
_ALONG_Y = (np.cos(pi / 4), np.sin(pi / 4), 0.0, 0.0)
"""Quaternion that lays a cylinder's axis along y."""
_ALONG_X = (np.cos(pi / 4), 0.0, np.sin(pi / 4), 0.0)


def build(
    height: NDArray[np.float32],
    resolution: float,
    origin: tuple[float, float],
    *,
    friction: float = 0.8,
    timestep: float = 0.005,
    payload: float = 0.0,
    boxes: Sequence[tuple[float, float, float]] = (),
) -> mujoco.MjModel:
    """Robot on terrain.

    `height`: (rows, cols) [m], cell [0, 0] centred on `origin` (x, y [m]); `friction`: sliding friction of the wheels;
    `payload`: mass [kg] fixed on top of the trunk; `boxes`: full lengths [m] of mocap boxes (`box0`...) kept out of sight below the
    ground until they are placed.

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
    _looks(spec)
    _terrain(spec, np.asarray(height, np.float64), resolution, origin)
    _robot(spec, friction, payload)
    for index, size in enumerate(boxes):
        _obstacle(spec, index, size)
    return spec.compile()


def _looks(spec: mujoco.MjSpec) -> None:
    # Clipping planes and shadows are sized by the extent, which must not count the obstacles hidden far below.
    spec.stat.extent = 4.0
    visual = spec.visual
    visual.headlight.ambient[:] = 0.32
    visual.headlight.diffuse[:] = 0.30
    visual.headlight.specular[:] = 0.1
    visual.map.znear = 0.01
    visual.quality.shadowsize = 2048
    getattr(visual, "global").offwidth = 1920
    getattr(visual, "global").offheight = 1080
    spec.add_texture(
        name="sky",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=[0.62, 0.72, 0.82],
        rgb2=[0.93, 0.94, 0.95],
        width=256,
        height=256,
    )
    spec.add_texture(
        name="ground",
        type=mujoco.mjtTexture.mjTEXTURE_2D,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_CHECKER,
        rgb1=[0.60, 0.58, 0.54],
        rgb2=[0.54, 0.52, 0.48],
        width=256,
        height=256,
    )
    ground = spec.add_material(name="ground", texuniform=True, texrepeat=[1.0, 1.0], reflectance=0.0)
    ground.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "ground"
    ground.specular = 0.05


def _terrain(
    spec: mujoco.MjSpec, height: NDArray[np.float64], resolution: float, origin: tuple[float, float]
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
        material="ground",
        contype=2,
        conaffinity=1,
        friction=[BODY_FRICTION, 0.005, 0.0001],
        group=0,
    )


def _obstacle(spec: mujoco.MjSpec, index: int, size: tuple[float, float, float]) -> None:
    body = spec.worldbody.add_body(name=f"box{index}", mocap=True, pos=HIDDEN)
    body.add_geom(
        name=f"box{index}",
        type=_BOX,
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


def _visual(body: mujoco.MjsBody, rgba: tuple[float, float, float, float], **shape: object) -> None:
    body.add_geom(contype=0, conaffinity=0, group=2, rgba=rgba, **shape)


def _robot(spec: mujoco.MjSpec, friction: float, payload: float) -> None:
    base = spec.worldbody.add_body(name="base_link", pos=[0.0, 0.0, go2w.stand_height(go2w.STAND)])
    base.add_freejoint(name="base")
    _set_inertia(base, go2w.BASE, 1.0, 1.0)
    base.add_site(name="imu", pos=go2w.IMU_POSITION)
    # The sun goes with the robot, so that its shadow map does.
    base.add_light(
        name="sun",
        mode=mujoco.mjtCamLight.mjCAMLIGHT_TRACK,
        type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
        pos=[-2.0, -2.6, 4.8],
        dir=[0.35, 0.45, -0.82],
        diffuse=[0.62, 0.60, 0.56],
        specular=[0.2, 0.2, 0.2],
        castshadow=True,
    )
    _trunk(base)
    if payload > 0.0:
        # High up, where it hurts balance most: a box of batteries on the rails.
        _visual(base, _STEEL, type=_BOX, size=[0.10, 0.08, 0.05], pos=[-0.08, 0.0, 0.13])
        load = base.add_body(name="payload", pos=[-0.08, 0.0, 0.13])
        load.explicitinertial = True
        load.mass = payload
        load.inertia = payload / 12.0 * np.array([0.16**2 + 0.1**2, 0.2**2 + 0.1**2, 0.2**2 + 0.16**2])
    for leg, name in enumerate(go2w.LEGS):
        _leg(base, name, leg, friction)
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
    _collider(base, type=_BOX, size=[0.188, 0.04675, 0.057])
    _collider(base, type=_CYLINDER, size=[0.05, 0.045, 0.0], pos=[0.285, 0.0, 0.01])
    _collider(base, type=_SPHERE, size=[0.047, 0.0, 0.0], pos=[0.293, 0.0, -0.06])
    # Shell with sloped shoulders, dark belly, rails, hip blocks, head with lamp and the L1 below it, XT16 on a mast.
    _visual(base, _SHELL, type=_BOX, size=[0.185, 0.052, 0.040], pos=[0.0, 0.0, 0.016])
    _visual(base, _SHELL, type=_CAPSULE, size=[0.046, 0.170, 0.0], pos=[0.0, 0.0, 0.022], quat=_ALONG_X)
    _visual(base, _DARK, type=_BOX, size=[0.188, 0.046, 0.030], pos=[0.0, 0.0, -0.028])
    for side in (-1.0, 1.0):
        _visual(
            base, _DARK, type=_CAPSULE, size=[0.007, 0.16, 0.0], pos=[0.0, 0.040 * side, 0.066], quat=_ALONG_X
        )
        _visual(base, _STEEL, type=_BOX, size=[0.060, 0.003, 0.024], pos=[0.0, 0.053 * side, 0.012])
    for end in (-1.0, 1.0):
        _visual(base, _DARK, type=_BOX, size=[0.028, 0.058, 0.044], pos=[0.193 * end, 0.0, 0.0])
    _visual(base, _SHELL, type=_ELLIPSOID, size=[0.075, 0.052, 0.046], pos=[0.262, 0.0, 0.020])
    _visual(base, _DARK, type=_ELLIPSOID, size=[0.046, 0.042, 0.036], pos=[0.302, 0.0, 0.006])
    _visual(base, _LAMP, type=_SPHERE, size=[0.010, 0.0, 0.0], pos=[0.344, 0.0, 0.012])
    _visual(base, _LENS, type=_SPHERE, size=[0.044, 0.0, 0.0], pos=[0.290, 0.0, -0.052])
    _visual(base, _DARK, type=_CYLINDER, size=[0.046, 0.012, 0.0], pos=[0.288, 0.0, -0.026])
    x, y, z = go2w.XT16_MOUNT[0]
    _visual(base, _STEEL, type=_CYLINDER, size=[0.040, 0.010, 0.0], pos=[x, y, z - 0.048])
    _visual(base, _DARK, type=_CYLINDER, size=[0.046, 0.034, 0.0], pos=[x, y, z - 0.004])
    _visual(base, _LENS, type=_CYLINDER, size=[0.0465, 0.016, 0.0], pos=[x, y, z])
    _visual(base, _STEEL, type=_CYLINDER, size=[0.046, 0.006, 0.0], pos=[x, y, z + 0.032])


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


def _leg(base: mujoco.MjsBody, name: str, leg: int, friction: float) -> None:
    sx, sy = float(go2w.SX[leg]), float(go2w.SY[leg])
    hip = base.add_body(name=f"{name}_hip", pos=[go2w.HIP_X * sx, go2w.HIP_Y * sy, 0.0])
    _hinge(hip, f"{name}_hip", [1.0, 0.0, 0.0])
    _set_inertia(hip, go2w.HIP, sx, sy)
    _collider(hip, type=_CYLINDER, size=[0.046, 0.02, 0.0], pos=[0.0, 0.08 * sy, 0.0], quat=_ALONG_Y)
    _visual(
        hip,
        _STEEL,
        type=_CYLINDER,
        size=[0.041, 0.026, 0.0],
        pos=[-0.022 * sx, 0.004 * sy, 0.0],
        quat=_ALONG_X,
    )
    _visual(hip, _DARK, type=_CYLINDER, size=[0.046, 0.024, 0.0], pos=[0.0, 0.076 * sy, 0.0], quat=_ALONG_Y)

    thigh = hip.add_body(name=f"{name}_thigh", pos=[0.0, go2w.THIGH_Y * sy, 0.0])
    _hinge(thigh, f"{name}_thigh", [0.0, 1.0, 0.0])
    _set_inertia(thigh, go2w.THIGH_LINK, 1.0, sy)
    _collider(
        thigh,
        type=_BOX,
        size=[0.017, 0.01225, 0.1065],
        pos=[0.0, 0.0, -go2w.THIGH / 2],
    )
    _visual(
        thigh, _STEEL, type=_CYLINDER, size=[0.045, 0.020, 0.0], pos=[0.0, -0.030 * sy, 0.0], quat=_ALONG_Y
    )
    _visual(thigh, _SHELL, type=_CYLINDER, size=[0.042, 0.014, 0.0], quat=_ALONG_Y)
    _visual(thigh, _SHELL, type=_CAPSULE, size=[0.025, 0.0, 0.0], fromto=[0.006, 0, -0.02, 0.002, 0, -0.19])
    _visual(
        thigh, _DARK, type=_CYLINDER, size=[0.026, 0.017, 0.0], pos=[0.0, 0.0, -go2w.THIGH], quat=_ALONG_Y
    )

    calf = thigh.add_body(name=f"{name}_calf", pos=[0.0, 0.0, -go2w.THIGH])
    _hinge(calf, f"{name}_calf", [0.0, 1.0, 0.0])
    _set_inertia(calf, _merge(go2w.CALF_LINK, go2w.WHEEL_MOTOR), 1.0, sy)
    axle = [0.0, 0.01 * sy, -go2w.CALF]
    _collider(calf, type=_CYLINDER, size=[0.05, 0.025, 0.0], pos=axle, quat=_ALONG_Y)
    _collider(calf, type=_CAPSULE, size=[0.013, 0.0, 0.0], fromto=[0, 0, -0.02, 0, 0, -0.18])
    _visual(calf, _DARK, type=_CAPSULE, size=[0.016, 0.0, 0.0], fromto=[0.004, 0, -0.01, 0.002, 0, -0.19])
    _visual(calf, _DARK, type=_CYLINDER, size=[0.049, 0.025, 0.0], pos=axle, quat=_ALONG_Y)
    _visual(
        calf,
        _STEEL,
        type=_CYLINDER,
        size=[0.038, 0.003, 0.0],
        pos=[0, -0.017 * sy, -go2w.CALF],
        quat=_ALONG_Y,
    )

    wheel = calf.add_body(name=f"{name}_wheel", pos=[0.0, 0.0, -go2w.CALF])
    _hinge(wheel, f"{name}_wheel", [0.0, 1.0, 0.0])
    _set_inertia(wheel, go2w.WHEEL, 1.0, sy)
    tread = [0.0, go2w.TREAD_Y * sy, 0.0]
    wheel.add_geom(
        name=f"{name}_wheel",
        type=_CYLINDER,
        size=[go2w.WHEEL_RADIUS, go2w.TREAD_WIDTH / 2, 0.0],
        pos=tread,
        quat=_ALONG_Y,
        contype=1,
        conaffinity=2,
        condim=6,
        priority=1,
        friction=[friction, 0.02, 0.01],
        rgba=_TYRE,
        group=1,
    )
    face = go2w.TREAD_Y + go2w.TREAD_WIDTH / 2
    _visual(
        wheel,
        _STEEL,
        type=_CYLINDER,
        size=[0.056, 0.002, 0.0],
        pos=[0, (face + 0.001) * sy, 0],
        quat=_ALONG_Y,
    )
    _visual(
        wheel, _DARK, type=_CYLINDER, size=[0.020, 0.003, 0.0], pos=[0, (face + 0.002) * sy, 0], quat=_ALONG_Y
    )
    for k in range(5):
        angle = 2.0 * pi * k / 5
        spoke = [0.036 * np.cos(angle), (face + 0.002) * sy, 0.036 * np.sin(angle)]
        _visual(wheel, _DARK, type=_CYLINDER, size=[0.010, 0.002, 0.0], pos=spoke, quat=_ALONG_Y)
