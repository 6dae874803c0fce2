"""Watches clock and mount of every LiDAR while the robot drives, corrects the clock, and says what the operator must mend."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hal.types import NS, Array, LidarName
from mapping.odometry.alignment import GATE, SCALE, GyroFit, MapFit
from mapping.odometry.registration.engines import Engine

CERTAIN = 5.0
"""Standard deviations beyond which a difference is believed: it is looked at after every scan."""
WORTH, SMALL = 0.003, 0.001
"""Offset [s] from which a clock is corrected, and what a correction may leave. Simulated physics has 2 to 2.5 ms, half of its
time step: its poses move by the rate at the end of a step, and the gyro's samples are joined by straight lines."""
KNOWN = 0.002
"""Standard deviation [s] of the main LiDAR's offset up to which the others are compared with its map: until then it is bent."""
TURNING = 0.1
"""Turn rate [rad/s] at which a wrong offset bends it."""


@dataclass(frozen=True, slots=True, eq=False)
class LidarFit:
    """What is known of one LiDAR."""

    name: LidarName
    offset: float
    """To be added to its stamps [s], as found,"""
    offset_sigma: float
    """its standard deviation,"""
    applied: float
    """and as applied [s]."""


class Calibration:
    """Of all LiDARs of a robot. A function of the scans alone: a re-run finds and applies the same."""

    def __init__(self, names: Iterable[LidarName], max_offset: float) -> None:
        """`max_offset` [s]: the largest that is corrected."""
        self._max = max_offset
        self._gyro = GyroFit()
        self._beside: dict[LidarName, MapFit] = {name: MapFit() for name in names if name != "main"}
        self._known: dict[LidarName, tuple[Array, Array]] = {"main": self._gyro.solve()}
        self._known |= {name: fit.solve() for name, fit in self._beside.items()}
        self.shift: dict[LidarName, int] = dict.fromkeys(["main", *self._beside], 0)
        """Added to the stamps of each LiDAR [ns]."""

    def registered(
        self, stamp: int, before: Array, predicted: Array, since: int, pose: Array, covariance: Array
    ) -> None:
        """A scan of the main LiDAR was registered.

        It ended at `stamp` [ns]; the gyro went from `before` (4, 4), at the stamp `since`, to `predicted`; registration says `pose`, `covariance`
        (6, 6) with the rotation in `odom` axes.
        """
        turned = before[:3, :3].T @ predicted[:3, :3]
        rot = pose[:3, :3]
        seconds = (stamp - since) / NS
        self._gyro.add(stamp, turned, seconds, rot, rot.T @ covariance[3:, 3:] @ rot, self.shift["main"] / NS)
        if self._settle("main", self._gyro):
            for fit in self._beside.values():
                fit.shifted()

    def beside(
        self, name: LidarName, cloud: NDArray[np.float32], engine: Engine, pose: Array, linear: Array, angular: Array
    ) -> None:  # fmt: skip
        """The `cloud` (n, 3) of another LiDAR, base_link, beside the local map of `engine`.

        `pose` (4, 4) `odom` <- base_link; `linear`, `angular` (3,): velocity during its sweep, base_link [m/s, rad/s].
        """
        fit, shift = self._beside[name], self.shift[name] / NS
        there, off = fit.pose(pose, linear, angular, shift)
        found = engine.planes.fit(np.ascontiguousarray(cloud, np.float64), there, GATE, SCALE)
        fit.add(found, there, off, linear, angular, engine.sigma, shift)
        self._settle(name, fit, self._known["main"][1][0] < KNOWN)

    def _settle(self, name: LidarName, fit: GyroFit | MapFit, sure: bool = True) -> bool:
        """Shift the stamps from now on if the offset is known to differ from what is applied."""
        x, sigma = self._known[name] = fit.solve()
        wanted = round(min(max(float(x[0]), -self._max), self._max) * NS)
        off = abs(wanted - self.shift[name]) / NS
        if not sure or off <= max(CERTAIN * float(sigma[0]), SMALL if self.shift[name] else WORTH):
            return False
        self.shift[name] = wanted
        fit.shifted()
        return True

    def fits(self) -> tuple[LidarFit, ...]:
        """What is known, the main LiDAR first."""
        return tuple(
            LidarFit(name, float(x[0]), float(sigma[0]), self.shift[name] / NS)
            for name, (x, sigma) in self._known.items()
        )

    def fault(self) -> str:
        """What the operator must mend, in plain words; empty when all is well."""
        words = []
        for fit in self.fits():
            beyond = abs(fit.offset) - max(CERTAIN * fit.offset_sigma, WORTH)
            if beyond > self._max:
                words.append(
                    f"the stamps of the {fit.name} LiDAR are {-1e3 * fit.offset:+.0f} ms off the IMU, beyond the"
                    f" {1e3 * self._max:.0f} ms that are corrected: set its time_offset"
                )
        return "; ".join(words)
