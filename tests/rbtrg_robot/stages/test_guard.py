"""The guard as a stage: what it says of the ground and of the newest sweep, and when it sees too little."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from hal.robots import describe
from hal.safety.monitors import GUARD_BLIND, MAIN_SILENT, taken_out
from hal.safety.swept import LIDAR, PLANTS
from hal.types import NS, JointSample
from mapping.elevation.exchange import PATCH_LAYERS, MapPatch
from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.config import load
from rbtrg_robot.stages import guard
from rbtrg_robot.topics import Topic
from rbtrg_robot.wire.convert import cloud_msg, joint_msg, odometry_msg, patch_msg, rpy_quaternion
from rbtrg_robot.wire.messages import decode, encode
from tests.rbtrg_robot.hearsay import map_offset

RES = 0.04
CONFIG = load(None, ["graph.max_step=0.1"], scene="flat")
FAR_AWAY = np.array([[5.0, 0.0, 1.0]])
START = (2.0, 3.0, 1.0)
"""Where `odom` lies in `map`: x, y [m], yaw [rad]."""


class Around:
    """The robot at the origin of `odom`, turned by `yaw`; what is `silent` stays away."""

    def __init__(self, yaw: float = 0.0) -> None:
        self.stage = guard.build(CONFIG)
        self.now = NS
        self.yaw = yaw
        self.silent: set[Topic] = {t.HEAD_CLOUD}
        self.by = t.CLOUD
        """The cloud that holds the points; the main one is empty where it is that of the head."""
        self.head: Any = None
        """Points of the head's sweep where they are others."""
        self.limits: Any = None
        self.position, self.orientation = (0.0, 0.0, 0.4), rpy_quaternion((0.0, 0.0, yaw))
        self.hear(t.TF_STATIC, map_offset(*START))

    def hear(self, topic: Topic, message: Any) -> None:
        if topic not in self.silent:
            self.stage.on(topic, decode(encode(message), topic.kind))

    def tick(self, height: Any, points: Any = (), **others: Any) -> msg.MotionLimits:
        """A tenth of a second: `height(forward, left)` of the ground [m], `others` layers of the map, `points` (n, 3)
        [m] in base_link."""
        self.now += NS // 10
        corner = (round(START[0] / RES) - 70) * RES, round(START[1] / RES - 70) * RES
        x, y = np.meshgrid(corner[0] + RES * np.arange(141), corner[1] + RES * np.arange(141))
        turn = START[2] + self.yaw
        c, s = math.cos(turn), math.sin(turn)
        forward = c * (x - START[0]) + s * (y - START[1])
        left = c * (y - START[1]) - s * (x - START[0])
        layers = {name: np.zeros(x.shape, np.float32) for name in PATCH_LAYERS}
        layers["elevation"] = np.asarray(height(forward, left), np.float32)
        layers["trusted"][:], layers["source"][:] = 1.0, LIDAR
        for name, layer in others.items():
            layers[name] = np.asarray(layer(forward, left), np.float32)
        pose = odometry_msg(self.now, self.position, self.orientation, np.zeros(3), np.zeros(3))
        swept = np.concatenate([FAR_AWAY, np.reshape(points, (-1, 3))]).astype(np.float32)
        for topic, message in (
            (t.MAP_WINDOW, patch_msg(MapPatch(corner, RES, self.now, 0, layers))),
            (t.CLOUD, cloud_msg(self.now, "base_link", swept if self.by is t.CLOUD else swept[:0])),
            (
                t.HEAD_CLOUD,
                cloud_msg(self.now, "base_link", swept if self.head is None else _cloud(self.head)),
            ),
            (t.ODOM, pose),
            (t.POSE, pose),
        ):
            self.hear(topic, message)
        ((_, limits),) = self.stage.tick(self.now)
        return decode(encode(limits), t.MOTION_LIMITS.kind)


def _cloud(points: Any) -> Any:
    return np.reshape(points, (-1, 3)).astype(np.float32)


