"""A LiDAR as the elevation map sees it: where it sits, how its points scatter, which of them count."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf

from hal.lidar.spec import LIDARS
from hal.types import MountedLidar

LEAST_BEAM_SIGMA = 1e-4
"""A beam has some width, whatever a specification says [rad]."""
EVERYWHERE = (-inf, inf, -inf, inf)
GROUND_AHEAD = (0.05, 1.85, -1.2, 1.2)
"""Ground that the head LiDAR maps: up to 1.5 m before the nose. Its noise of 2 cm is too much for the rest."""


@dataclass(frozen=True, slots=True)
class Sensor:
    """One LiDAR."""

    origin: tuple[float, float, float]
    """In base_link [m]."""
    range_sigma: float
    """Standard deviation of the range of one point [m]."""
    beam_sigma: float
    """Of the direction [rad]."""
    region: tuple[float, float, float, float] = EVERYWHERE
    """x0, x1, y0, y1 in base_link [m]: points outside only tell what is empty."""
    levels: bool = True
    """Whether its heights tell the drift of the odometry."""

    @staticmethod
    def of(lidar: MountedLidar) -> Sensor:
        """With the noise of its specification."""
        spec = LIDARS[lidar.model]
        main = lidar.name == "main"
        return Sensor(
            lidar.mount.translation,
            spec.range_sigma,
            max(spec.angle_sigma, LEAST_BEAM_SIGMA),
            EVERYWHERE if main else GROUND_AHEAD,
            main,
        )


XT16 = Sensor.of(MountedLidar("main", "xt16", LIDARS["xt16"].mount))
