"""Watches clock and mount of every LiDAR while the robot drives, corrects the clock, and tells the operator what to
mend."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hal.rotation import cross
from hal.types import NS, Array, Extrinsics, LidarName
from mapping.odometry.alignment import KEPT_WEIGHT, PLANE_GATE, PLANE_SCALE, GyroFit, MapFit
from mapping.odometry.ground_fit import GroundFit
from mapping.odometry.registration.engines import Engine

CERTAIN_SIGMAS, REFINED_SIGMAS = 5.0, 3.0
"""Standard deviations beyond which a difference is believed; it is checked after every scan. Fewer if a clock is
already corrected."""
CORRECTED_OFFSET, SMALL_OFFSET = 0.005, 0.001
"""Offset [s] from which a clock is corrected, `CERTAIN_SIGMAS` times `CLOCK_SIGMA`, and what a correction may leave."""
DOUBTFUL_SIGMAS = 2.0
"""Standard deviations beyond which a clock seems wrong: it is not corrected yet."""
YOUNG_MAP = 5
"""Scans in the local map below which nothing is compared with it."""
KNOWN_SIGMA = 0.001
"""Standard deviation [s] of the main LiDAR's offset from which on the others are compared with its map: until then
the map is bent."""
MOUNT_ERROR = math.radians(1.2), 0.010
"""Error of a mount that is told [rad], [m]."""
MOUNT_SIGMA, CLOCK_SIGMA = (math.radians(0.15), 0.003), 0.001
"""Systematic error beside the noise, one standard deviation: of mounts [rad], [m], of a clock [s]. Correct clocks in
simulated physics were found 1.8 to 2.7 ms off at the end of a drive, and at most 4.5 ms on the way. The simulator's
poses move by the rate at the end of a step of 5 ms, and gyro samples are joined by straight lines."""
AXES = ("roll", "pitch", "yaw", "x", "y", "z")
TURNING_RATE = 0.1
"""Turn rate [rad/s] at which a wrong offset bends it."""


@dataclass(frozen=True, slots=True, eq=False)
class LidarFit:
    """What is known of one LiDAR."""

    name: LidarName
    offset: float
    """To be added to its stamps [s], as found,"""
    offset_sigma: float
    """its standard deviation, with what noise does not explain,"""
    applied: float
    """and as applied [s]."""


@dataclass(frozen=True, slots=True, eq=False)
class MountFit:
    """By how much the configured mount of a LiDAR is off, axes of base_link."""

    turn: Array
    """(3,) [rad]"""
    turn_sigma: Array
    place: Array
    """(3,) of the LiDAR itself [m]"""
    place_sigma: Array
    """Standard deviations, that of what cannot be seen is infinite."""


class Calibration:
    """Of all LiDARs of a robot. A function of the scans alone: a re-run finds and applies the same."""

    def __init__(self, mounts: Mapping[LidarName, Extrinsics], max_offset: float) -> None:
        """`mounts`: each LiDAR in base_link; `max_offset` [s]: the largest that is corrected."""
        self._max = max_offset
        self._places = {name: np.array(mount.translation) for name, mount in mounts.items()}
        self._ground = {name: GroundFit() for name in mounts}
        self._gyro = GyroFit()
        self._beside: dict[LidarName, MapFit] = {name: MapFit() for name in mounts if name != "main"}
        self._known: dict[LidarName, tuple[Array, Array]] = {"main": self._gyro.solve()}
        self._known |= {name: fit.solve() for name, fit in self._beside.items()}
        self.shift: dict[LidarName, int] = dict.fromkeys(["main", *self._beside], 0)
        """Added to the stamps of each LiDAR [ns]."""

    def registered(
        self, stamp: int, before: Array, predicted: Array, since: int, pose: Array, covariance: Array, engine: Engine
    ) -> None:  # fmt: skip
        """A scan of the main LiDAR was registered to the local map of `engine`.

        It ended at `stamp` [ns]. The gyro led from `before` (4, 4), at the stamp `since`, to `predicted`.
        Registration says `pose` with `covariance` (6, 6), rotation in `odom` axes."""
        if engine.scans < YOUNG_MAP:
            return
        turned = before[:3, :3].T @ predicted[:3, :3]
        noise = pose[:3, :3].T @ covariance[3:, 3:] @ pose[:3, :3]
        self._gyro.add(stamp, turned, (stamp - since) / NS, pose, noise, self.shift["main"] / NS)
        if self._settle("main", self._gyro):
            # The sweeps in the map were bent by the wrong time. Settled surfaces take no more points, so they would
            # stay bent.
            if self._corrects("main"):
                engine.planes.fade(KEPT_WEIGHT)
            for fit in self._beside.values():
                fit.shifted()

    def clouds(
        self,
        clouds: Mapping[LidarName, NDArray[np.float32]],
        engine: Engine,
        pose: Array,
        linear: Array,
        angular: Array,
        contacts: Array,
    ) -> None:
        """Compare what every LiDAR saw during that scan, (n, 3) base_link, with the local map of `engine` and the
        ground under the wheels.

        `pose` (4, 4) `odom` <- base_link; `linear`, `angular` (3,): velocity during the sweep [m/s, rad/s];
        `contacts` (k, 3): wheel contacts [m], base_link."""
        for name, cloud in clouds.items():
            self._ground[name].add(cloud, contacts, pose[2, :3])
            # on slopes a map that is off in height is off ahead
            if name == "main" or engine.scans < YOUNG_MAP or not self._ground[name].even:
                continue
            fit, shift = self._beside[name], self.shift[name] / NS
            there, off = fit.pose(pose, linear, angular, shift)
            found = engine.planes.fit(np.ascontiguousarray(cloud, np.float64), there, PLANE_GATE, PLANE_SCALE)
            fit.add(found, there, off, linear, angular, engine.sigma, shift)
            self._settle(name, fit, self._known["main"][1][0] < KNOWN_SIGMA)

    def _settle(self, name: LidarName, fit: GyroFit | MapFit, sure: bool = True) -> bool:
        """Shift the stamps from now on if the offset is known to differ from what is applied."""
        x, sigma = self._known[name] = fit.solve()
        wanted = round(min(max(float(x[0]), -self._max), self._max) * NS)
        off = abs(wanted - self.shift[name]) / NS
        beyond, least = (
            (REFINED_SIGMAS, SMALL_OFFSET) if self.shift[name] else (CERTAIN_SIGMAS, CORRECTED_OFFSET)
        )
        if not sure or off <= max(beyond * float(sigma[0]), least):
            return False
        self.shift[name] = wanted
        fit.shifted(wholly=self._corrects(name))
        return True

    def _corrects(self, name: LidarName) -> bool:
        """Whether the shift is all that the stamps are off: with the largest one the sweeps stay bent."""
        return abs(self.shift[name]) < round(self._max * NS)

    def joins(self, name: LidarName) -> bool:
        """Whether this LiDAR is registered together with the main one: clocks and mounts must look right. A LiDAR
        whose clock was corrected is compared with the main one's map, so it must not influence that map."""
        return (
            self.shift[name] == 0 and not self._mount_faults() and all(map(self._seems_right, ("main", name)))
        )

    def _seems_right(self, name: LidarName) -> bool:
        x, sigma = self._known[name]
        return abs(float(x[0]) - self.shift[name] / NS) < max(
            CORRECTED_OFFSET, DOUBTFUL_SIGMAS * float(sigma[0])
        )

    def fits(self) -> tuple[LidarFit, ...]:
        """What is known, the main LiDAR first."""
        return tuple(
            LidarFit(name, float(x[0]), math.hypot(float(sigma[0]), CLOCK_SIGMA), self.shift[name] / NS)
            for name, (x, sigma) in self._known.items()
        )

    def mounts(self) -> dict[LidarName, MountFit]:
        """What is known of the mounts. Position x and y of the main LiDAR is taken for right; the others are placed
        relative to it."""
        out: dict[LidarName, MountFit] = {}
        for name, (x, sigma) in self._known.items():
            at = self._places[name]
            turn, turn_sigma = x[1:4].copy(), np.hypot(sigma[1:4], MOUNT_SIGMA[0])
            place, place_sigma = np.zeros(3), np.full(3, np.inf)
            if name != "main":
                main = out["main"]
                turn += main.turn
                turn_sigma = np.hypot(turn_sigma, main.turn_sigma)
                place = x[4:] + main.place - cross(main.turn, self._places["main"]) + cross(turn, at)
                place_sigma = np.hypot(sigma[4:], MOUNT_SIGMA[1])
            if self._ground[name].known:
                roll, pitch, height = self._ground[name].beside_wheels()
                ground, drive = MOUNT_SIGMA[0] ** -2, turn_sigma[:2] ** -2
                turn[:2] = (ground * np.array([roll, pitch]) + drive * turn[:2]) / (ground + drive)
                turn_sigma[:2] = 1.0 / np.sqrt(ground + drive)
                place[2] = height + roll * at[1] - pitch * at[0]
                place_sigma[2] = MOUNT_SIGMA[1]
            out[name] = MountFit(turn, turn_sigma, place, place_sigma)
        return out

    def clock_fault(self) -> str:
        """Whose clock the operator must mend, in plain words; empty when all are well."""
        words = []
        for fit in self.fits():
            sure = 0.0 if abs(fit.applied) >= self._max else CERTAIN_SIGMAS * fit.offset_sigma
            if abs(fit.offset) - max(sure, CORRECTED_OFFSET) > self._max:
                words.append(
                    f"the stamps of the {fit.name} LiDAR are {-1e3 * fit.offset:+.0f} ms off the IMU, beyond the"
                    f" {1e3 * self._max:.0f} ms that are corrected: set its time_offset"
                )
        return "; ".join(words)

    def fault(self) -> str:
        """What the operator must mend of clocks and mounts, in plain words; empty when all is well."""
        return "; ".join(filter(None, [self.clock_fault(), *self._mount_faults()]))

    def _mount_faults(self) -> list[str]:
        words = []
        for name, (x, sigma) in self._known.items():
            off = self._ground_fault(name)
            if name == "main":
                off = _turns(x, sigma, range(3)) | off
            elif apart := _turns(x, sigma, (2,)) | _places(x, sigma, self._places[name]):
                words.append(
                    f"the mounts of the main and the {name} LiDAR do not fit together: {told(apart)}"
                )
            if off:
                words.append(f"the mount of the {name} LiDAR is off: {told(off)}")
        return words

    def _ground_fault(self, name: LidarName) -> dict[str, float]:
        """Roll, pitch [rad] and height [m] of the mount by the ground. A deviation that another LiDAR sees too
        belongs to the ground."""
        ground = self._ground[name]
        if not ground.known:
            return {}
        off = ground.beside_wheels()
        tilt = ground.beside_gravity()
        apart = [off - g.beside_wheels() for other, g in self._ground.items() if other != name and g.known]
        limits = np.array([MOUNT_ERROR[0], MOUNT_ERROR[0], MOUNT_ERROR[1]])
        wrong = np.abs(off) > limits
        wrong[:2] &= np.abs(tilt) > MOUNT_ERROR[0]
        for difference in apart:
            wrong &= np.abs(difference) > limits
        # wheels that stand on something else than the ground around say nothing of the height
        wrong[2] &= bool((wrong[:2] | (np.abs(off[:2]) < limits[:2])).all())
        height = off[2] + off[0] * self._places[name][1] - off[1] * self._places[name][0]
        wrong[2] &= abs(height) > MOUNT_ERROR[1]
        values = (off[0], off[1], height)
        return {
            axis: value for axis, value, w in zip(("roll", "pitch", "z"), values, wrong, strict=True) if w
        }


