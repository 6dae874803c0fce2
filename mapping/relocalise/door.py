"""The door for place finders of others, named as `package.module:function`.

A finder is a function `(cloud, seen, hint) -> (k, 4)` that says where in a map the robot stands: x, y [m], yaw [rad]
and how certain that is [0..1], or None where it does not know. Which of the places counts is decided as for ours.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hal.errors import OperatorError
from hal.named import named
from hal.rotation import wrap
from mapping.relocalise.locate import Candidate, Verdict, decide, near
from mapping.relocalise.search import Place
from mapping.relocalise.submap import Submap

OURS = "branch_and_bound"
GROUP = "rbtrg.finders"


class FinderError(OperatorError):
    """A finder of others failed; the message tells how."""


class OwnFinder:
    """A finder of others in the place of `locate`."""

    def __init__(self, name: str) -> None:
        """Raises NamedError for a name that cannot be imported."""
        self._name = name
        self._find = named(name, "place finder", GROUP, (OURS,))

    def locate(
        self,
        cloud: NDArray[np.float32],
        submap: Submap,
        hint: tuple[float, float, float] | None = None,
        told: bool = False,
    ) -> Verdict:
        """As `mapping.relocalise.locate`; cloud (n, 3) [m] of the map. Raises FinderError."""
        seen, _ = submap.cloud()
        try:
            answer = self._find(cloud.copy(), seen, hint)
            rows = np.zeros((0, 4)) if answer is None else np.asarray(answer, np.float64).reshape(-1, 4)
            if not np.isfinite(rows).all():
                raise ValueError("a number is not finite")
        except Exception as error:
            raise FinderError(f"place finder {self._name} failed: {type(error).__name__}: {error}") from error
        found = [
            Candidate(Place(x, y, 0.0, float(wrap(yaw)), certainty), certainty, 0.0)
            for x, y, yaw, certainty in sorted(rows.tolist(), key=lambda row: -row[3])
        ]
        if told and hint is not None:
            found = [one for one in found if near(one.place, hint)]
        return decide(found, submap.stands, hint)