def flat(forward: Any, left: Any) -> Any:
    return 0.0 * forward * left


def four(limits: msg.MotionLimits) -> tuple[float, ...]:
    return limits.forward, limits.backward, limits.left, limits.right


@pytest.mark.parametrize("yaw", [0.0, 2.5])
def test_free_ground_limits_nothing(yaw: float) -> None:
    assert four(Around(yaw).tick(flat)) == (1.0, 1.0, 1.0, 1.0)


@pytest.mark.parametrize("yaw", [0.0, -2.0])
def test_a_wall_limits_the_way_towards_it(yaw: float) -> None:
    limits = Around(yaw).tick(lambda forward, _: 0.5 * (forward > 0.7))
    free = 0.7 - 0.35
    fastest = limits.forward
    assert 0.3 * fastest + fastest**2 / (2 * 1.5) + 0.03 == pytest.approx(free, abs=RES)
    assert four(limits)[1:] == (1.0, 1.0, 1.0)
    assert limits.reason.startswith("a 0.50 m face 0.3")
    assert limits.reason.endswith("ahead")


@pytest.mark.parametrize(
    ("below", "what"), [(-0.5, "a 0.50 m drop"), (math.nan, "ground nobody saw")], ids=["drop", "unseen"]
)
def test_a_drop_limits_every_way_and_ground_nobody_saw_the_way_back(below: float, what: str) -> None:
    behind = Around().tick(lambda forward, _: np.where(forward < -0.8, below, 0.0))
    assert behind.backward < 0.8
    assert (behind.forward, behind.left, behind.right) == (1.0, 1.0, 1.0)
    assert what in behind.reason
    ahead = Around().tick(lambda forward, _: np.where(forward > 0.8, below, 0.0))
    assert (ahead.forward < 0.8) == ("drop" in what)
    assert four(ahead)[1:] == (1.0, 1.0, 1.0)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_post_beside_the_front_limits_the_turn_towards_it(side: float) -> None:
    """Where the front corner comes past soon, and the other three do not."""
    limits = Around().tick(lambda forward, left: 0.5 * (np.hypot(forward - 0.19, side * left - 0.33) < 0.05))
    there, away = (limits.left, limits.right) if side > 0.0 else (limits.right, limits.left)
    assert there < 0.7
    assert (limits.forward, limits.backward, away) == (1.0, 1.0, 1.0)
    assert ("to the left" if side > 0.0 else "to the right") in limits.reason


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_at_a_wall_it_creeps_along_and_away_unless_it_leans(side: float) -> None:
    """Its side is 7 cm in the wall of the map, as of a robot that leans; a cell more ahead, as on a map."""
    for roll, creeping in ((0.0, 0.2), (20.0, 0.2), (28.0, 0.0)):
        grade = side * math.tan(math.radians(roll))
        around = Around(0.3)
        around.orientation = rpy_quaternion((side * math.radians(roll), 0.0, 0.3))

        def height(forward: Any, left: Any, grade: float = grade) -> Any:
            wall = side * left < np.where(forward > 0.5, -0.12, -0.15)
            return np.where(wall, 0.8, 0.0) + grade * left

        limits = around.tick(height)
        assert limits.forward == limits.backward == creeping
        assert max(limits.left, limits.right) < 0.1
        assert ("a wall that the body touches ahead" in limits.reason) == (creeping > 0.0)
    askew = Around().tick(lambda forward, left: 0.8 * (side * left + 0.2 * forward > 0.25))
    assert askew.forward < 0.05
    assert askew.backward == 1.0
    into, away = (askew.left, askew.right) if side > 0.0 else (askew.right, askew.left)
    assert into == 0.0
    assert 0.1 < away <= 0.3


def test_it_tells_of_ground_that_comes_up_to_a_shank_where_it_knows_the_joints() -> None:
    around, robot = Around(), describe()
    around.position = (0.0, 0.0, robot.height)

    def kerb(forward: Any, left: Any) -> Any:
        return 0.1 * ((np.abs(forward) < 0.4) & (left > 0.0))

    assert not around.tick(kerb).near_body
    around.hear(t.JOINTS, joint_msg(JointSample(around.now, robot.pose, np.zeros(16), np.zeros(16))))
    assert around.tick(kerb).near_body
    assert not around.tick(flat).near_body


