"""Looks of the ground: sky, light and picture quality."""

from __future__ import annotations

import mujoco


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
