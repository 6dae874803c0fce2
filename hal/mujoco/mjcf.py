"""A robot of ours in somebody else's MJCF: the same limbs and controllers, other masses, shapes, friction and physics.

The file is read from where the user keeps it. Its joints are known by the names of `hal.limbs.MOTORS`, with `_joint`
behind or without. Everything is taken as it stands: inertias, colliders and their friction, joint limits, the solver's
options. Four things are not. Meshes that touch nothing are left out. Motors get the torque law of `hal.lowlevel` with
the file's limits; under the integrator of the file (Euler, if it names none) that law is explicit. Sliding friction of
the wheels is that of the trial, for every shape on the wheel's body. Their rolling friction is left out as in our model
(`hal.mujoco.model`): it takes the grip with which a wheel that rolls keeps its line."""

from __future__ import annotations

from pathlib import Path

import mujoco

from hal.errors import OperatorError
from hal.limbs import LEGS, MOTORS, Limbs
from hal.lowlevel import Locomotion
from hal.mujoco.robot import Simulated, load, motor
from hal.postures.legs import Legs
from hal.types import Array

PREFIX = "mjcf/"
"""Of the names that nobody here looks for."""
SPIN_CONDIM = 4
"""`condim` of a contact that slides and spins, and does not resist rolling."""
NO_LIMIT = 1e3
"""[Nm] of a motor that the file does not limit."""


class ModelError(OperatorError):
    """The MJCF cannot be read, or is no model of this robot."""


class Foreign:
    """`hal.mujoco.robot.Simulated`."""

    def __init__(self, place: Path, own: Simulated) -> None:
        """`place`: the MJCF, or a folder with one; `own`: the robot whose limbs and controllers it has. Raises
        ModelError."""
        file = _find(place)
        self.file, self._own = file, own
        self.name = f"{file.resolve().parent.name}/{file.stem}"
        self.limbs: Limbs = own.limbs
        self.speed_limit: Array = own.speed_limit
        self.stand: Array = own.stand
        self.legs: Legs | None = own.legs
        self.blocks = own.blocks
        self.torque_limit: Array = own.torque_limit.copy()
        model = self._read()
        self.joints = _joints(model, file)
        """Name in the file of each joint of `MOTORS`."""
        if model.site("imu") is None:
            raise ModelError(f"{file} has no site `imu` on its trunk")
        for actuator in model.actuators:
            if actuator.target in self.joints.values():
                k = MOTORS.index(next(m for m, j in self.joints.items() if j == actuator.target))
                self.torque_limit[k] = _torque(actuator)

    def _read(self) -> mujoco.MjSpec:
        try:
            return mujoco.MjSpec.from_file(str(self.file))
        except (ValueError, OSError) as error:
            raise ModelError(f"cannot read the MJCF {self.file}: {error}") from error

    def add(
        self, spec: mujoco.MjSpec, *, friction: float, payload: float, housings: bool, looks: bool
    ) -> mujoco.MjsBody:
        """The robot over the origin, and its options of physics, but for the time step."""
        model = self._read()
        for name in ("integrator", "cone", "impratio", "solver", "iterations", "tolerance"):
            setattr(spec.option, name, getattr(model.option, name))
        _strip(model, self.file)
        root = next(iter(model.worldbody.bodies))
        base = spec.worldbody.add_frame().attach_body(root, PREFIX, "")
        base.name = "base_link"
        spec.site(f"{PREFIX}imu").name = "imu"
        for name, joint in self.joints.items():
            spec.joint(f"{PREFIX}{joint}").name = name
        for leg in LEGS:
            # More than one shape of a wheel may touch: the one of the highest priority is its tread.
            wheel = spec.joint(f"{leg}_wheel").parent
            for k, tread in enumerate(sorted(wheel.geoms, key=lambda geom: -geom.priority)):
                tread.name = f"{leg}{k or ''}_wheel"
                tread.friction[0] = friction
                tread.condim = min(tread.condim, SPIN_CONDIM)
        load(base, payload, [-0.08, 0.0, 0.13])
        for name, torque in zip(MOTORS, self.torque_limit.tolist(), strict=True):
            motor(spec, name, torque)
        return base

    def controller(self, name: str, policy: str | Path, period: float) -> Locomotion:
        """Those of the robot."""
        return self._own.controller(name, policy, period)


def _find(place: Path) -> Path:
    if place.is_file():
        return place
    files = sorted(place.glob("*.xml"))
    if len(files) != 1:
        found = ", ".join(f.name for f in files) or "none"
        raise ModelError(f"{place} must be an MJCF, or a folder with one: it has {found}")
    return files[0]


def _joints(model: mujoco.MjSpec, file: Path) -> dict[str, str]:
    there = {joint.name for joint in model.joints}
    found = {name: next((j for j in (name, f"{name}_joint") if j in there), None) for name in MOTORS}
    lacks = [name for name, joint in found.items() if joint is None]
    if lacks:
        raise ModelError(f"{file} has no joint {', '.join(lacks)} (or with _joint behind)")
    return {name: joint for name, joint in found.items() if joint is not None}


def _torque(actuator: mujoco.MjsActuator) -> float:
    """Largest torque [Nm] of a motor: the file limits its control or its force."""
    limits = [float(r[1]) for r in (actuator.ctrlrange, actuator.forcerange) if r[1] > r[0]]
    return min(limits, default=NO_LIMIT)


def _strip(model: mujoco.MjSpec, file: Path) -> None:
    """Leave bodies, joints, sites and what touches something."""
    for kind in (model.sensors, model.actuators, model.keys, model.cameras, model.lights):
        for element in list(kind):
            model.delete(element)
    used = set()
    for geom in list(model.geoms):
        if geom.contype == 0 and geom.conaffinity == 0:
            model.delete(geom)
        else:
            geom.material = ""
            used.add(geom.meshname)
    for kind in (model.materials, model.textures):
        for element in list(kind):
            model.delete(element)
    for mesh in list(model.meshes):
        if mesh.name in used:
            mesh.file = str((file.parent / model.meshdir / mesh.file).resolve())
        else:
            model.delete(mesh)