def test_ground_that_the_map_does_not_trust_is_ground_nobody_saw() -> None:
    limits = Around().tick(flat, trusted=lambda forward, _: forward > -0.8)
    assert limits.backward < 0.8
    assert "ground nobody saw" in limits.reason
    assert limits.forward == 1.0


def test_where_the_map_knows_no_ground_at_all_nothing_moves() -> None:
    """What a sweep sees is told by its height above the ground: without any, a wall before the robot was taken for
    something high above it."""
    around = Around()
    around.position = (0.0, 0.0, 5.4)
    wall = [[0.6, y, z] for y in np.linspace(-0.3, 0.3, 20) for z in (-0.1, 0.0, 0.1)]

    def unseen(forward: Any, _: Any) -> Any:
        return np.full_like(forward, np.nan)

    limits = around.tick(unseen, points=wall, upper_bound=unseen)
    assert four(limits) == (0.0, 0.0, 0.0, 0.0)
    assert limits.reason == "the map knows no ground around the robot"
    known = around.tick(
        lambda forward, _: np.where(forward < 0.5, 5.0, np.nan), points=wall, upper_bound=unseen
    )
    assert known.forward < 0.8
    assert "something the last sweep saw" in known.reason


def test_a_drop_that_only_rays_have_shown_limits_the_way_ahead() -> None:
    """Nobody saw its ground, but it lies lower than this."""

    def hidden(forward: Any, _: Any) -> Any:
        return np.where(forward > 0.8, np.nan, 0.0)

    limits = Around().tick(hidden, upper_bound=lambda forward, _: np.where(forward > 0.8, -0.5, np.nan))
    assert limits.forward < 0.8
    assert "a 0.50 m drop" in limits.reason
    assert Around().tick(hidden, upper_bound=lambda forward, _: np.full_like(forward, np.nan)).forward == 1.0


def test_points_lie_as_much_higher_as_the_map_was_corrected() -> None:
    around = Around()
    low = np.array([[0.6, y, z] for y in (-0.03, 0.0, 0.03) for z in (-0.37, -0.36, -0.35)])
    assert around.tick(flat, low).forward == 1.0
    around.hear(t.MAP_STATUS, t.MAP_STATUS.kind(height_correction=0.2))
    assert around.tick(flat, low).forward < 0.7


@pytest.mark.parametrize("yaw", [0.0, 1.3])
def test_what_the_newest_sweep_shows_limits_before_the_map_has_it(yaw: float) -> None:
    around = Around(yaw)
    leg = np.array(
        [[-0.6, y, z] for y in (-0.03, 0.0, 0.03) for z in (-0.2, -0.1, 0.0)]
    )  # base_link is 0.4 m up
    limits = around.tick(flat, leg)
    assert limits.backward < 0.7
    assert (limits.forward, limits.left, limits.right) == (1.0, 1.0, 1.0)
    assert "behind" in limits.reason
    low, high = leg - np.array([0.0, 0.0, 0.15]), leg + np.array([0.0, 0.0, 0.6])
    assert around.tick(flat, low[low[:, 2] < -0.29]).backward == 1.0, "no higher than a step"
    assert around.tick(flat, high[high[:, 2] > 0.2]).backward == 1.0, "it hangs above the robot"
    assert around.tick(flat, leg[:2]).backward == 1.0, "two points are no leg"
    assert around.tick(flat).backward == 1.0, "it is gone"


