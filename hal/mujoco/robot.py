"""What a robot's folder must bring for MuJoCo, and the shapes that its builder uses."""

from __future__ import annotations

from math import pi
from pathlib import Path
from typing import Protocol

import mujoco
import numpy as np

from hal.lidar.caster import OrientedBox
from hal.limbs import Limbs
from hal.lowlevel import Locomotion
from hal.postures.legs import Legs
from hal.types import Array

BODY_FRICTION = 0.4
"""Sliding friction of everything but the wheels."""
SPIN_FRICTION = 0.02
"""Of a wheel that turns about the contact's normal [m]."""

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


class Simulated(Protocol):
    """A robot for MuJoCo. One object serves every simulation; it keeps nothing of any."""

    @property
    def limbs(self) -> Limbs:
        """Lengths [m]."""

    @property
    def torque_limit(self) -> Array:
        """(16,) [Nm], by `hal.limbs.MOTORS`."""

    @property
    def speed_limit(self) -> Array:
        """(16,) [rad/s]."""

    @property
    def stand(self) -> Array:
        """(16,) [rad] as it stands."""

    @property
    def legs(self) -> Legs | None:
        """None: its wheels sit on its body."""

    @property
    def blocks(self) -> tuple[OrientedBox, ...]:
        """What stops the rays of its own LiDARs, in base_link as it stands."""

    def add(
        self, spec: mujoco.MjSpec, *, friction: float, payload: float, housings: bool, looks: bool
    ) -> mujoco.MjsBody:
        """Add the robot, standing over the origin, and return its trunk, body `base_link` with a free joint and site
        `imu`. Its joints and actuators have the names of `hal.limbs.MOTORS`, its treads or feet are geoms
        `FR_wheel`... with sliding `friction`. `payload`: [kg] on top; `housings`: colliders around the wheels' motors,
        where it has some; `looks`: with the parts that are only drawn."""

    def controller(self, name: str, policy: str | Path, period: float) -> Locomotion:
        """A controller of `robot.yaml`, its kernels compiled. `policy`: of one that learnt; `period` [s]: of one that
        brings none of its own. Raises an OperatorError."""


def visual(body: mujoco.MjsBody, rgba: tuple[float, float, float, float], **shape: object) -> None:
    """A shape to look at."""
    body.add_geom(contype=0, conaffinity=0, group=2, rgba=rgba, **shape)


def collider(body: mujoco.MjsBody, **shape: object) -> None:
    """A shape that touches the ground and is not drawn."""
    body.add_geom(
        contype=1,
        conaffinity=2,
        condim=3,
        friction=[BODY_FRICTION, 0.005, 0.0001],
        group=3,
        rgba=[0.8, 0.3, 0.3, 0.4],
        **shape,
    )


def on_ground(body: mujoco.MjsBody, name: str, friction: float, **shape: object) -> None:
    """The geom by which a wheel or a foot touches the ground, called `name`; sliding `friction`."""
    body.add_geom(
        name=name,
        contype=1,
        conaffinity=2,
        condim=4,
        priority=1,
        friction=[friction, SPIN_FRICTION, 0.0],
        rgba=TYRE,
        group=1,
        **shape,
    )


def tread(wheel: mujoco.MjsBody, name: str, limbs: Limbs, y: float, friction: float) -> None:
    """The geom of a wheel that rolls on the ground, its middle `y` [m] beside the joint; sliding `friction`."""
    size = [limbs.radius, limbs.tread_width / 2, 0.0]
    on_ground(wheel, name, friction, type=CYLINDER, size=size, pos=[0.0, y, 0.0], quat=ALONG_Y)


def sun(base: mujoco.MjsBody) -> None:
    """The light goes with the robot, so that its shadow map does."""
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


def motor(spec: mujoco.MjSpec, name: str, torque: float) -> None:
    """The actuator of a joint: force = ctrl + biasprm[1] q + biasprm[2] dq, at most `torque` [Nm]. The simulation
    writes the gains of the current command into `actuator_biasprm`."""
    spec.add_actuator(
        name=name,
        target=name,
        trntype=mujoco.mjtTrn.mjTRN_JOINT,
        gaintype=mujoco.mjtGain.mjGAIN_FIXED,
        biastype=mujoco.mjtBias.mjBIAS_AFFINE,
        gainprm=[1.0] + [0.0] * 9,
        forcelimited=True,
        forcerange=[-torque, torque],
    )


def load(base: mujoco.MjsBody, mass: float, pos: list[float]) -> None:
    """A box of batteries of so many kg, high up, where it hurts balance most."""
    if mass <= 0.0:
        return
    visual(base, STEEL, type=BOX, size=[0.10, 0.08, 0.05], pos=pos)
    box = base.add_body(name="payload", pos=pos)
    box.explicitinertial = True
    box.mass = mass
    box.inertia = mass / 12.0 * np.array([0.16**2 + 0.1**2, 0.2**2 + 0.1**2, 0.2**2 + 0.16**2])
