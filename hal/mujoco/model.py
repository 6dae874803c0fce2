"""A robot and its ground as a MuJoCo model. The robot itself comes from its own folder (`hal.mujoco.robot.Simulated`).

Contact follows the vendor's MJCF of the Go2-W (unitreerobotics/unitree_mujoco): elliptic cones, impratio 100, wheels
of priority 1 with friction mu and .02 m against spinning on the spot. Unlike there, wheels have no rolling friction:
that shares the friction cone with sliding, so a wheel that rolls has no grip left until it slips, and covers 0.90 to
1.01 of its circumference, by speed, direction and time step. Without it, it covers 0.998 to 1.000. Geoms of group 3
collide and are not drawn; group 2 is drawn and does not collide; group 1 does both. The robot does not collide with
itself."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from hal.camera import MountedCamera
from hal.mujoco.looks import dress_world
from hal.mujoco.robot import BODY_FRICTION, BOX, Simulated
from hal.types import Array

BASE_THICKNESS = 0.5
"""Ground below the lowest point of the terrain [m]."""
HIDDEN_PLACE = (0.0, 0.0, -100.0)
"""Where obstacles wait [m]."""


def build(
    height: NDArray[np.float32],
    resolution: float,
    origin: tuple[float, float],
    robot: Simulated,
    *,
    friction: float = 0.8,
    timestep: float = 0.005,
    payload: float = 0.0,
    boxes: Sequence[tuple[float, float, float]] = (),
    housings: bool = True,
    looks: bool = True,
    camera: MountedCamera | None = None,
) -> mujoco.MjModel:
    """`robot` on terrain.

    `height`: (rows, cols) [m], cell [0, 0] centred on `origin` (x, y [m]); `friction`: sliding friction of the
    wheels;
    `payload`: mass [kg] fixed on top of the trunk; `boxes`: full lengths [m] of mocap boxes (`box0`...) kept out of
    sight below the ground until they are placed; `housings`: the wheel-motor housings collide. False is the collider
    set of the vendor's MJCF.
    `looks`: with the parts that are only drawn; `camera`: one on the trunk to look through.

    Each joint that the robot has, of `hal.limbs.MOTORS`, is driven by the actuator of its name with force = ctrl +
    biasprm[1] q + biasprm[2] dq, clipped by the motor's torque limit; the simulation writes the gains of the current
    command into `actuator_biasprm`."""
    spec = mujoco.MjSpec()
    spec.modelname = "robot"
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
    base = robot.add(spec, friction=friction, payload=payload, housings=housings, looks=looks)
    spec.add_sensor(
        name="accelerometer",
        type=mujoco.mjtSensor.mjSENS_ACCELEROMETER,
        objtype=mujoco.mjtObj.mjOBJ_SITE,
        objname="imu",
    )
    if camera is not None:
        quat = np.empty(4)
        mujoco.mju_mat2Quat(
            quat, (camera.rotation * (1.0, -1.0, -1.0)).ravel()
        )  # MuJoCo looks along -z, y up
        base.add_camera(
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
    size, place, share = _hfield(height, resolution, origin)
    spec.add_hfield(name="terrain", nrow=rows, ncol=cols, size=size, userdata=share)
    spec.worldbody.add_geom(
        name="terrain",
        type=mujoco.mjtGeom.mjGEOM_HFIELD,
        hfieldname="terrain",
        pos=place,
        **({"material": "ground"} if looks else {}),
        contype=2,
        conaffinity=1,
        friction=[BODY_FRICTION, 0.005, 0.0001],
        group=0,
    )


def _hfield(
    height: NDArray[np.floating[Any]], resolution: float, origin: tuple[float, float]
) -> tuple[Array, Array, NDArray[np.float32]]:
    """Size (4,) and place (3,) [m] of a height field, and its samples (rows * cols,) [0..1]."""
    rows, cols = height.shape
    low = float(height.min())
    span = max(float(height.max()) - low, 1e-3)
    # MuJoCo spreads n samples over 2 * size: only (n - 1) * resolution / 2 keeps the map unscaled.
    x, y = 0.5 * resolution * (cols - 1), 0.5 * resolution * (rows - 1)
    place = np.array([origin[0] + x, origin[1] + y, low])
    return np.array([x, y, span, BASE_THICKNESS]), place, ((height - low) / span).astype(np.float32).ravel()


def lay_ground(
    model: mujoco.MjModel, height: NDArray[np.float32], resolution: float, origin: tuple[float, float]
) -> None:
    """Another ground with as many cells: `height` (rows, cols) [m]."""
    model.hfield_size[0], model.geom("terrain").pos[:], model.hfield_data[:] = _hfield(
        height.astype(np.float64), resolution, origin
    )


def _obstacle(spec: mujoco.MjSpec, index: int, size: tuple[float, float, float]) -> None:
    body = spec.worldbody.add_body(name=f"box{index}", mocap=True, pos=HIDDEN_PLACE)
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
