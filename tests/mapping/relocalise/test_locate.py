"""A robot looks for itself in rooms."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mapping.grid import ElevationGrid
from mapping.relocalise import Place, PriorMap, Submap, locate
from mapping.relocalise.verify import Ground, bare_ground, pierced
from mapping.thin_cloud import ThinCloud
from tests.mapping.relocalise.rooms import (
    corner_room,
    floor,
    ground_of,
    look,
    prior_of,
    room,
    seen_from,
    walls,
)


def submap_of(cloud: np.ndarray, *places: tuple[float, float, float]) -> Submap:
    """What the robot saw from these places; `odom` begins at the first one."""
    submap = Submap()
    x0, y0, yaw0 = places[0]
    c, s = math.cos(yaw0), math.sin(yaw0)
    for x, y, yaw in places:
        dx, dy = x - x0, y - y0
        look(submap, seen_from(cloud, x, y, yaw), (c * dx + s * dy, c * dy - s * dx, yaw - yaw0))
    return submap


@pytest.mark.parametrize("place", [(1.3, -0.7, 2.2), (-2.0, 1.1, -0.4), (0.5, 0.5, 3.1)])
def test_it_is_found_in_a_room_that_looks_like_no_other(place: tuple[float, float, float]) -> None:
    verdict = locate(prior_of(corner_room()), submap_of(corner_room(), place))
    found = verdict.candidates[0].place
    assert verdict.answer == "located"
    assert (found.x, found.y, found.z) == pytest.approx((*place[:2], 0.0), abs=0.03)
    assert math.remainder(found.yaw - place[2], 2 * math.pi) == pytest.approx(0.0, abs=0.01)
    assert verdict.candidates[0].certainty > 0.8


def test_boxes_that_came_and_went_leave_it_found() -> None:
    box = walls((-1.0, -1.5, -0.5, -1.5), (-0.5, -1.5, -0.5, -1.0))
    other = walls((0.5, 2.0, 1.0, 2.0), (0.5, 2.0, 0.5, 1.5))
    before = np.concatenate([corner_room(), box])
    after = np.concatenate([corner_room(), other])
    verdict = locate(prior_of(before), submap_of(after, (0.0, 0.2, 0.3)))
    assert verdict.answer == "located"
    assert (verdict.candidates[0].place.x, verdict.candidates[0].place.y) == pytest.approx(
        (0.0, 0.2), abs=0.05
    )


def test_a_room_that_looks_the_same_from_two_sides_is_ambiguous_and_a_hint_decides() -> None:
    prior, submap = prior_of(room(4.0, 3.0)), submap_of(room(4.0, 3.0), (1.0, -0.5, 0.5))
    verdict = locate(prior, submap)
    assert verdict.answer == "ambiguous"
    places = sorted((round(c.place.x, 1), round(c.place.y, 1)) for c in verdict.candidates)
    assert places == [(-1.0, 0.5), (1.0, -0.5)]
    for sign, yaw in ((1.0, 0.5), (-1.0, 0.5 - math.pi)):
        said = locate(prior, submap, (sign * 1.3, sign * -0.2, yaw + 0.2))
        assert (said.answer, said.hinted) == ("located", True)
        assert (said.candidates[0].place.x, said.candidates[0].place.y) == pytest.approx(
            (sign, -0.5 * sign), abs=0.03
        )
    # A hint that fits nothing decides nothing.
    assert locate(prior, submap, (3.0, 2.0, 0.0)).answer == "ambiguous"
    # Who is told where it stands looks nowhere else.
    told = locate(prior, submap, (-0.7, 0.7, 0.5 - math.pi), told=True)
    assert told.answer == "located"
    assert told.candidates[0].place.x == pytest.approx(-1.0, abs=0.03)


def test_a_second_look_from_elsewhere_decides() -> None:
    # Two rooms behind each other, alike but for a wall across the far end of one, which the first look does not reach.
    lines = (
        (-2, -1.5, 2, -1.5),
        (2, -1.5, 2, 0),
        (2, 0, -0.5, 1.5),
        (-0.5, 1.5, -2, 1.5),
        (-2, 1.5, -2, -1.5),
    )
    half = np.concatenate([walls(*lines), floor(2.0, 1.5)])
    across = walls((1.5, -1.5, 1.5, 0.3))
    marked = np.concatenate([half[half[:, 0] < 1.5], across])
    prior = prior_of(np.concatenate([half - [2.5, 0.0, 0.0], marked + np.array([2.5, 0.0, 0.0])]), 4.5, 1.5)
    submap = submap_of(half[half[:, 0] < 0.8], (-1.2, 0.4, 0.0))
    assert locate(prior, submap).answer == "ambiguous"
    look(submap, seen_from(marked, 0.0, -0.4, 0.0), (1.2, -0.8, 0.0))
    verdict = locate(prior, submap)
    assert submap.stands == 2
    assert verdict.answer == "located"
    assert (verdict.candidates[0].place.x, verdict.candidates[0].place.y) == pytest.approx(
        (2.5, -0.4), abs=0.05
    )


def test_in_the_map_of_another_place_it_is_not_found() -> None:
    verdict = locate(prior_of(room(4.0, 3.0)), submap_of(room(2.5, 1.5), (0.5, 0.2, 0.7)))
    assert verdict.answer == "not_found"


def test_open_ground_tells_nothing() -> None:
    assert (
        locate(prior_of(corner_room()), submap_of(floor(4.0, 3.0), (0.0, 0.0, 0.0))).answer == "open_ground"
    )


def test_rays_pierce_the_surfaces_that_they_cross_and_not_those_that_they_end_at_or_skim() -> None:
    wall = ThinCloud()
    wall.enter(walls((2.0, -2.0, 2.0, 2.0)).astype(np.float32))
    surfaces = wall.points.astype(float)
    normals = np.tile([1.0, 0.0, 0.0], (len(surfaces), 1))
    eyes = np.tile([0.0, 0.0, 0.5], (5, 1))
    at = surfaces[np.argmin(np.abs(surfaces - [2.0, 0.3, 0.5]).sum(axis=1))]
    through = eyes[0] + 2.0 * (at - eyes[0])
    ends = np.array([through, at, [1.9, -8.0, 0.5], [4.0, 0.0, 3.5], [0.4, 0.0, 0.5]])
    expected = np.zeros(len(surfaces), bool)
    for eye, end in zip(eyes, ends, strict=True):  # the oracle tries every pair
        way = end - eye
        length = np.linalg.norm(way)
        d = way / max(length, 1e-9)
        for m, point in enumerate(surfaces):
            if abs(d[0]) < 0.35 or length < 1.0:
                continue
            along = (point[0] - eye[0]) / d[0]
            aside = np.linalg.norm(point - eye - along * d)
            expected[m] |= 0.5 <= along <= length - 0.5 and aside < 0.075
    assert expected.sum() >= 1
    assert (pierced(eyes, ends, surfaces, normals, *wall.index, wall.voxel) == expected).all()


def test_after_one_look_a_place_that_is_nearly_as_good_is_not_ruled_out() -> None:
    # a piece of wall alone tells the two sides apart: it may have been moved
    marked = np.concatenate([room(4.0, 3.0), walls((2.0, 1.0, 2.0, 3.0))])
    prior, submap = prior_of(marked), submap_of(marked, (1.0, -0.5, 0.5))
    verdict = locate(prior, submap)
    best, other = verdict.candidates[:2]
    assert best.certainty - other.certainty > 0.12
    assert other.certainty > 0.7
    assert verdict.answer == "ambiguous"
    look(submap, seen_from(marked, 0.0, -0.5, 0.5), (-math.cos(0.5), math.sin(0.5), 0.0))
    assert locate(prior, submap).answer == "located"
    assert locate(prior, submap).candidates[0].place.x == pytest.approx(0.0, abs=0.05)


def kerb_at_one_end() -> tuple[np.ndarray, ElevationGrid]:
    """The cloud and the ground of a room that looks the same from two sides, but for a kerb of 12 cm on the left."""
    a, b = (v.ravel() for v in np.meshgrid(np.arange(-3.0, -1.0, 0.1), np.arange(-2.5, 2.5, 0.1)))
    flat = room(4.0, 3.0)
    flat = flat[(flat[:, 2] > 0.0) | (flat[:, 0] < -3.0) | (flat[:, 0] > -1.0)]
    ground = ground_of(4.0, 3.0)
    columns = -4.0 + 0.04 * np.arange(ground.height.shape[1])
    ground.height[:, (columns > -3.0) & (columns < -1.0)] = 0.12
    return np.concatenate([flat, np.column_stack([a, b, np.full_like(a, 0.12)])]), ground


@pytest.mark.parametrize("kerb_in_the_map", [True, False])
def test_ground_that_is_lower_or_higher_than_the_map_knows_speaks_against_a_place(
    kerb_in_the_map: bool,
) -> None:
    cloud, ground = kerb_at_one_end()
    level, even = room(4.0, 3.0), ground_of(4.0, 3.0)
    prior = PriorMap(
        (cloud if kerb_in_the_map else level).astype(np.float32), [ground if kerb_in_the_map else even]
    )
    place = Place(1.0, -0.5, 0.0, 0.5, 1.0)
    for seen, right in ((cloud, kerb_in_the_map), (level, not kerb_in_the_map)):
        points, eyes = submap_of(seen, (1.0, -0.5, 0.5)).cloud()
        against = prior.surfaces.evidence(points, eyes, bare_ground(points), place)[1]
        assert against < 0.01 if right else against > 0.2


def test_bare_ground_is_what_nothing_stands_on_or_beside() -> None:
    points = np.concatenate([floor(2.0, 2.0) + np.array([0.05, 0.05, 0.0]), walls((1.0, -1.0, 1.0, 1.0))])
    bare = bare_ground(points)
    on_floor = points[:, 2] == 0.0
    beside = np.abs(points[:, 0] - 1.0) < 0.25
    assert bare[on_floor & ~beside].all()
    assert not bare[~on_floor].any()
    assert not bare[on_floor & (np.abs(points[:, 0] - 1.0) < 0.1) & (np.abs(points[:, 1]) < 0.9)].any()


def test_the_known_ground_is_a_plane_a_square_and_holds_the_faces_in_between() -> None:
    # a ramp up to x = 1, then a wall of 0.5 m, unknown ground behind it, in two blocks
    x, y = np.meshgrid(np.arange(-50, 50) * 0.04, np.arange(-30, 30) * 0.04)
    height = np.where(x < 1.02, 0.27 * x, 0.5).astype(np.float32)
    trusted = x < 1.1
    blocks = [
        ElevationGrid(height[:, :48], trusted[:, :48], (x[0, 0], y[0, 0]), 0.04),
        ElevationGrid(height[:, 48:], trusted[:, 48:], (x[0, 48], y[0, 0]), 0.04),
    ]
    ground = Ground(blocks)
    at = np.random.default_rng(0).uniform((-1.8, -1.0, 0.0), (0.8, 1.0, 0.0), (200, 3))
    known = ground.below(at)
    assert np.isfinite(known).mean() > 0.9
    assert np.nanmax(np.abs(known - 0.27 * at[:, 0])) < 0.01
    assert np.isnan(ground.below(np.array([[1.0, 0.0, 0.0], [1.5, 0.0, 0.0]]))).all()
    met = ground.met(
        np.array([[1.0, 0.1, 0.4], [1.0, 0.1, 0.8], [0.0, 0.1, 0.02], [0.0, 0.1, 0.2], [1.5, 0.0, 0.5]])
    )
    assert met.tolist() == [True, False, True, False, False]
