"""Returns from the robot itself are taken out, and parts that nobody told of are noticed."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
from pydantic import ValidationError

from hal.lidar.caster import NumbaCaster, OrientedBox, Surface
from hal.lidar.plants import Clump
from hal.lidar.simulator import LidarSimulator
from hal.lidar.spec import LIDARS
from hal.robots.go2w.facts import L1_MOUNT, XT16_MOUNT
from hal.rotation import quaternion, rotation_rpy
from hal.safety.monitors import OWN_PARTS, taken_out
from hal.types import NS
from mapping.odometry.own import PART_MARGIN, OwnFilter, OwnPart, OwnParts, body_boxes, outline, too_far

ANTENNA = OwnPart(low=(-0.22, 0.25, -0.1), high=(-0.19, 0.28, 0.2))
BODY = body_boxes(0.70, 0.43)
MOUNTS = {"main": XT16_MOUNT, "head": L1_MOUNT}


@pytest.mark.parametrize("name", ["main", "head"])
def test_the_filter_equals_numpy(name: str) -> None:
    rng = np.random.default_rng(3)
    points = rng.uniform(-0.8, 0.8, (4000, 3))
    turn, place = rotation_rpy(*MOUNTS[name].rpy), np.array(MOUNTS[name].translation)
    local = ((points - place) @ turn).astype(np.float32)
    inside = np.zeros(len(points), bool)
    for part in (*BODY, ANTENNA):
        inside |= ((points > part.low) & (points < part.high)).all(axis=1)
    edge = np.zeros(len(points), bool)
    for part in (*BODY, ANTENNA):
        edge |= (np.minimum(np.abs(points - part.low), np.abs(points - part.high)) < 1e-5).any(axis=1)

    others = OwnFilter([ANTENNA], MOUNTS).others(name, local)

    assert inside.any()
    assert not inside.all()
    np.testing.assert_array_equal(others[~edge], ~inside[~edge])
    np.testing.assert_allclose(OwnFilter([], MOUNTS).in_base(name, local), points, atol=1e-6)


@pytest.mark.parametrize(
    ("low", "high"),
    [((0, 0, 0), (0, 1, 1)), ((0, 0, 0), (0.1, -0.1, 0.1))],
)
def test_what_is_no_box_is_refused(low: tuple, high: tuple) -> None:
    with pytest.raises(ValidationError):
        OwnPart(low=low, high=high)


@pytest.mark.parametrize(("low", "high"), [((0, 0, 0), (0.1, 0.6, 0.1)), ((-0.9, 0, 0), (0.1, 0.1, 0.1))])
def test_a_box_that_would_blind_the_robot_is_refused(low: tuple, high: tuple) -> None:
    assert "would blind it" in too_far([ANTENNA, OwnPart(low=low, high=high)], 0.70, 0.43)
    assert not too_far([ANTENNA], 0.70, 0.43)


FLAT = np.zeros((160, 400), np.float32)
ROWS, COLS = np.meshgrid(np.arange(160) * 0.05 - 4.0, np.arange(400) * 0.05 - 5.0, indexing="ij")
"""y and x [m] of its cells."""


def walls(y: float, high: float = 1.2) -> np.ndarray:
    """A lane between walls at +-y [m]."""
    return np.where(np.abs(ROWS) > y, high, 0.0).astype(np.float32)


@dataclass
class Way:
    """Where the robot drives on what it sees, one sweep each 0.11 m or 6 deg."""

    height: np.ndarray
    parts: tuple[OwnPart, ...] = ()
    plants: tuple[Clump, ...] = ()
    boxes: Callable[[float], list[OrientedBox]] = lambda _x: []
    """What moves, by how far [m] the robot came."""
    weave: float = 0.0
    """[rad]"""
    turn: float = 0.0
    """[rad] at the end."""

    def found(self, length: float = 2.6) -> OwnParts:
        """What is noticed on `length` [m]."""
        steps = round(length / 0.11)
        way = [(0.11 * k, self.weave * math.sin(0.8 * k)) for k in range(steps)]
        turns = round(self.turn / math.radians(6.0))
        way += [(0.11 * steps, math.radians(6.0 * k)) for k in range(turns)]
        caster = NumbaCaster(Surface(self.height, 0.05, (-5.0, -4.0)))
        boxes = [
            OrientedBox(tuple(np.add(p.low, p.high) / 2), tuple(np.subtract(p.high, p.low)))
            for p in self.parts
        ]
        lidars = {
            name: LidarSimulator(
                LIDARS[model].decimated(4),
                MOUNTS[name],
                caster,
                3,
                name=name,
                plants=self.plants,
                parts=boxes,
            )
            for name, model in (("main", "xt16"), ("head", "l1"))
        }
        own, stamp = OwnFilter([], MOUNTS), 0
        out = OwnParts(own.outline)
        for x, yaw in way:
            pose = np.eye(4)
            pose[:3, :3], pose[:3, 3] = rotation_rpy(0.0, 0.0, yaw), (x, 0.0, 0.4)
            seen = []
            for name, lidar in lidars.items():
                lidar.set_boxes(self.boxes(x))
                scan, at = None, stamp + NS // 1000  # it stands there during the sweep
                while scan is None:
                    scan = lidar.advance(at, pose[:3, 3], quaternion(pose[:3, :3])[[3, 0, 1, 2]])
                    at += NS // 20
                local = np.stack([scan.points[k] for k in "xyz"], axis=1)
                local = local[own.others(name, local)]
                seen.append((own.in_base(name, local), own.in_base(name, local), own.place(name)))
            stamp = at
            if out.due(pose):
                out.look(seen, pose)
        return out


@pytest.mark.parametrize(
    "way",
    [
        Way(walls(2.0), (ANTENNA,)),
        Way(walls(0.9), (ANTENNA,), weave=0.1),
        Way(FLAT, (ANTENNA,)),
        Way(FLAT, (ANTENNA,), turn=3.0),
    ],
    ids=["lane", "narrow lane", "open ground", "open ground and a turn"],
)
def test_a_part_that_nobody_told_of_is_told_with_its_box(way: Way) -> None:
    parts = way.found()
    (found,) = parts.found
    seen = np.array(ANTENNA.high) - (0.0, 0.0, 0.05)  # what of its top the beams meet
    assert all(f <= a for f, a in zip(found.low[:2], ANTENNA.low[:2], strict=True))
    assert all(f >= a for f, a in zip(found.high, seen, strict=True))
    assert max(np.subtract(found.size, ANTENNA.size)) <= 2 * PART_MARGIN + 0.08, "noise to each side at most"
    assert OWN_PARTS.tell(parts=str(found)) == parts.words
    with taken_out(OWN_PARTS.name):
        assert parts.words == ""


def bushes() -> tuple[Clump, ...]:
    return tuple(Clump((3.0, side * 0.9, 0.4), (16.0, 1.0, 0.8), 4.0) for side in (-1.0, 1.0))


def walkers(x: float) -> list[OrientedBox]:
    """People who come towards the robot on both sides, 1.2 m apart."""
    return [
        OrientedBox((0.6 * k - x, (-1) ** k * 0.6, 0.8), (0.3, 0.4, 1.6)) for k in range(20)
        if abs(0.6 * k - x - x) > 0.3
    ]  # fmt: skip


RNG = np.random.default_rng(5)


@pytest.mark.parametrize(
    "way",
    [
        *[Way(walls(y), weave=w) for y, w in ((0.35, 0.0), (0.35, 0.1), (0.75, 0.1))],
        *[
            pytest.param(Way(walls(y), weave=w), marks=pytest.mark.campaign)
            for y, w in ((0.45, 0.0), (0.45, 0.1), (0.6, 0.0), (0.6, 0.1), (0.75, 0.0))
        ],
        Way(walls(0.4, 0.35), turn=3.0),
        Way(walls(0.4, 0.5)),
        Way((FLAT + 0.3 * (RNG.uniform(size=FLAT.shape) > 0.9)).astype(np.float32)),
        Way(FLAT, plants=bushes()),
        Way(FLAT, boxes=walkers),
        Way(FLAT, turn=3.0),
        Way(np.where((np.abs(ROWS) > 0.4) & (COLS % 0.5 < 0.1), 1.2, 0.0).astype(np.float32)),
    ],
    ids=lambda way: "",
)
def test_what_stands_beside_the_way_is_no_part(way: Way) -> None:
    assert way.found().found == ()


def test_a_robot_that_stands_tells_nothing() -> None:
    parts, pose = OwnParts(outline(0.70, 0.43)), np.eye(4)
    assert parts.due(pose)
    parts.look([], pose)
    assert not parts.due(pose)
