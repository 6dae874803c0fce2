"""Looks of the simulated robot and its ground: colours, light and shapes that do not collide (group 2)."""

from __future__ import annotations

from math import pi

import mujoco
import numpy as np

from hal import go2w

SHELL = (0.80, 0.81, 0.83, 1.0)
DARK = (0.13, 0.14, 0.16, 1.0)
STEEL = (0.42, 0.44, 0.47, 1.0)
TYRE = (0.06, 0.06, 0.07, 1.0)
LENS = (0.02, 0.10, 0.16, 1.0)
LAMP = (0.75, 0.93, 1.0, 1.0)

BOX = mujoco.mjtGeom.mjGEOM_BOX
CYLINDER = mujoco.mjtGeom.mjGEOM_CYLINDER
CAPSULE = mujoco.mjtGeom.mjGEOM_CAPSULE
SPHERE = mujoco.mjtGeom.mjGEOM_SPHERE
ELLIPSOID = mujoco.mjtGeom.mjGEOM_ELLIPSOID
ALONG_Y = (np.cos(pi / 4), np.sin(pi / 4), 0.0, 0.0)
"""Quaternion that lays a cylinder's axis along y."""
ALONG_X = (np.cos(pi / 4), 0.0, np.sin(pi / 4), 0.0)


def dress_world(spec: mujoco.MjSpec) -> None:
    """Sky, ground and picture quality."""
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


def visual(body: mujoco.MjsBody, rgba: tuple[float, float, float, float], **shape: object) -> None:
    """A shape to look at."""
    body.add_geom(contype=0, conaffinity=0, group=2, rgba=rgba, **shape)


def dress_trunk(base: mujoco.MjsBody) -> None:
    """Shell with sloped shoulders, dark belly, rails, head with lamp and the L1 below it, XT16 on a mast; the sun above."""
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
