"""What drops away unseen is never trusted ground: pits, stairs down and platform edges under both LiDARs of the
robot."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from hal.lidar import LIDARS, LidarSimulator
from hal.lidar.caster import NumbaCaster, Surface
from hal.rotation import rotation_rpy
from hal.types import MountedLidar
from mapping.elevation.map import ElevationMap
from mapping.elevation.sensor import Sensor
from mapping.elevation.tiles import ASSUMED

HEIGHT, EDGE = 0.40, 2.0
RES, ORIGIN = 0.02, (-3.0, -2.0)
LEVEL = np.array([0.0, 0.0, 0.0, 1.0])
WHEELS = np.array([[a, b, -HEIGHT] for a in (0.2, -0.2) for b in (0.2, -0.2)])


def terrain(kind: str) -> np.ndarray:
    """9 x 4 m of level ground inside walls; at x = 2 it drops."""
    height = np.zeros((201, 451), np.float32)
    x = ORIGIN[0] + RES * np.arange(height.shape[1])
    beyond = {"stairs": -0.17 * np.floor((x - EDGE) / 0.29 + 1.0), "edge": np.full(x.shape, -0.6)}
    wide = {"slot": 0.3, "pit": 0.6}.get(kind, 9.0)
    drops = (x >= EDGE - 1e-6) & (x < EDGE + wide - 1e-6)
    height[:, drops] = np.maximum(beyond.get(kind, np.full(x.shape, -0.5))[drops], -0.8)
    height[:3] = height[-3:] = height[:, :3] = 1.2
    return height


def approach(height: np.ndarray) -> Iterator[ElevationMap]:
    """The map after every scan of XT16 and L1 from 3 m to 0.6 m before the edge, wheels first."""
    caster = NumbaCaster(Surface(height, RES, ORIGIN))
    lidars = [
        (LidarSimulator(LIDARS[n], LIDARS[n].mount, caster, seed=1, name=name),
        Sensor.of(MountedLidar(name, n, LIDARS[n].mount)))
        for name, n in (("main", "xt16"), ("head", "l1"))
    ]  # fmt: skip
    elevation, period = ElevationMap(), LIDARS["xt16"].period
    stamp = period
    for k in range(28):
        place = np.array([min(-1.0 + 0.1 * k, 1.4), 0.0, HEIGHT])
        for lidar, sensor in lidars:
            scan = None
            for part in (0, period - 1, period):  # taken from where the robot is, no distortion to take out
                scan = lidar.advance(stamp + part, place, LEVEL[[3, 0, 1, 2]]) or scan
            assert scan is not None
            p, mount = scan.points, lidar.mount
            xyz = np.stack([p["x"], p["y"], p["z"]], axis=1) @ rotation_rpy(*mount.rpy).T + mount.translation
            elevation.fuse(xyz.astype(np.float32), place, LEVEL, stamp + period, sensor)
            if k % 3 == 2:
                elevation.clean()
        elevation.fuse_ground(WHEELS, place, LEVEL, stamp + period)
        stamp += period + 1
        yield elevation


@pytest.mark.parametrize("kind", ["slot", "pit", "stairs", "edge"])
def test_nothing_that_drops_away_becomes_trusted_ground(kind: str) -> None:
    height = terrain(kind)
    worst = assumed = 0
    for elevation in approach(height):
        patch = elevation.window(EDGE, 0.0, 1.0)
        r, c = np.nonzero(patch.layers["trusted"] > 0)
        x, y = patch.origin[0] + c * patch.resolution, patch.origin[1] + r * patch.resolution
        i, j = (np.rint((v - o) / RES).astype(int) for v, o in ((y, ORIGIN[1]), (x, ORIGIN[0])))
        # the highest true ground within 6 cm: the rim itself counts as ground
        reach = range(-3, 4)
        true = np.max([height[i + a, j + b] for a in reach for b in reach], axis=0)
        over = patch.layers["elevation"][r, c] > true + 0.08
        worst = max(worst, int(over.sum()))
        assumed = max(assumed, int((patch.layers["source"] == ASSUMED).sum()))
        assert not patch.layers["trusted"][patch.layers["source"] == ASSUMED].any()
    assert worst <= 2  # a mixed pixel
    if kind in ("slot", "pit"):  # seen from afar both look like ground between two rings
        assert assumed > 50