def test_points_in_leaves_are_none_and_what_stands_above_them_is() -> None:
    around = Around()
    leaf = np.array(
        [[0.6, y, z] for y in (-0.03, 0.0, 0.03) for z in (-0.2, -0.17, -0.14)]
    )  # 0.2 m above the ground
    grass = {
        "source": lambda forward, _: np.where(forward > 0.38, PLANTS, LIDAR),
        "upper_bound": lambda forward, left: flat(forward, left) + 0.3,
    }
    assert around.tick(flat, leaf).forward < 0.7, "without a mark"
    limits = around.tick(flat, leaf, **grass)
    near = limits.forward
    assert near == 0.2
    assert limits.backward == 1.0
    assert limits.reason.startswith("grass ahead")
    assert around.tick(flat, **grass).forward == near, "the points do not count"
    person = leaf + np.array([-0.15, 0.0, 0.25])
    limits = around.tick(flat, person, **grass)
    assert limits.forward < near
    assert "the last sweep saw" in limits.reason
    grass["source"] = lambda forward, _: np.where(forward > 0.9, PLANTS, LIDAR)
    assert "the last sweep saw" in around.tick(flat, leaf, **grass).reason, "no mark where they lie"


def test_in_leaves_every_motion_is_slow() -> None:
    limits = Around().tick(
        flat,
        source=lambda forward, left: np.full_like(forward + left, PLANTS),
        upper_bound=lambda a, b: flat(a, b) + 0.3,
    )
    assert four(limits) == (0.2, 0.2, 0.5, 0.5)


def test_a_sweep_from_the_future_hides_none_that_comes_after_it() -> None:
    around = Around()
    around.tick(flat)
    late = around.now + 60 * NS
    around.hear(t.CLOUD, cloud_msg(late, "base_link", np.zeros((0, 3), np.float32)))
    around.hear(t.ODOM, odometry_msg(late, around.position, around.orientation, np.zeros(3), np.zeros(3)))
    leg = np.array([[0.6, y, z] for y in (-0.03, 0.0, 0.03) for z in (-0.2, -0.1, 0.0)])
    assert around.tick(flat, leg).forward < 0.7


@pytest.mark.parametrize(("topic", "limit"), [(t.MAP_WINDOW, 0.5), (t.POSE, 0.2)])
def test_without_new_inputs_nothing_is_allowed(topic: Topic, limit: float) -> None:
    around = Around()
    around.tick(flat)
    around.silent = {topic}
    for tenth in range(1, 9):
        limits = around.tick(flat)
        allowed = 1.0 if tenth / 10 <= limit else 0.0
        assert four(limits) == (allowed,) * 4
    assert limits.reason.startswith(f"{topic.name} is 0.8 s old")


def test_a_pose_from_the_future_allows_nothing() -> None:
    around = Around()
    around.tick(flat)
    around.silent = {t.POSE}
    later = around.now + 60 * NS
    around.stage.on(
        t.POSE, odometry_msg(later, around.position, around.orientation, np.zeros(3), np.zeros(3))
    )
    assert four(around.tick(flat)) == (0.0,) * 4
    around.silent = set()
    assert four(around.tick(flat)) == (1.0,) * 4


@pytest.mark.parametrize("topic", [t.TF_STATIC, t.MAP_WINDOW, t.POSE])
def test_nothing_is_allowed_before_everything_was_seen(topic: Topic) -> None:
    around = Around()
    if topic is t.TF_STATIC:
        around.stage = guard.build(CONFIG)
    around.silent = {topic}
    limits = around.tick(flat)
    assert four(limits) == (0.0,) * 4
    assert limits.reason == f"no {topic.name} yet"


@pytest.mark.parametrize(
    ("position", "orientation"),
    [
        ((math.nan, 0.0, 0.4), None),
        ((0.0, math.inf, 0.4), None),
        ((1e300, 0.0, 0.4), None),
        ((9.0, 0.0, 0.4), None),
        (None, (math.nan, 0.0, 0.0, 1.0)),
    ],
)
def test_a_pose_off_the_window_allows_nothing(position: Any, orientation: Any) -> None:
    around = Around()
    around.position = position or around.position
    around.orientation = orientation or around.orientation
    limits = around.tick(flat)
    assert four(limits) == (0.0,) * 4
    assert limits.reason == "/odom/fast lies outside of /elevation_map/window"