def told(off: dict[str, float]) -> str:
    """Turns [rad] and distances [m] by axis, in steps of half a degree and half a centimetre, so that the text does
    not flicker."""
    return ", ".join(
        f"{axis} {0.5 * round(2.0 * math.degrees(value)):+.1f} deg"
        if axis in AXES[:3]
        else f"{axis} {0.5 * round(200.0 * value):+.1f} cm"
        for axis, value in off.items()
    )


def _turns(x: Array, sigma: Array, which: Iterable[int]) -> dict[str, float]:
    """Turns [rad] about axes of base_link that are certainly more than a mount may be off."""
    beyond = _certainly(x[1:4], sigma[1:4], MOUNT_SIGMA[0], MOUNT_ERROR[0])
    return {AXES[k]: float(x[1 + k]) for k in which if beyond[k]}


def _places(x: Array, sigma: Array, at: Array) -> dict[str, float]:
    """The same for the place [m] of a LiDAR that is mounted `at` (3,), ahead and aside; the ground tells its height."""
    place = x[4:] + cross(x[1:4], at)
    beyond = _certainly(place, sigma[4:], MOUNT_SIGMA[1], MOUNT_ERROR[1])
    return {AXES[3 + k]: float(place[k]) for k in (0, 1) if beyond[k]}


def _certainly(off: Array, sigma: Array, systematic: float, limit: float) -> NDArray[np.bool_]:
    """Whether each is certain (`CERTAIN_SIGMAS`), and beyond the limit by twice its total error. With the second test
    alone a correct mount was told for 0.3 s in the first metres of a drive, 2.5 standard deviations off."""
    size = np.abs(off)
    return (size > CERTAIN_SIGMAS * sigma) & (size - 2.0 * np.hypot(sigma, systematic) > limit)
