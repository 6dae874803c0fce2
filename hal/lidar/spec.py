"""The LiDARs: scan pattern, limits and noise of each.

Directions are unit vectors in the `lidar` frame; times count from the start of a sweep. Datasheet values: Hesai
XT16 manual (2000 azimuths x 16 channels at 10 Hz), Velodyne VLP-16, Livox Mid-360 and Unitree L1 user manuals.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import pi, radians
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from hal.types import NS, Extrinsics

Kind = Literal["spinning", "rosette", "hemisphere"]


@dataclass(frozen=True, slots=True, eq=False)
class ScanPattern:
    """All rays of one sweep in firing order."""

    directions: NDArray[np.float32]
    """(n, 3) unit vectors, `lidar` frame."""
    time: NDArray[np.int64]
    """(n,) [ns] since the start of the sweep, ascending, below the period."""
    ring: NDArray[np.uint16]
    """(n,) laser channel."""


@dataclass(frozen=True, slots=True)
class LidarSpec:
    """One LiDAR model. `pattern(k)` gives the rays of its sweep number `k`."""

    name: str
    kind: Kind
    rings: int
    firings: int
    """Firings per sweep; a firing shoots every ring once."""
    elevation: tuple[float, float]
    """Lowest and highest ray [rad] in the `lidar` frame."""
    mount: Extrinsics
    """Pose in `base_link` where neither configuration nor robot says another one: on a trunk of 0.4 m."""
    min_range: float
    """[m]; nearer surfaces give no return."""
    max_range: float
    """[m] on a surface of 10 % reflectivity."""
    range_sigma: float
    """Standard deviation of the range [m]."""
    angle_sigma: float = 0.0
    """Standard deviation of the pointing error, per axis [rad]."""
    dropout: float = 0.005
    """Share of returns lost for no visible reason [0..1]."""
    grazing: float = radians(80.0)
    """Incidence [rad] beyond which returns fade; none is left at 90 deg."""
    mixed: float = 0.2
    """Share of the returns beside a depth edge that lie between foreground and background [0..1]."""
    period: int = NS // 10
    """Sweep period [ns]."""
    azimuth_step: int = 1
    """Keep every n-th firing. 2 halves the cost of the live simulation and keeps every ring."""

    def decimated(self, step: int) -> LidarSpec:
        """This LiDAR with every `step`-th firing only."""
        return replace(self, azimuth_step=step)

    @property
    def repeats(self) -> bool:
        """True when every sweep shoots the same directions."""
        return self.kind == "spinning"

    @property
    def rays(self) -> int:
        """Rays of one sweep after decimation."""
        return -(-self.firings // self.azimuth_step) * self.rings

    def pattern(self, scan: int) -> ScanPattern:
        """Rays of sweep `scan` (>= 0)."""
        firing = np.arange(0, self.firings, self.azimuth_step, dtype=np.int64)
        directions, offset = _PATTERNS[self.kind](self, scan, firing)
        time = firing[:, None] * self.period // self.firings + offset[None, :]
        ring = np.broadcast_to(np.arange(self.rings, dtype=np.uint16), time.shape)
        return ScanPattern(
            np.ascontiguousarray(directions.reshape(-1, 3), dtype=np.float32),
            np.ascontiguousarray(time.reshape(-1)),
            np.ascontiguousarray(ring.reshape(-1)),
        )


def _unit(azimuth: NDArray[np.float64], elevation: NDArray[np.float64]) -> NDArray[np.float64]:
    """(..., 3) unit vectors from azimuth (counter-clockwise from +x) and elevation [rad]."""
    flat = np.cos(elevation)
    return np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)], axis=-1)


def _spinning(
    spec: LidarSpec, scan: int, firing: NDArray[np.int64]
) -> tuple[NDArray[np.floating], NDArray[np.int64]]:
    """Hesai convention: azimuth 0 is +y and grows clockwise seen from above; channel 0 is the highest."""
    azimuth = 0.5 * pi - 2.0 * pi * firing / spec.firings
    elevation = np.linspace(spec.elevation[1], spec.elevation[0], spec.rings)
    # Channels fire one after the other, spread over half of a firing cycle.
    offset = np.arange(spec.rings) * (spec.period // spec.firings) // (2 * spec.rings)
    grid = np.broadcast_arrays(azimuth[:, None], elevation[None, :])
    return _unit(grid[0], grid[1]), offset.astype(np.int64)


def _rosette(
    spec: LidarSpec, scan: int, firing: NDArray[np.int64]
) -> tuple[NDArray[np.floating], NDArray[np.int64]]:
    """Non-repetitive: four lines a quarter turn apart swing between the limits while they spin; never the same twice.

    The real optics are not published. What matters for mapping is kept: uniform in elevation, all azimuths several
    times within a sweep, and frequencies without a common period, so that coverage grows with time.
    """
    spin, swing = 24.7193, 361.8034  # turns and swings per second
    seconds = (scan * spec.period + firing * (spec.period / spec.firings)) / NS
    line = np.arange(spec.rings)
    azimuth = 2.0 * pi * (spin * seconds % 1.0)
    phase = (swing * seconds[:, None] + line * 0.381966) % 1.0
    triangle = 1.0 - np.abs(2.0 * phase - 1.0)
    low, high = spec.elevation
    z = np.sin(low + (high - low) * triangle)
    flat = np.sqrt(1.0 - z * z)
    # one sine per ray and two per firing: this pattern is made anew for every sweep
    quarter = 2.0 * pi * line / spec.rings
    heading = np.exp(1j * azimuth)[:, None] * np.exp(1j * quarter) * flat
    directions = np.empty((*z.shape, 3), np.float32)
    directions[..., 0], directions[..., 1], directions[..., 2] = heading.real, heading.imag, z
    return directions, np.zeros(spec.rings, np.int64)


def _hemisphere(
    spec: LidarSpec, scan: int, firing: NDArray[np.int64]
) -> tuple[NDArray[np.floating], NDArray[np.int64]]:
    """A mirror sweeps half circles through the pole (180 Hz) while the head turns (11 Hz)."""
    turn, mirror = 11.0, 180.0
    seconds = (scan * spec.period + firing * (spec.period / spec.firings)) / NS
    azimuth = 2.0 * pi * turn * seconds
    sweep = pi * ((mirror * seconds) % 1.0)
    return _unit(azimuth, sweep)[:, None, :], np.zeros(1, np.int64)


_PATTERNS = {"spinning": _spinning, "rosette": _rosette, "hemisphere": _hemisphere}

LIDARS: dict[str, LidarSpec] = {
    "xt16": LidarSpec(
        name="xt16",
        kind="spinning",
        rings=16,
        firings=2000,
        elevation=(radians(-15.0), radians(15.0)),
        mount=Extrinsics((0.1634, 0.0, 0.116), (0.0, 0.0, pi / 2)),
        min_range=0.05,
        max_range=80.0,
        range_sigma=0.01,
        angle_sigma=radians(0.02),
        dropout=0.002,
    ),
    "vlp16": LidarSpec(
        name="vlp16",
        kind="spinning",
        rings=16,
        firings=1800,
        elevation=(radians(-15.0), radians(15.0)),
        mount=Extrinsics((0.1634, 0.0, 0.116), (0.0, 0.0, pi / 2)),
        min_range=0.5,
        max_range=50.0,
        range_sigma=0.015,  # its manual: 3 cm, which is taken for two
        angle_sigma=radians(0.02),
        dropout=0.002,
    ),
    "mid360": LidarSpec(
        name="mid360",
        kind="rosette",
        rings=4,
        firings=5000,
        elevation=(radians(-7.0), radians(52.0)),
        # No vendor figure for this body; published mounts lie at x .14-.19, z .08-.19, some pitched by 20 deg.
        mount=Extrinsics((0.16, 0.0, 0.13), (0.0, radians(20.0), 0.0)),
        min_range=0.1,
        max_range=40.0,
        range_sigma=0.02,
        angle_sigma=radians(0.15),
        dropout=0.005,
    ),
    "l1": LidarSpec(
        name="l1",
        kind="hemisphere",
        rings=1,
        firings=2160,
        elevation=(0.0, 0.5 * pi),
        # It looks forward-down, upside down.
        mount=Extrinsics((0.28945, 0.0, -0.046825), (0.0, 2.8782, 0.0)),
        min_range=0.05,
        max_range=20.0,
        range_sigma=0.02,
        angle_sigma=radians(0.1),
        dropout=0.01,
    ),
}
"""The models by name, with the full number of rays."""