def test_a_start_in_the_map_that_is_no_number_allows_nothing() -> None:
    around = Around()
    around.stage = guard.build(CONFIG)
    around.hear(t.TF_STATIC, map_offset(*START[:2], math.nan))
    limits = around.tick(flat)
    assert four(limits) == (0.0,) * 4
    assert limits.reason == "no /tf_static yet"


def test_a_correction_of_the_map_that_is_no_number_hides_no_obstacle() -> None:
    around = Around()
    leg = np.array([[0.6, y, z] for y in (-0.03, 0.0, 0.03) for z in (-0.2, -0.1, 0.0)])
    around.hear(t.MAP_STATUS, t.MAP_STATUS.kind(height_correction=math.nan))
    assert around.tick(flat, leg).forward < 0.7


def test_without_a_sweep_nothing_moves_and_the_age_is_told() -> None:
    around = Around()
    for _ in range(5):
        assert around.tick(flat).forward == 1.0
    around.silent |= {t.CLOUD}
    held = [around.tick(flat) for _ in range(10)]
    assert [four(limits) == (0.0,) * 4 for limits in held] == [False] * 5 + [True] * 5
    assert held[-1].reason.startswith("no sweep of any LiDAR for 1.0 s")
    with taken_out(GUARD_BLIND.name, MAIN_SILENT.name):
        assert around.tick(flat).forward == 1.0
    around.silent -= {t.CLOUD}
    assert around.tick(flat).forward == 1.0


def test_where_sweeps_and_map_end_together_the_lidars_are_named() -> None:
    """The operator read that the map's window is old, which follows from it."""
    around = Around()
    assert around.tick(flat).forward == 1.0
    around.silent |= {t.CLOUD, t.MAP_WINDOW}
    for _ in range(10):
        limits = around.tick(flat)
    assert limits.reason.startswith("no sweep of any LiDAR for 1.0 s")
    around.silent -= {t.CLOUD}
    assert around.tick(flat).reason.startswith(f"{t.MAP_WINDOW.name} is 1.1 s old")


def test_a_sweep_from_the_future_makes_no_guard_see() -> None:
    around = Around()
    around.silent |= {t.CLOUD}
    later = cloud_msg(around.now + 3600 * NS, "base_link", FAR_AWAY.astype(np.float32))
    around.stage.on(t.CLOUD, decode(encode(later), t.CLOUD.kind))
    assert four(around.tick(flat)) == (0.0,) * 4


def test_with_the_heads_lidar_alone_it_creeps_and_sees_what_that_sees() -> None:
    around = Around()
    around.silent, around.by = set(), t.HEAD_CLOUD
    assert four(around.tick(flat)) == (0.2, 0.2, 0.3, 0.3)
    box = [(0.42 + 0.01 * k, 0.05 * j, -0.1) for k in range(5) for j in range(-3, 4)]
    limits = around.tick(flat, box)
    assert limits.forward < 0.2
    assert "something the last sweep saw" in limits.reason
    assert "the main LiDAR is silent for more than 0.1 s" in limits.reason, "it never spoke"
    around.by = t.CLOUD
    assert "silent" not in around.tick(flat).reason
    around.by = t.HEAD_CLOUD
    for _ in range(30):
        limits = around.tick(flat)
    assert "the main LiDAR is silent for 3.0 s" in limits.reason, (
        "however many sweeps of the other came since"
    )
    with taken_out(MAIN_SILENT.name):
        assert four(around.tick(flat))[1:] == (1.0, 1.0, 1.0)


def test_where_the_main_lidar_speaks_the_heads_noise_stops_nobody() -> None:
    around = Around()
    around.silent = {t.CLOUD}
    around.tick(flat)
    around.silent = set()
    box = [(0.42 + 0.01 * k, 0.05 * j, -0.1) for k in range(5) for j in range(-3, 4)]
    assert around.tick(flat, box).forward < 0.3
    around.head = box
    assert around.tick(flat).forward == 1.0
