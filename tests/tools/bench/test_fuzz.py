"""A small seeded slice of the fuzz campaign: what it found once stays mended."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from mapping.elevation.exchange import PATCH_LAYERS, MapError, MapPatch
from mapping.elevation.mirror import MapMirror
from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.hosts.lockstep import build_stages
from rbtrg_robot.wire.convert import LayoutError, cloud_msg, map_patch, odometry_msg, patch_msg
from rbtrg_robot.wire.messages import decode, encode
from tools.bench.fuzz.bench import fuzz, fuzz_config
from tools.bench.fuzz.mutate import Mutator
from tools.bench.fuzz.targets import TARGETS, Samples

SMALL = ("console", "navigator", "tracker", "guard", "supervisor", "log_check")
"""Targets whose messages are cheap enough for every run of the tests."""


@pytest.fixture(scope="module")
def samples() -> Samples:
    """Blank messages, and sound ones where the layout matters."""
    made = {topic: [encode(topic.kind())] for topic in t.TOPICS}
    layers = {name: np.ones((40, 40), np.float32) for name in PATCH_LAYERS}
    made[t.MAP_WINDOW] = made[t.MAP_UPDATE] = [encode(patch_msg(MapPatch((-0.8, -0.8), 0.04, 5, 0, layers)))]
    still = (np.zeros(3), (0.0, 0.0, 0.0, 1.0), np.zeros(3), np.zeros(3))
    made[t.ODOM] = made[t.POSE] = [encode(odometry_msg(stamp, *still)) for stamp in range(1, 30)]
    made[t.CLOUD] = [encode(cloud_msg(stamp, "base_link", np.ones((9, 3)))) for stamp in range(1, 30)]
    return made


@pytest.mark.parametrize("name", SMALL)
def test_nothing_broken_ends_a_process(samples: Samples, name: str, tmp_path: Path) -> None:
    given, crashes, traces, _ = fuzz(name, samples, 600, 7, fuzz_config(), tmp_path)
    assert given == 600
    assert not crashes, "\n".join(traces.values())


def test_every_stage_and_every_reader_is_a_target() -> None:
    assert TARGETS.keys() >= {"robot", "odometry", "elevation", "planner", "recorder", "replay", *SMALL}


def test_the_same_seed_breaks_the_same_way(samples: Samples) -> None:
    first, second = Mutator(3, samples), Mutator(3, samples)
    drawn = [first.draw(t.TOPICS, 0.2) for _ in range(300)]
    assert drawn == [second.draw(t.TOPICS, 0.2) for _ in range(300)]
    broken = sum(payload not in samples[topic] for topic, payload in drawn)
    assert broken > 150, "the rest are sound messages, and mutations that change nothing"


@pytest.mark.parametrize("place", [math.nan, math.inf, 1e12])
def test_a_map_that_lies_nowhere_is_refused(samples: Samples, place: float) -> None:
    message = decode(samples[t.MAP_WINDOW][0], msg.GridMap)
    message.info.pose.position.x = place
    with pytest.raises(LayoutError):
        map_patch(message, 0)


def test_a_map_without_end_is_refused(samples: Samples) -> None:
    message = decode(samples[t.MAP_WINDOW][0], msg.GridMap)
    message.info.resolution = 1e-310
    with pytest.raises(LayoutError):
        map_patch(message, 0)


def test_one_patch_far_off_does_not_fill_the_memory() -> None:
    layers = {name: np.zeros((4, 4), np.float32) for name in PATCH_LAYERS}
    mirror = MapMirror()
    mirror.apply(MapPatch((5e6, 5e6), 0.04, 1, 0, layers))
    mirror.apply(MapPatch((0.0, 0.0), 0.04, 2, 0, layers))
    assert mirror.nbytes < 200_000
    assert mirror.grid(mirror.view((0.0, 0.0))).shape == (64, 64)
    with pytest.raises(MapError, match="too large"):
        mirror.patch()


@pytest.mark.parametrize("field", ["start_x", "start_yaw", "goal_y"])
def test_a_plan_request_that_is_not_finite_is_not_answered(field: str) -> None:
    planner = build_stages(fuzz_config(), ["planner"])["planner"][0]
    request = msg.PlanRequest(goal_id="a", start_x=1.0, start_y=1.0, goal_x=2.0, goal_y=1.0)
    assert planner.on(t.PLAN_REQUEST, request) != []
    setattr(request, field, math.inf)
    assert planner.on(t.PLAN_REQUEST, request) == []


@pytest.mark.parametrize("spoil", ["name", "layer"])
def test_a_map_with_more_names_than_layers_or_fewer_is_refused(samples: Samples, spoil: str) -> None:
    message = decode(samples[t.MAP_WINDOW][0], msg.GridMap)
    (message.layers if spoil == "name" else message.data).pop()
    with pytest.raises(LayoutError, match="names for"):
        map_patch(message, 0)
