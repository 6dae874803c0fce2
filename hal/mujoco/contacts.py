"""What of the robot touches something, and how hard."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from hal.types import Array

PARTS = ("trunk", "leg", "housing", "wheel")
"""Trunk with head; hips, thighs and calves; wheel-motor housings; wheels."""
_KINDS = {"link": "trunk", "housing": "housing", "wheel": "wheel"}


@dataclass(frozen=True, slots=True)
class Contacts:
    """What touches the robot after the last physics step; n contacts."""

    bodies: list[str]
    """Robot body of each: `base_link`, `FL_calf`, `FL_wheel`..."""
    parts: NDArray[np.int64]
    """(n,) index in `PARTS`."""
    places: Array
    """(n, 3) [m], world."""
    normals: Array
    """(n, 3) world, from what is touched to the robot."""
    forces: Array
    """(n,) along the normal [N]."""


class ContactReader:
    """Reads the contacts of the robot whose trunk is body `base`."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, base: int) -> None:
        self._model, self._data = model, data
        self._names = {b: model.body(b).name for b in range(model.nbody) if model.body_rootid[b] == base}
        self._parts = np.array([self._part(geom) for geom in range(model.ngeom)])
        self._robot = np.isin(np.arange(model.nbody), list(self._names))
        """(nbody,) whether a body is the robot's."""

    def all(self) -> Contacts:
        """Every contact."""
        contact = self._data.contact
        bodies = self._model.geom_bodyid[contact.geom]
        first = self._robot[bodies[:, 0]]
        names = [self._names[b] for b in np.where(first, bodies[:, 0], bodies[:, 1]).tolist()]
        normals = np.where(first, -1.0, 1.0)[:, None] * contact.frame[:, :3]
        parts, forces = self._parts_and_forces()
        return Contacts(names, parts, contact.pos.copy(), normals, forces)

    def only_wheels(self) -> bool:
        """Whether nothing but wheels touches."""
        return bool((self._parts_and_forces()[0] == PARTS.index("wheel")).all())

    def part_forces(self) -> Array:
        """(4,) sum of the normal forces [N] on each of `PARTS`."""
        parts, forces = self._parts_and_forces()
        return np.bincount(parts, forces, len(PARTS)).astype(np.float64)

    def _parts_and_forces(self) -> tuple[NDArray[np.int64], Array]:
        contact = self._data.contact
        row = contact.efc_address
        if len(row) == 0:
            return np.zeros(0, np.int64), np.zeros(0)
        # With elliptic cones the first row of a contact is its normal force. A contact without a row carries nothing.
        force = np.where(row >= 0, self._data.efc_force[np.maximum(row, 0)], 0.0)
        return self._parts[contact.geom].max(axis=1), force

    def _part(self, geom: int) -> int:
        """Index in `PARTS` of a geom; -1 for what is not the robot."""
        body = int(self._model.geom_bodyid[geom])
        if body not in self._names:
            return -1
        name = self._model.geom(geom).name or self._names[body]
        return PARTS.index(_KINDS.get(name.rpartition("_")[2], "leg"))
