"""The goal's lifecycle, message by message."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from hal.rotation import wrap
from hal.safety.geofence import Fence
from hal.safety.monitors import GOAL_SPENT, PLACE_UNSURE, taken_out
from hal.types import NS
from planning.tracking.tracker import PathTracker
from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.areas import ground_area
from rbtrg_robot.process.events import Events
from rbtrg_robot.stage_config import NavigatorConfig
from rbtrg_robot.stages.navigation.goal import GoalArea, GoalState
from rbtrg_robot.stages.navigation.navigator import NavigatorStage
from rbtrg_robot.stages.navigation.progress import Pose2, Trail
from rbtrg_robot.stages.navigation.reasons import words
from rbtrg_robot.topics import Topic
from rbtrg_robot.wire.convert import odometry_msg, quaternion, rpy_quaternion
from rbtrg_robot.wire.messages import encode, header
from tests.rbtrg_robot.hearsay import map_offset

SQUARE = ((-5.0, -5.0), (5.0, -5.0), (5.0, 5.0), (-5.0, 5.0))


class World:
    """Plays everyone the navigator talks to."""

    def __init__(
        self, area: Any = None, *, placed: bool = True, tilt: float = 0.0, creep: float = 0.0
    ) -> None:
        goals = GoalArea(Fence.of(area), 0.46)
        self.stage = NavigatorStage(NavigatorConfig(), goals, max_trunk_tilt=tilt, creep=creep)
        self.now = 0
        self.out: list[tuple[Topic, Any]] = []
        self.pose = (0.0, 0.0, 0.0)
        self.health = "good"
        self.place_sigma = 0.01
        self.silent: set[Topic] = set()
        self.tracker_phase = "following"
        self.heading_error = 0.0
        self.tracker_obeys = True
        self.estop = False
        self.taken = ""
        self.phase = "ready"
        self.cause = "standing"
        self.vx = 0.0
        self.tracker_hold = ""
        self.cross_track = 0.0
        self.left = 2.0
        self.route_valid = True
        if placed:
            self.place(0.0, 0.0, 0.0)

    def place(self, x: float, y: float, yaw: float) -> None:
        """Say where `odom` lies in `map`."""
        self._take(self.stage.on(t.TF_STATIC, map_offset(x, y, yaw)))

    def send(self, topic: Topic, **fields: Any) -> None:
        fields.setdefault("header", header(self.now, "map"))
        self._take(self.stage.on(topic, topic.kind(**fields)))

    def _take(self, outputs: list[tuple[Topic, Any]]) -> None:
        for _, message in outputs:
            encode(message)  # every output must survive the wire
        self.out += outputs

    def run(self, seconds: float) -> None:
        """Everyone publishes at 10 Hz."""
        for _ in range(round(seconds * 10)):
            self.now += NS // 10
            x, y, yaw = self.pose
            if t.ODOM not in self.silent:
                q = rpy_quaternion((0.0, 0.0, yaw))
                odom = odometry_msg(self.now, (x, y, 0.0), q, np.zeros(3), np.zeros(3))
                self._take(self.stage.on(t.ODOM, odom))
            reason = "no overlap" if self.health == "lost" else ""
            self.send(t.ODOM_HEALTH, health=self.health, reason=reason, place_sigma=self.place_sigma)
            if t.MAP_STATUS not in self.silent:
                self.send(t.MAP_STATUS)
            self.send(
                t.ROBOT_STATE,
                phase=self.phase,
                cause=self.cause,
                estop=self.estop,
                estop_cause="operator" if self.estop else "",
                taken=self.taken,
                vx=self.vx,
            )
            path = self.last(t.PATH_COMMAND)
            path_id = path.id if path is not None and self.tracker_obeys else ""
            phase = self.tracker_phase if path_id else "idle"
            self.send(
                t.TRACKER_STATE,
                path_id=path_id,
                phase=phase,
                distance_left=self.left,
                heading_error=self.heading_error,
                hold=self.tracker_hold,
                cross_track=self.cross_track,
            )
            if t.ROUTE_STATUS not in self.silent and self.last(t.PLAN_REQUEST) is not None:
                request = self.last(t.PLAN_REQUEST)
                self.send(
                    t.ROUTE_STATUS,
                    goal_id=request.goal_id,
                    sequence=request.sequence,
                    valid=self.route_valid,
                    detail="" if self.route_valid else "a step of 0.3 m",
                )
            self._take(self.stage.tick(self.now))

    def come_along(self) -> None:
        """It drives 0.95 m along x, from the origin."""
        for i in range(20):
            self.pose = (0.05 * i, 0.0, 0.0)
            self.run(0.1)

    def hold_a_turn(self) -> None:
        """On its way the guard holds it in a turn, and ahead, until it counts as stuck."""
        self.come_along()
        self.goal()
        self.answer()
        self.tracker_phase = "aligning"
        self.send(t.MOTION_LIMITS, forward=0.1, backward=1.0, left=1.0)
        self.run(5.5)

    def goal(self, x: float = 3.0, y: float = 0.0, goal_id: str = "g", **fields: Any) -> None:
        self.send(t.GOAL_REQUEST, id=goal_id, x=x, y=y, **fields)

    def answer(
        self,
        *,
        ok: bool = True,
        reaches: bool = True,
        reason: str = "",
        kerb: float = math.inf,
        unseen: float = 0.0,
        creep: bool = False,
        length: float = 1.0,
        p_fail: float = math.nan,
        worst: str = "",
    ) -> None:
        """The planner answers the newest request; a kerb of 0.1 m begins at x = `kerb` [m]; `unseen`: share of the
        second half of the way."""
        request = self.last(t.PLAN_REQUEST)
        line = np.linspace(0.0, 1.0, 11 if kerb > 1.0 else 51)
        self.send(
            t.PLAN,
            goal_id=request.goal_id,
            sequence=request.sequence,
            ok=ok,
            reason=reason,
            reaches_goal=reaches,
            creep=creep,
            length=length,
            p_fail=p_fail,
            worst=worst,
            x=line,
            y=0 * line,
            z=0.1 * (line > kerb),
            yaw=0 * line,
            speed=0 * line + 0.5,
            transition_body=np.array([0.1, 0.4]),
            transition_length=np.array([0.5, 0.5]),
            transition_unknown=np.array([0.0, unseen]),
        )

    def last(self, topic: Topic) -> Any:
        found = [m for x, m in self.out if x is topic]
        return found[-1] if found else None

    def count(self, topic: Topic) -> int:
        return sum(x is topic for x, _ in self.out)

    @property
    def status(self) -> Any:
        return self.last(t.GOAL_STATUS)


@pytest.fixture
def world() -> World:
    """A robot that stands at the origin with everything running."""
    made = World()
    made.run(0.5)
    return made


def test_a_goal_is_planned_driven_and_reached(world: World) -> None:
    world.goal()
    assert world.status.state == "planning"
    world.answer()
    assert world.status.state == "moving"
    assert world.status.risk == 0.4
    assert len(world.last(t.PATH_COMMAND).x) == 11
    world.run(1.0)
    world.pose = (2.9, 0.1, 0.0)
    world.tracker_phase = "done"
    world.run(0.2)
    assert world.status.state == "reached"
    assert world.last(t.PATH_COMMAND).id == ""


@pytest.mark.parametrize(
    ("sigma", "without", "state"),
    [(0.10, "", "reached"), (0.20, "", "aborted"), (0.20, PLACE_UNSURE.name, "reached")],
)
def test_a_goal_is_reached_only_where_the_place_is_known_as_well_as_it_asks(
    world: World, sigma: float, without: str, state: str
) -> None:
    """Two standard deviations must lie within the tolerance of 0.25 m."""
    world.place_sigma = sigma
    world.goal()
    world.answer()
    world.pose = (2.9, 0.1, 0.0)
    world.tracker_phase = "done"
    with taken_out(*filter(None, [without])):
        world.run(0.2)
    assert world.status.state == state
    if state == "aborted":
        assert world.status.reason == "place_unsure"
        assert "within 0.40 m" in world.status.detail


def test_a_way_over_ground_that_nobody_saw_is_told(world: World) -> None:
    world.goal(1.0, 0.0)
    world.answer(unseen=0.2)
    assert (world.status.state, world.status.detail) == ("moving", "")
    world.goal(1.0, 0.5, "h")
    world.answer(unseen=0.8)
    assert world.status.detail == "up to 0.4 m of the way lead over ground that nobody saw"


@pytest.mark.parametrize("asked", [True, False])
def test_a_goal_whose_heading_could_not_be_had_is_not_called_reached(world: World, asked: bool) -> None:
    world.goal(1.0, 0.0, yaw=1.5, has_yaw=asked)
    world.answer()
    world.pose = (1.0, 0.0, 1.0)
    world.tracker_phase, world.heading_error = "final_turn", 0.5
    if asked:
        world.run(14.0)
        assert world.status.state == "moving", "the tracker turns, which is no standstill"
    world.tracker_phase = "done"
    world.run(0.2)
    if asked:
        assert (world.status.state, world.status.reason) == ("aborted", "stuck")
        assert "29 deg off its heading" in world.status.detail
    else:
        assert world.status.state == "reached"


def test_a_robot_that_rests_at_its_goal_is_there_wherever_its_path_ends(world: World) -> None:
    world.goal(1.0, 0.0)
    world.answer()
    world.pose = (0.7, 0.0, 0.0)
    world.run(2.0)
    assert world.status.state == "moving", "too far away"
    world.pose = (0.8, 0.0, 0.0)
    world.run(0.8)
    assert world.status.state == "moving", "it may be under way"
    world.run(0.5)
    assert world.status.state == "reached"


@pytest.mark.parametrize("x", [1.06, 0.8])
def test_a_plan_that_brings_a_robot_at_its_goal_no_nearer_ends_it(world: World, x: float) -> None:
    """The plan of this planner ends at x = 1."""
    world.goal(x, 0.0)
    world.pose = (0.98 if x > 1.0 else 0.82, 0.0, 0.0)
    world.run(0.1)
    world.answer(reaches=False)
    assert world.status.state == "reached"


def test_a_plan_that_brings_it_nearer_is_driven(world: World) -> None:
    world.goal(1.0, 0.0)
    world.pose = (0.8, 0.0, 0.0)
    world.run(0.1)
    world.answer()
    assert world.status.state == "moving"


@pytest.mark.parametrize("at", ["no route", "a route that went bad", "stuck"])
def test_a_robot_at_its_goal_looks_for_no_other_way(world: World, at: str) -> None:
    world.goal(1.0, 0.0)
    world.pose = (0.9, 0.0, 0.0)
    world.run(0.1)
    world.answer(ok=at != "no route", reason="no_route" if at == "no route" else "")
    for k in range(60):
        world.pose = (0.9 + 0.04 * (k % 2), 0.0, 0.0)  # it sways by more than a robot at rest
        world.route_valid = at != "a route that went bad" or k < 3
        world.run(0.1)
    assert world.status.state == "reached"
    assert world.status.recoveries == world.status.replans == 0


def shuttle(world: World) -> int:
    """To and fro until the goal ends, for 60 s at most; seconds."""
    world.goal(3.0, 0.0)
    world.answer()
    for seconds in range(60):
        if world.status.state != "moving":
            return seconds
        for x in (0.0, 0.3, 0.6, 0.3):
            world.pose = (x, 0.0, 0.0)
            world.run(0.25)
    return 60


def test_without_the_monitor_a_robot_shuttles_for_good(world: World) -> None:
    with taken_out(GOAL_SPENT.name):
        assert shuttle(world) == 60


def test_a_robot_that_shuttles_where_it_has_been_ends_the_goal_and_says_what_held_it(world: World) -> None:
    seconds = shuttle(world)
    assert (world.status.state, world.status.reason) == ("aborted", "stuck")
    assert 10 <= seconds <= 40
    assert "nowhere new" in world.status.detail
    assert "m from the goal" in world.status.detail


def test_a_robot_that_comes_along_new_ground_or_back_from_a_dead_end_keeps_its_goal(world: World) -> None:
    world.goal(30.0, 0.0)
    world.answer()
    for x in [*np.arange(0.0, 20.0, 0.05), *np.arange(20.0, 0.0, -0.05)]:
        world.pose = (float(x), 0.0, 0.0)
        world.route_valid = x < 19.9
        world.run(0.1)
        if not world.route_valid:
            world.answer(length=20.0)
    assert world.status.state == "moving"


def test_a_path_that_ends_short_of_the_goal_is_no_success(world: World) -> None:
    world.goal()
    world.answer()
    world.pose = (2.6, 0.0, 0.0)
    world.tracker_phase = "done"
    for _ in range(3):
        world.run(0.1)
        assert world.status.state == "moving"
        world.answer()
    world.run(0.1)
    assert (world.status.state, world.status.reason) == ("aborted", "no_route")
    assert "0.40 m" in world.status.detail


@pytest.mark.parametrize(
    "fields", [{"x": math.nan}, {"y": math.inf}, {"yaw": math.nan, "has_yaw": True}, {"timeout": math.nan}]
)
def test_goals_that_are_no_numbers_are_rejected(world: World, fields: dict[str, Any]) -> None:
    world.goal(**fields)
    assert (world.status.state, world.status.reason) == ("rejected", "invalid")
    assert world.count(t.PLAN_REQUEST) == 0


def test_a_goal_outside_the_area_is_rejected() -> None:
    world = World(SQUARE)
    world.run(0.5)
    world.goal(x=6.0)
    assert (world.status.state, world.status.reason) == ("rejected", "outside_area")
    world.goal(x=4.0, goal_id="inside")
    assert world.status.state == "planning"


def test_a_goal_nearer_to_the_fence_than_the_body_is_rejected_and_says_so() -> None:
    world = World(SQUARE)
    world.run(0.5)
    world.goal(x=4.6)
    assert (world.status.state, world.status.reason) == ("rejected", "outside_area")
    assert world.status.detail == "only 0.40 m to the edge of the allowed area; the body needs 0.46 m"
    world.goal(x=4.5, goal_id="inside")
    assert world.status.state == "planning"


def test_a_goal_in_an_area_that_was_drawn_to_be_kept_out_of_is_rejected_until_it_is_gone() -> None:
    world = World(SQUARE)
    world.run(0.5)
    pond = ground_area("pond", [(1, -1), (3, -1), (3, 1), (1, 1)], keep_out=True)
    world.send(t.AREAS, areas=[pond])
    world.goal(x=2.0)
    assert (world.status.state, world.status.reason) == ("rejected", "keep_out_area")
    assert words(world.status.reason, world.status.detail) == "the goal is in a keep-out area: by 1.0 m, pond"
    world.goal(x=0.7, goal_id="beside")
    assert world.status.detail == "only 0.30 m to the keep-out area pond; the body needs 0.46 m"
    world.send(t.AREAS)
    world.goal(x=2.0, goal_id="again")
    assert world.status.state == "planning"


@pytest.mark.parametrize(
    ("frame", "place", "heading"),
    [
        ("map", (1.0, 0.5), 0.2),
        ("odom", (1.5, 4.0), 0.2 + math.pi / 2),
        ("base_link", (1.5, 5.0), 0.2 + math.pi),
    ],
)
def test_a_goal_is_meant_in_the_frame_it_names(
    frame: str, place: tuple[float, float], heading: float
) -> None:
    world = World(placed=False)
    world.place(2.0, 3.0, math.pi / 2)
    world.pose = (2.5, -0.5, math.pi / 2)  # in `odom`: (2.5, 5.5) in `map`, heading pi
    world.run(0.5)
    world.goal(1.0, 0.5, yaw=0.2, has_yaw=True, header=header(world.now, frame))
    request = world.last(t.PLAN_REQUEST)
    assert (request.goal_x, request.goal_y) == pytest.approx(place)
    assert wrap(request.goal_yaw - heading) == pytest.approx(0.0, abs=1e-9)
    assert (world.status.x, world.status.y) == pytest.approx(place)


def test_a_pose_from_rviz_is_meant_in_its_frame_too(world: World) -> None:
    world.pose = (1.0, 0.0, math.pi / 2)
    world.run(0.2)
    pose = t.GOAL_POSE.kind(header=header(world.now, "base_link")).pose
    pose.position.x, pose.orientation.w = 2.0, 1.0
    world.send(t.GOAL_POSE, header=header(world.now, "base_link"), pose=pose)
    assert (world.status.x, world.status.y, world.status.yaw) == pytest.approx((1.0, 2.0, math.pi / 2))


@pytest.mark.parametrize("frame", ["", "world", "lidar"])
def test_a_goal_in_another_frame_is_rejected(world: World, frame: str) -> None:
    world.goal(header=header(world.now, frame))
    assert (world.status.state, world.status.reason) == ("rejected", "invalid")
    assert repr(frame) in world.status.detail


def test_nothing_is_planned_before_the_start_in_the_map_is_known() -> None:
    world = World(placed=False)
    world.run(0.5)
    world.goal(header=header(world.now, "odom"))
    assert (world.status.state, world.status.reason) == ("rejected", "invalid")
    assert "not known yet" in world.status.detail
    world.goal(goal_id="later")
    world.run(1.0)
    assert world.count(t.PLAN_REQUEST) == 0
    assert world.status.detail == "no /tf_static yet"
    world.place(0.0, 0.0, 0.0)
    world.run(0.3)
    assert world.count(t.PLAN_REQUEST) == 1


def test_a_goal_in_an_obstacle_is_rejected_after_looking_again(world: World) -> None:
    world.goal()
    for _ in range(3):
        world.answer(ok=False, reason="goal_in_obstacle")
        assert world.status.state == "planning", "the map may show free ground in a moment"
        world.run(1.5)
    world.answer(ok=False, reason="goal_in_obstacle")
    assert (world.status.state, world.status.reason) == ("rejected", "goal_in_obstacle")
    assert "3.00 m from the goal" in world.status.detail


def test_a_goal_that_had_a_route_is_aborted_not_rejected(world: World) -> None:
    world.goal()
    world.answer()
    world.route_valid = False
    for _ in range(4):
        world.run(1.5)
        world.answer(ok=False, reason="goal_in_obstacle")
    assert (world.status.state, world.status.reason) == ("aborted", "goal_in_obstacle")


def test_where_only_the_places_kept_off_are_left_the_way_leads_over_them(world: World) -> None:
    world.come_along()
    world.goal()
    world.answer()
    world.run(5.5)
    assert world.status.state == "recovering"
    world.tracker_phase = "done"
    world.run(0.1)
    world.tracker_phase = "following"
    for _ in range(4):
        assert len(world.last(t.PLAN_REQUEST).avoid) == 3
        world.answer(ok=False, reason="no_route")
        world.run(1.5)
    assert world.status.state == "planning"
    assert len(world.last(t.PLAN_REQUEST).avoid) == 0
    world.answer()
    assert world.status.state == "moving"


def test_a_plan_refused_for_a_reason_that_nobody_knows_counts_as_no_route(world: World) -> None:
    world.goal()
    for _ in range(4):
        world.answer(ok=False, reason="a whim")
        world.run(1.5)
    assert (world.status.state, world.status.reason) == ("aborted", "no_route")


def test_no_route_is_tried_again_before_it_is_final(world: World) -> None:
    world.goal()
    for _ in range(3):
        world.answer(ok=False, reason="no_route")
        assert world.status.state in ("planning", "accepted")
        world.run(1.5)
    world.answer(ok=False, reason="no_route")
    assert (world.status.state, world.status.reason) == ("aborted", "no_route")


def test_where_no_route_begins_it_backs_out_once_and_looks_again(world: World) -> None:
    for x in np.arange(0.0, 1.0, 0.1):
        world.pose = (float(x), 0.0, 0.0)
        world.run(0.1)
    world.goal()
    for expected in ("recovering", "aborted"):
        for _ in range(3):
            world.answer(ok=False, reason="no_route")
            assert world.status.state == "planning"
            world.run(1.5)
        world.answer(ok=False, reason="no_route")
        assert world.status.state == expected
        if expected == "recovering":
            back = world.last(t.PATH_COMMAND)
            assert back.x[0] > back.x[-1] > 0.2
            assert back.yaw[0] == pytest.approx(0.0), "the body keeps its heading: it drives backward"
            requests = world.count(t.PLAN_REQUEST)
            world.pose = (0.3, 0.0, 0.0)
            world.tracker_phase = "done"
            world.run(0.6)
            assert world.count(t.PLAN_REQUEST) == requests + 1
    assert world.status.reason == "no_route"


def test_repeating_a_request_changes_nothing(world: World) -> None:
    world.goal()
    world.answer()
    requests = world.count(t.PLAN_REQUEST)
    world.goal()
    assert world.count(t.PLAN_REQUEST) == requests
    assert world.status.state == "moving"


def test_a_new_goal_preempts(world: World) -> None:
    world.goal()
    world.answer()
    world.goal(goal_id="second", x=1.0)
    states = [(m.id, m.state) for x, m in world.out if x is t.GOAL_STATUS]
    assert ("g", "preempted") in states
    assert (world.status.id, world.status.state) == ("second", "planning")


def test_a_late_repeat_of_an_older_goal_starts_nothing(world: World) -> None:
    world.goal(goal_id="a")
    world.answer()
    world.goal(2.0, goal_id="b")
    world.answer()
    before = world.count(t.PLAN_REQUEST)
    world.goal(goal_id="a")
    assert (world.status.id, world.status.state) == ("b", "moving")
    assert world.count(t.PLAN_REQUEST) == before
    world.send(t.GOAL_REQUEST, action=1)
    world.goal(goal_id="a")
    world.goal(2.0, goal_id="b")
    assert (world.status.id, world.status.state) == ("b", "cancelled")
    assert world.count(t.PLAN_REQUEST) == before


def test_who_cancels_or_replaces_the_goal_of_another_is_told(world: World) -> None:
    world.goal(goal_id="a", owner="ann")
    world.send(t.GOAL_REQUEST, action=1, id="b", owner="bob")
    assert world.status.state == "planning", "that is another goal"
    world.send(t.GOAL_REQUEST, action=1, owner="bob")
    assert (world.status.owner, world.status.state, world.status.detail) == ("ann", "cancelled", "by bob")
    world.goal(goal_id="c", owner="ann")
    world.send(t.GOAL_REQUEST, action=1, owner="ann")
    assert (world.status.state, world.status.detail) == ("cancelled", "")
    world.goal(goal_id="d", owner="ann")
    world.goal(goal_id="e", owner="bob")
    ended = [m for x, m in world.out if x is t.GOAL_STATUS and m.id == "d"][-1]
    assert (ended.state, ended.owner, ended.detail) == ("preempted", "ann", "by bob")


def test_a_goal_waits_as_long_as_somebody_drives_by_hand(world: World) -> None:
    world.goal()
    world.answer()
    asked = world.count(t.PLAN_REQUEST)
    world.taken = "teleop has the motion"
    world.run(60.0)
    assert (world.status.state, world.status.detail) == ("paused", "teleop has the motion")
    assert world.last(t.PATH_COMMAND).id == ""
    assert world.count(t.PLAN_REQUEST) == asked
    world.taken, world.health = "", "lost"
    world.run(5.0)
    assert world.status.state != "aborted", "patience begins anew"
    world.health = "good"
    world.run(0.3)
    assert world.count(t.PLAN_REQUEST) == asked + 1
    world.answer()
    assert world.status.state == "moving"


def test_cancel_halts(world: World) -> None:
    world.goal()
    world.answer()
    world.send(t.GOAL_REQUEST, action=1)
    assert (world.status.state, world.status.reason) == ("cancelled", "cancelled")
    assert len(world.last(t.PATH_COMMAND).x) == 0


def test_a_timeout_aborts(world: World) -> None:
    world.goal(timeout=2.0)
    world.answer()
    world.run(2.3)
    assert (world.status.state, world.status.reason) == ("aborted", "timeout")


def test_the_emergency_stop_ends_the_goal_and_refuses_new_ones(world: World) -> None:
    world.goal()
    world.answer()
    world.estop = True
    world.run(0.3)
    assert (world.status.state, world.status.reason) == ("aborted", "emergency_stop")
    world.goal(goal_id="next")
    assert (world.status.state, world.status.reason) == ("rejected", "emergency_stop")


@pytest.mark.parametrize(
    ("phase", "reason"), [("sitting", "robot_lies"), ("damped", "robot_lies"), ("fault", "robot_fault")]
)
def test_a_robot_that_cannot_drive_ends_the_goal_and_refuses_new_ones(
    world: World, phase: str, reason: str
) -> None:
    world.goal()
    world.answer()
    world.phase = phase
    world.run(0.3)
    assert (world.status.state, world.status.reason) == ("aborted", reason)
    world.goal(goal_id="next")
    assert (world.status.state, world.status.reason) == ("rejected", reason)
    assert ("posture stand" in world.status.detail) == (phase != "fault")


def test_lost_localization_halts_then_resumes(world: World) -> None:
    world.goal()
    world.answer()
    world.health = "lost"
    world.run(0.5)
    assert len(world.last(t.PATH_COMMAND).x) == 0
    assert world.status.state == "moving"
    requests = world.count(t.PLAN_REQUEST)
    world.health = "good"
    world.run(0.5)
    assert world.count(t.PLAN_REQUEST) == requests + 1
    world.answer()
    assert len(world.last(t.PATH_COMMAND).x) == 11


def test_a_robot_out_of_contact_pauses_the_goal_and_soon_ends_it(world: World) -> None:
    """For a moment: a hiccup. For longer: it must not drive off under the hands of whoever plugs the cable in."""
    world.goal()
    world.answer()
    for seconds, state, reason in ((2.0, "moving", ""), (4.0, "aborted", "robot_disconnected")):
        world.phase = "disconnected"
        world.run(seconds)
        assert len(world.last(t.PATH_COMMAND).x) == 0
        assert (world.status.state, world.status.reason) == (state, reason)
        world.phase = "ready"
        world.run(0.5)
        assert len(world.last(t.PATH_COMMAND).x) == 0
        if not reason:
            world.answer()
            assert len(world.last(t.PATH_COMMAND).x) == 11


def test_localization_that_stays_lost_aborts(world: World) -> None:
    world.goal()
    world.answer()
    world.health = "lost"
    world.run(13.0)
    assert (world.status.state, world.status.reason) == ("aborted", "localization_lost")
    assert world.status.detail == "no overlap"


@pytest.mark.parametrize("silent", [t.ODOM, t.MAP_STATUS])
def test_a_silent_process_halts_then_aborts(world: World, silent: Topic) -> None:
    world.goal()
    world.answer()
    world.silent.add(silent)
    world.run(1.5)
    assert len(world.last(t.PATH_COMMAND).x) == 0
    world.run(12.0)
    assert (world.status.state, world.status.reason) == ("aborted", "process_lost")


def test_a_planner_that_does_not_answer_is_asked_again_then_given_up(world: World) -> None:
    world.goal()
    world.run(5.0)
    assert world.count(t.PLAN_REQUEST) == 3
    world.run(8.0)
    assert (world.status.state, world.status.reason) == ("aborted", "process_lost")


def test_the_answer_of_a_planner_that_was_silent_while_it_searched_is_driven(world: World) -> None:
    world.goal()
    world.run(0.3)
    world.silent.add(t.ROUTE_STATUS)
    world.run(3.0)
    world.answer()
    path = world.last(t.PATH_COMMAND)
    assert len(path.x) > 0
    world.run(0.1)
    assert world.status.state == "moving"
    assert world.last(t.PATH_COMMAND).id == path.id


def test_a_planner_that_dies_while_driving_halts(world: World) -> None:
    world.goal()
    world.answer()
    world.run(1.0)
    world.silent.add(t.ROUTE_STATUS)
    world.run(2.5)
    assert len(world.last(t.PATH_COMMAND).x) == 0


def test_new_routes_to_the_frontier_do_not_hide_that_the_robot_is_stuck(world: World) -> None:
    world.goal()
    world.answer(reaches=False)
    for _ in range(4):
        requests = world.count(t.PLAN_REQUEST)
        while world.count(t.PLAN_REQUEST) == requests and not world.status.recoveries:
            world.run(0.1)
        world.answer(reaches=False)
    assert world.status.recoveries == 1
    assert len(world.last(t.PLAN_REQUEST).avoid) == 3


def test_a_planner_that_dies_while_a_better_route_is_asked_for_halts(world: World) -> None:
    world.goal()
    world.answer(reaches=False)
    requests = world.count(t.PLAN_REQUEST)
    while world.count(t.PLAN_REQUEST) == requests:
        world.run(0.1)
    assert len(world.last(t.PATH_COMMAND).x) == 11  # it drives on while it asks
    world.silent.add(t.ROUTE_STATUS)
    world.run(2.5)
    assert len(world.last(t.PATH_COMMAND).x) == 0
    assert world.status.detail == "the planner is silent"
    world.answer()
    assert len(world.last(t.PATH_COMMAND).x) == 11


def test_a_route_that_went_bad_halts_and_replans(world: World) -> None:
    world.goal()
    world.answer()
    world.run(0.3)
    world.route_valid = False
    requests = world.count(t.PLAN_REQUEST)
    world.run(0.2)
    assert len(world.last(t.PATH_COMMAND).x) == 0
    assert world.count(t.PLAN_REQUEST) == requests + 1
    assert world.status.replans == 1


def test_at_a_frontier_it_looks_again(world: World) -> None:
    world.goal()
    world.answer(reaches=False)
    assert world.status.frontier
    world.tracker_phase = "done"
    requests = world.count(t.PLAN_REQUEST)
    world.run(0.2)
    assert world.count(t.PLAN_REQUEST) == requests + 1
    assert world.status.state == "moving"


def test_stuck_moves_out_then_replans_around_a_few_times_then_aborts(world: World) -> None:
    world.come_along()
    world.goal()
    for tries in range(1, 4):
        while world.status.recoveries < tries:
            world.answer(reaches=False)
            world.run(2.1)
        assert world.status.state == "recovering"
        path = world.last(t.PATH_COMMAND)
        assert (path.x[0], path.x[-1], path.yaw[0]) == pytest.approx((0.95, 0.35, 0.0))
        requests = world.count(t.PLAN_REQUEST)
        world.run(3.0)
        assert world.count(t.PLAN_REQUEST) == requests, "no better route is looked for while it moves out"
        world.tracker_phase = "done"
        world.run(0.1)
        world.tracker_phase = "following"
        np.testing.assert_allclose(world.last(t.PLAN_REQUEST).avoid, [0.95 + 0.5, 0.0, 0.3] * tries)
    world.answer()
    assert world.status.state == "moving"
    world.run(5.5)
    assert (world.status.state, world.status.reason) == ("aborted", "stuck")
    assert world.status.detail.startswith("after 3 recoveries; the robot is at x 0.95 y 0.00")


def test_recoveries_are_counted_at_each_place(world: World) -> None:
    world.goal(x=9.0)
    for tries in range(1, 7):
        for i in range(20):
            world.pose = (1.2 * tries + 0.05 * i, 0.0, 0.0)
            world.run(0.1)
        world.answer()
        world.run(5.5)
        assert (world.status.state, world.status.recoveries) == ("recovering", tries)
        world.tracker_phase = "done"
        world.run(0.1)
        world.tracker_phase = "following"


def test_over_an_edge_it_keeps_its_route_to_the_frontier(world: World) -> None:
    world.goal()
    requests = world.count(t.PLAN_REQUEST)
    world.answer(reaches=False, kerb=0.5)
    for x in np.arange(0.0, 0.95, 0.05):
        world.pose = (float(x), 0.0, 0.0)
        world.run(0.3)
        looked = world.count(t.PLAN_REQUEST) > requests
        assert looked == (x > 0.94), f"at {x:.2f} m"


def test_a_route_that_ends_on_an_edge_is_continued_before_its_end(world: World) -> None:
    world.goal()
    requests = world.count(t.PLAN_REQUEST)
    world.answer(reaches=False, kerb=0.5)
    world.pose = (0.5, 0.0, 0.0)
    world.run(0.9)
    assert world.count(t.PLAN_REQUEST) == requests
    world.left = 0.5
    world.run(0.2)
    assert world.count(t.PLAN_REQUEST) == requests + 1


def test_what_holds_a_robot_that_drives_backward_is_behind_it(world: World) -> None:
    world.come_along()
    world.pose = (0.3, 0.0, 0.0)
    world.goal()
    world.answer()
    world.vx = -0.5
    world.run(5.5)
    assert world.status.state == "recovering"
    assert world.last(t.PATH_COMMAND).x[-1] > 0.6, "it moves out forward, where it came from"
    world.tracker_phase = "done"
    world.run(0.1)
    np.testing.assert_allclose(world.last(t.PLAN_REQUEST).avoid, [0.3 - 0.5, 0.0, 0.3])


def test_a_robot_that_cannot_be_backed_out_asks_for_another_route(world: World) -> None:
    world.come_along()
    world.goal()
    world.answer()
    world.run(5.5)
    assert world.status.state == "recovering"
    world.vx = -0.5
    requests, paths = world.count(t.PLAN_REQUEST), world.count(t.PATH_COMMAND)
    world.run(5.5)
    assert world.status.recoveries == 2
    assert world.count(t.PLAN_REQUEST) == requests + 1
    assert world.count(t.PATH_COMMAND) == paths, "the same way out is not tried again"


def test_a_route_is_not_taken_back_while_the_robot_stands_on_the_face_it_crosses(world: World) -> None:
    world.goal()
    world.answer(kerb=0.5)
    world.pose = (0.3, 0.0, 0.0)
    world.route_valid = False
    requests = world.count(t.PLAN_REQUEST)
    world.run(2.0)
    assert world.count(t.PLAN_REQUEST) == requests, "it drives on over the kerb"
    assert world.last(t.PATH_COMMAND).id
    world.pose = (1.0, 0.0, 0.0)
    world.run(0.2)
    assert world.count(t.PLAN_REQUEST) == requests + 1
    assert world.last(t.PATH_COMMAND).id == "", "off the kerb it stands"
    world.route_valid = True
    world.pose = (0.3, 0.0, 0.0)
    world.answer(kerb=0.5)
    world.route_valid = False
    world.run(4.0)
    assert world.last(t.PATH_COMMAND).id == "", "it does not wait for ever"


def test_a_tracker_that_lost_its_path_gets_it_again(world: World) -> None:
    world.goal()
    world.answer()
    world.run(0.2)
    sent = world.count(t.PATH_COMMAND)
    world.tracker_obeys = False
    world.run(1.3)
    assert world.count(t.PATH_COMMAND) == sent + 2


def test_after_a_crash_an_active_goal_ends_with_a_reason() -> None:
    stage = NavigatorStage(NavigatorConfig())
    before = t.GOAL_STATUS.kind(header=header(1, "map"), id="g", state="moving", x=1.0)
    out = [m for x, m in stage.on(t.GOAL_STATUS, before) if x is t.GOAL_STATUS]
    assert (out[-1].id, out[-1].state, out[-1].reason) == ("g", "aborted", "process_lost")


def test_stale_plans_are_ignored(world: World) -> None:
    world.goal()
    request = world.last(t.PLAN_REQUEST)
    line = np.linspace(0.0, 1.0, 3)
    for goal_id, sequence in (
        ("other", request.sequence),
        ("g", request.sequence + 1),
        ("g", request.sequence - 1),
    ):
        world.send(
            t.PLAN, goal_id=goal_id, sequence=sequence, ok=True, x=line, y=line, z=line, yaw=line, speed=line
        )
    assert world.status.state == "planning"


def test_a_goal_from_rviz_is_a_goal(world: World) -> None:
    message = t.GOAL_POSE.kind(header=header(5, "map"))
    message.pose.position.x = 2.0
    message.pose.orientation.w = 1.0
    world._take(world.stage.on(t.GOAL_POSE, message))
    assert (world.status.state, world.status.x, world.status.has_yaw) == ("planning", 2.0, True)


def test_a_goal_without_an_id_is_one_and_so_is_the_next(world: World) -> None:
    for x in (3.0, 5.0):
        world.goal(x, goal_id="")
        assert (world.status.state, world.status.x) == ("planning", x)
        assert world.status.id
        world.run(1.0)
    stamped = header(7, "map")
    world.goal(6.0, goal_id="", header=stamped)
    first = world.status.id
    world.goal(6.0, goal_id="", header=stamped)
    assert world.status.id == first, "a repeat"


def test_a_turn_that_stalls_is_left_straight_along_the_heading_on_ground_it_stood_on(world: World) -> None:
    world.come_along()
    for heading, along in ((math.pi - 0.05, 1.0), (0.05, -1.0)):
        world.goal(goal_id=f"to{heading}")
        world.answer()
        world.pose = (0.95, 0.0, heading)  # an edge stalled the turn here
        world.tracker_phase = "aligning"
        world.run(5.5)
        assert (world.status.state, world.status.recoveries) == ("recovering", 1)
        path = world.last(t.PATH_COMMAND)
        way = np.column_stack([path.x, path.y]) - world.pose[:2]
        reach = way @ (math.cos(heading), math.sin(heading))
        np.testing.assert_allclose(np.hypot(*way.T), along * reach, atol=1e-9)
        assert 0.2 <= along * reach[-1] <= 0.6 + 1e-9
        tracker = PathTracker()
        tracker.set_path(way, path.yaw, path.speed)
        tracker.step(0, 0.0, 0.0, heading, 0.0, 0.0)
        step = tracker.step(NS // 50, 0.0, 0.0, heading, 0.0, 0.0)
        assert step.phase == "following"
        assert along * step.vx > 0.0
        assert step.wz == pytest.approx(0.0, abs=1e-6)
        world.tracker_phase = "done"
        world.run(0.1)
        assert len(world.last(t.PLAN_REQUEST).avoid) == 0, "the ground ahead did not hold it"


def test_a_turn_that_stalls_across_the_way_is_not_left_blindly(world: World) -> None:
    world.come_along()
    world.goal()
    world.answer()
    world.pose = (0.95, 0.0, 1.8)
    world.tracker_phase = "aligning"
    paths, requests = world.count(t.PATH_COMMAND), world.count(t.PLAN_REQUEST)
    world.run(5.5)
    assert world.status.recoveries == 1
    assert world.count(t.PLAN_REQUEST) == requests + 1
    moves = [m for x, m in world.out if x is t.PATH_COMMAND][paths:]
    assert all(len(m.x) == 0 for m in moves), "halts only"


def test_a_turn_that_is_held_goes_on_a_little_farther_ahead_then_backs_out(world: World) -> None:
    world.come_along()
    world.goal()
    for tries, end in ((1, 0.95 + 0.15), (2, 0.35)):
        world.answer()
        world.tracker_phase = "aligning"
        world.send(t.MOTION_LIMITS, forward=0.3, backward=1.0, left=1.0)
        world.run(5.5)
        assert (world.status.state, world.status.recoveries) == ("recovering", tries)
        assert world.last(t.PATH_COMMAND).x[-1] == pytest.approx(end)
        world.tracker_phase = "done"
        world.run(0.1)


def test_while_it_turns_on_the_spot_no_other_way_to_the_frontier_is_looked_for(world: World) -> None:
    world.goal()
    world.answer(reaches=False)
    world.left = 0.5
    world.tracker_phase = "aligning"
    requests = world.count(t.PLAN_REQUEST)
    world.run(3.0)
    assert world.count(t.PLAN_REQUEST) == requests
    world.tracker_phase = "following"
    world.run(0.2)
    assert world.count(t.PLAN_REQUEST) == requests + 1


@pytest.mark.parametrize("error", [0.5, -0.5])
def test_a_turn_that_the_guard_holds_is_asked_for_anew(world: World, error: float) -> None:
    world.goal()
    world.answer()
    world.tracker_phase, world.heading_error = "aligning", error
    requests = world.count(t.PLAN_REQUEST)
    world.send(t.MOTION_LIMITS, forward=1.0, left=float(error > 0), right=float(error < 0))
    world.run(4.0)
    assert world.count(t.PLAN_REQUEST) == requests, "the other way round nothing is held"
    world.send(t.MOTION_LIMITS, forward=1.0, left=float(error < 0), right=float(error > 0))
    world.run(0.2)
    assert world.count(t.PLAN_REQUEST) == requests + 1


@pytest.mark.parametrize("error", [0.5, -0.5])
def test_the_planner_is_told_of_a_turn_that_the_guard_held_there(world: World, error: float) -> None:
    # The guard sees more than the map: the planner sent a robot into the same turn again and again.
    world.goal()
    request = world.last(t.PLAN_REQUEST)
    assert not request.held_left
    assert not request.held_right
    world.answer()
    place, world.tracker_phase, world.heading_error = world.pose, "aligning", error
    world.send(t.MOTION_LIMITS, forward=1.0, backward=1.0, left=float(error < 0), right=float(error > 0))
    world.run(2.7)
    request = world.last(t.PLAN_REQUEST)
    assert (request.held_left, request.held_right) == (error > 0, error < 0)
    world.answer(reaches=False)
    world.tracker_phase, world.left = "following", 0.3
    for pose, told in (
        ((place[0] + 0.3, *place[1:]), True),
        ((place[0] + 0.6, *place[1:]), False),
        ((*place[:2], place[2] + 1.0), False),
        (place, True),
    ):
        world.pose = pose
        world.run(0.7)
        request = world.last(t.PLAN_REQUEST)
        assert (request.start_x, request.start_yaw) == pytest.approx((pose[0], pose[2]))
        assert (request.held_left or request.held_right) is told
        world.answer(reaches=False)
    world.goal(goal_id="another")
    request = world.last(t.PLAN_REQUEST)
    assert not request.held_left
    assert not request.held_right


@pytest.mark.parametrize(
    ("vx", "hold", "forward", "backward", "asks"),
    [
        (0.0, "", 0.0, 1.0, True),
        (0.0, "", 1.0, 0.0, True),
        (0.01, "", 0.01, 1.0, True),
        (-0.01, "", 1.0, 0.01, True),
        (0.01, "", 1.0, 0.0, False),  # it sets off; what lies behind it is in nobody's way
        (0.0, "the map is old", 0.0, 0.0, False),
    ],
)
def test_a_robot_that_the_guard_holds_on_its_path_asks_anew_before_it_counts_as_stuck(
    world: World, vx: float, hold: str, forward: float, backward: float, asks: bool
) -> None:
    # Before an edge that no plan knew it stood for 8 s, and then kept off the bridge behind the edge.
    world.goal()
    world.answer()
    requests = world.count(t.PLAN_REQUEST)
    world.run(3.0)
    assert world.count(t.PLAN_REQUEST) == requests, "nothing holds it"
    world.vx, world.tracker_hold = vx, hold
    world.send(t.MOTION_LIMITS, left=1.0, right=1.0, forward=forward, backward=backward)
    world.run(0.2)
    assert world.count(t.PLAN_REQUEST) == requests + asks
    assert world.status.state == "moving"
    assert not len(world.last(t.PLAN_REQUEST).avoid)


def test_a_turn_that_is_held_backs_out_where_the_guard_lets_nothing_ahead(world: World) -> None:
    world.hold_a_turn()
    assert world.last(t.PATH_COMMAND).x[-1] == pytest.approx(0.35)


def test_a_robot_that_came_from_nowhere_does_not_move_out(world: World) -> None:
    world.goal()
    world.answer()
    world.tracker_phase = "aligning"
    requests = world.count(t.PLAN_REQUEST)
    world.run(5.5)
    assert world.count(t.PLAN_REQUEST) == requests + 1
    assert len(world.last(t.PATH_COMMAND).x) == 11


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_recovery_that_leaves_the_ground_it_covered_stands_and_asks_anew(world: World, side: float) -> None:
    world.hold_a_turn()
    assert world.status.detail == "backing out"
    world.tracker_phase = "following"
    requests = world.count(t.PLAN_REQUEST)
    world.cross_track = 0.08 * side
    world.run(0.3)
    assert world.status.state == "recovering"
    assert world.count(t.PLAN_REQUEST) == requests
    world.cross_track = 0.12 * side
    world.run(0.2)
    assert len(world.last(t.PATH_COMMAND).x) == 0
    assert world.count(t.PLAN_REQUEST) == requests + 1
    world.run(0.6)
    assert (world.status.state, world.status.detail) == ("planning", "0.12 m beside its way")


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_robot_that_slid_off_its_path_stands_and_asks_anew(world: World, side: float) -> None:
    world.goal()
    world.answer()
    requests = world.count(t.PLAN_REQUEST)
    for beside in (0.14, 0.14, 0.3, 0.25, 0.2, 0.16, 0.2, 0.14):  # it comes back to its path
        world.cross_track = beside * side
        world.run(0.4)
    assert world.count(t.PLAN_REQUEST) == requests
    for beside in (0.16, 0.17, 0.17, 0.18):
        world.cross_track = beside * side
        world.run(0.3)
    assert world.count(t.PLAN_REQUEST) == requests + 1
    assert len(world.last(t.PATH_COMMAND).x) == 0
    world.run(0.6)
    assert world.status.detail == "0.18 m beside its way"
    world.answer()
    world.cross_track = 0.0
    world.run(0.5)
    assert world.status.state == "moving"


def test_astride_a_face_a_robot_beside_its_path_goes_on(world: World) -> None:
    free = {"forward": 1.0, "backward": 1.0, "left": 1.0, "right": 1.0}
    world.goal()
    world.answer()
    requests = world.count(t.PLAN_REQUEST)
    world.cross_track = 0.19
    world.send(t.MOTION_LIMITS, **free, uneven_ahead=0.1, uneven_behind=0.2)
    world.run(1.5)
    assert world.count(t.PLAN_REQUEST) == requests
    assert len(world.last(t.PATH_COMMAND).x) == 11
    world.send(t.MOTION_LIMITS, **free, uneven_ahead=0.1, uneven_behind=0.01)
    world.run(0.2)
    assert world.count(t.PLAN_REQUEST) == requests + 1, "what lies ahead is not under it"


def test_a_robot_is_not_moved_out_where_the_guard_holds_it(world: World) -> None:
    """It stood across a lane, was backed out to the wall behind it, and then told to back out further."""
    world.come_along()
    world.goal()
    world.answer()
    world.tracker_phase = "aligning"
    world.send(t.MOTION_LIMITS, forward=0.0, backward=0.01, left=1.0, right=1.0)
    requests = world.count(t.PLAN_REQUEST)
    world.run(5.5)
    assert world.status.recoveries == 1
    assert world.count(t.PLAN_REQUEST) == requests + 1, "it asks anew instead"
    world.send(t.MOTION_LIMITS, forward=0.0, backward=1.0, left=1.0, right=1.0)
    world.answer()
    world.run(5.5)
    assert world.status.detail == "backing out"


@pytest.mark.parametrize(
    ("pose", "reach"),
    [
        ((1.0, 0.0, 0.0), -0.6),
        ((1.0, 0.0, math.pi), 0.6),
        ((1.0, 0.0, 0.1), -0.15),
        ((1.0, 0.0, math.pi - 0.1), 0.15),
        ((1.0, 0.0, 0.5), 0.0),  # turned across the way the body would cover ground that it did not
        ((1.0, 0.0, math.pi / 2), 0.0),
        ((0.5, 2.0, 0.0), 0.0),
    ],
)
def test_the_trail_tells_how_far_the_ground_was_stood_on(pose: Pose2, reach: float) -> None:
    trail = Trail(0.70, 0.43)
    assert trail.reach(pose, 0.6) == 0.0
    for i in range(101):
        trail.add((0.01 * i, 0.0, 0.0))
    assert trail.reach(pose, 0.6) == pytest.approx(reach, abs=1e-6)


@settings(max_examples=40, deadline=None, derandomize=True)
@example(["goal", "lost", "answer"])
@given(
    st.lists(
        st.sampled_from(
            ["goal", "cancel", "answer", "fail", "run", "done", "lost", "good", "estop", "resume"]
        ),
        max_size=25,
    )
)
def test_whatever_happens_a_halted_goal_never_leaves_a_path(events: list[str]) -> None:
    world = World()
    world.run(0.3)
    for number, event in enumerate(events):
        match event:
            case "goal":
                world.goal(goal_id=f"g{number}")
            case "cancel":
                world.send(t.GOAL_REQUEST, action=1)
            case "answer" | "fail" if world.last(t.PLAN_REQUEST) is not None:
                world.answer(ok=event == "answer", reason="" if event == "answer" else "no_route")
            case "done":
                world.tracker_phase = "done"
                world.run(0.2)
                world.tracker_phase = "following"
            case "lost" | "good":
                world.health = event
            case "estop" | "resume":
                world.estop = event == "estop"
        world.run(0.2)
        path = world.last(t.PATH_COMMAND)
        if path is not None and len(path.x):
            assert GoalState(world.status.state).active
            assert world.health == "good"
            assert not world.estop


@pytest.fixture
def looker() -> World:
    """The same robot with a trunk that tilts."""
    made = World(tilt=0.3)
    made.run(0.5)
    made.tracker_phase = "idle"
    made.goal()
    return made


def look_over(world: World) -> None:
    world.tracker_phase = "looking"
    world.run(1.5)
    assert (world.status.state, world.status.detail) == ("planning", "looking at the ground ahead")
    world.tracker_phase = "done"
    world.run(0.2)


def no_way(world: World) -> None:
    """No route from here, and none again."""
    world.answer(ok=False, reason="no_route")
    assert world.last(t.PATH_COMMAND).look == 0.0
    world.run(1.2)
    world.answer(ok=False, reason="no_route")


def test_it_looks_once_at_each_place_from_which_no_way_leads_on(looker: World) -> None:
    no_way(looker)
    order, asked = looker.last(t.PATH_COMMAND), looker.count(t.PLAN_REQUEST)
    assert len(order.x) == 0
    assert order.look == pytest.approx(NavigatorConfig().look_pitch)
    look_over(looker)
    assert looker.count(t.PLAN_REQUEST) == asked + 1
    for pose, looks in (((0.1, 0.0, 0.0), False), ((0.1, 0.0, 1.0), True), ((1.0, 0.0, 1.0), True)):
        looker.answer()
        looker.pose = pose
        looker.route_valid = False
        looker.run(0.2)
        looker.route_valid = True
        no_way(looker)
        assert (looker.last(t.PATH_COMMAND).look > 0.0) == looks, "not twice in one place"
        looker.run(1.2)
        if looks:
            look_over(looker)


def test_a_robot_with_a_way_does_not_look(looker: World) -> None:
    looker.answer(reaches=False)
    assert looker.status.state == "moving"
    assert all(m.look == 0.0 for topic, m in looker.out if topic is t.PATH_COMMAND)


def test_a_look_that_never_ends_is_given_up(looker: World) -> None:
    no_way(looker)
    asked = looker.count(t.PLAN_REQUEST)
    looker.tracker_phase = "looking"
    looker.run(2.4)
    assert looker.count(t.PLAN_REQUEST) == asked
    looker.run(0.5)
    assert looker.count(t.PLAN_REQUEST) == asked + 1


def test_a_robot_whose_trunk_does_not_tilt_does_not_look(world: World) -> None:
    world.tracker_phase = "idle"
    world.goal()
    no_way(world)
    assert world.last(t.PATH_COMMAND).look == 0.0


EDGE = "cliff: an edge ahead, deeper than the wheels can feel"


@pytest.fixture
def creeper() -> World:
    """A robot whose wheels feel edges, after it came along x."""
    made = World(tilt=0.3, creep=0.1)
    made.come_along()
    made.goal()
    return made


def refuse(world: World) -> None:
    """No route, until it has tried what it tries first."""
    for _ in range(4):
        assert not world.last(t.PLAN_REQUEST).creep
        world.answer(ok=False, reason="no_route")
        world.tracker_phase = "done"
        world.run(1.5)
    assert any(m.look > 0.0 for topic, m in world.out if topic is t.PATH_COMMAND), "it looked first"
    world.answer(ok=False, reason="no_route")
    world.tracker_phase = "following"


def test_who_feels_edges_creeps_where_looking_did_not_help_and_before_it_backs_out(creeper: World) -> None:
    refuse(creeper)
    assert creeper.last(t.PLAN_REQUEST).creep
    assert creeper.status.state == "planning"
    creeper.answer(reaches=False, creep=True)
    assert (creeper.status.state, creeper.status.detail) == ("moving", "creeping over ground nobody saw")
    assert creeper.last(t.PATH_COMMAND).creep == 0.1
    asked = creeper.count(t.PLAN_REQUEST)
    creeper.left = 0.2
    creeper.run(1.5)
    assert creeper.count(t.PLAN_REQUEST) == asked, "so slowly it does not come far"
    creeper.run(1.0)
    assert creeper.count(t.PLAN_REQUEST) == asked + 1
    assert creeper.last(t.PLAN_REQUEST).creep
    creeper.answer()
    assert (creeper.status.detail, creeper.last(t.PATH_COMMAND).creep) == ("", 0.0)
    creeper.goal(goal_id="another")
    assert not creeper.last(t.PLAN_REQUEST).creep


def test_who_does_not_feel_edges_does_not_creep(world: World) -> None:
    world.goal()
    for _ in range(4):
        world.answer(ok=False, reason="no_route")
        world.run(1.5)
    assert world.status.state == "aborted"
    assert not any(m.creep for topic, m in world.out if topic is t.PLAN_REQUEST)


def back_off(world: World) -> None:
    """The wheels feel an edge; it backs out and asks again."""
    world.cause = EDGE
    world.run(0.2)
    assert (world.status.state, world.status.detail) == ("recovering", "backing out")
    back = world.last(t.PATH_COMMAND)
    assert (back.x[0] - back.x[-1] > 0.3, back.creep) == (True, 0.0)
    world.cause, world.tracker_phase = "driving", "done"
    world.run(0.5)
    world.tracker_phase = "following"


def test_an_edge_that_the_wheels_felt_is_kept_off_for_good_and_told(creeper: World) -> None:
    refuse(creeper)
    creeper.answer(reaches=False, creep=True)
    back_off(creeper)
    ways = []
    while creeper.status.state != "aborted":
        request = creeper.last(t.PLAN_REQUEST)
        assert request.avoid == pytest.approx([0.95 + 0.5, 0.0, 0.3])
        assert not request.creep, "where one edge is, others may be"
        creeper.answer(ok=False, reason="no_route")
        creeper.tracker_phase = "done"
        creeper.run(1.5)
        path = creeper.last(t.PATH_COMMAND)
        ways += [path.x[-1] - path.x[0]] if len(path.x) else []
    assert creeper.status.reason == "no_route"
    assert creeper.status.detail.startswith("the wheels felt an edge that goes down at x 0.95 y 0.00; ")
    assert all(way < 0.0 for way in ways), (
        "the body covered what lies below the edge, too: no way out leads there"
    )
    creeper.goal(goal_id="another")
    assert len(creeper.last(t.PLAN_REQUEST).avoid) == 0


def test_after_an_edge_others_count_too_until_there_are_too_many(creeper: World) -> None:
    refuse(creeper)
    for _ in range(3):
        creeper.answer(reaches=False, creep=creeper.last(t.PLAN_REQUEST).creep)
        back_off(creeper)
    creeper.answer(reaches=False)
    creeper.cause = EDGE
    creeper.run(0.2)
    assert (creeper.status.state, creeper.status.reason) == ("aborted", "no_route")
    assert creeper.status.detail.count("at x 0.95 y 0.00") == 4


def test_an_edge_that_is_felt_while_it_does_not_creep_is_nothing_to_the_goal(creeper: World) -> None:
    creeper.answer()
    creeper.cause = EDGE
    creeper.run(0.5)
    assert (creeper.status.state, creeper.status.detail) == ("moving", "")


def touch(world: World, y: float = 0.0, way: float = 1.0) -> None:
    """The robot at x 0.95 meets something ahead, or behind."""
    q = rpy_quaternion((0.0, 0.0, world.pose[2] + (0.0 if way > 0.0 else math.pi)))
    place = msg.Point(world.pose[0] + 0.35 * way, y, 0.4)
    world.send(t.TOUCHED, pose=msg.Pose(place, quaternion(q)))


def test_what_was_touched_is_backed_out_from_and_gone_round(world: World) -> None:
    world.come_along()
    world.goal()
    world.answer()
    touch(world)
    path = world.last(t.PATH_COMMAND)
    assert path.x[0] - path.x[-1] > 0.3
    assert world.status.state == "recovering"
    world.run(0.1)
    world.tracker_phase = "done"
    asked = world.count(t.PLAN_REQUEST)
    world.run(0.3)
    assert world.count(t.PLAN_REQUEST) > asked
    assert not len(world.last(t.PLAN_REQUEST).avoid), "the map has it"


def test_what_was_touched_while_it_backs_out_stops_that(world: World) -> None:
    world.come_along()
    world.goal()
    world.answer()
    touch(world)
    touch(world, way=-1.0)
    path = world.last(t.PATH_COMMAND)
    assert not len(path.x) or path.x[-1] > path.x[0]


def test_after_many_touches_the_goal_ends_and_says_where(world: World) -> None:
    world.come_along()
    world.goal()
    for k in range(NavigatorConfig().max_touches):
        world.answer()
        touch(world, y=0.5 * k)
        assert world.status.state != "aborted"
        world.tracker_phase = "done"
        world.run(0.3)
        world.tracker_phase = "following"
    touch(world, y=-1.0)
    assert (world.status.state, world.status.reason) == ("aborted", "no_route")
    assert world.status.detail.startswith(
        "touched something that the LiDAR does not see at (1.3, 0.0) and (1.3, 0.5)"
    )


def test_a_touch_without_a_goal_is_nothing_to_it(world: World) -> None:
    touch(world)
    assert world.last(t.PATH_COMMAND) is None


def test_the_chance_of_the_way_is_told_and_one_that_is_too_risky_is_refused(world: World) -> None:
    world.goal(accept_risk=True)
    assert world.last(t.PLAN_REQUEST).accept_risk, "the planner hears that it was accepted"
    assert math.isnan(world.status.p_fail), "nothing is known before the first plan"
    world.answer(p_fail=0.3, worst="up a 0.16 m face at x 2.0 y 0.0")
    assert (world.status.state, world.status.p_fail) == ("moving", 0.3)
    assert world.status.worst == "up a 0.16 m face at x 2.0 y 0.0"
    world.goal(goal_id="h")
    assert not world.last(t.PLAN_REQUEST).accept_risk
    world.answer(ok=False, reason="too_risky", p_fail=0.3)
    assert (world.status.id, world.status.state, world.status.reason) == ("h", "rejected", "too_risky")


def test_a_way_that_becomes_too_risky_is_looked_at_again_before_the_goal_ends(world: World) -> None:
    world.goal()
    world.answer()
    world.send(
        t.ROUTE_STATUS,
        goal_id="g",
        sequence=world.last(t.PLAN_REQUEST).sequence,
        valid=False,
        detail="a step",
    )
    world.route_valid = False
    world.run(1.0)
    world.answer(ok=False, reason="too_risky", p_fail=0.3)
    assert world.status.state == "planning", "the noise of one scan ends no goal"
    for _ in range(20):
        if world.status.state == "aborted":
            break
        world.run(2.0)
        world.answer(ok=False, reason="too_risky", p_fail=0.3)
    assert (world.status.state, world.status.reason) == ("aborted", "too_risky")


def test_a_chance_that_changed_is_told_with_its_worst_place_of_before_and_of_now(world: World) -> None:
    events = Events(lambda _text: None)
    world.goal()
    for p_fail, worst, said in (
        (0.02, "a ramp", ""),
        (0.05, "a kerb", ""),
        (0.2, "stairs", "the chance to arrive was 98 % (worst: a ramp), it is 80 % (worst: stairs)"),
        (0.21, "stairs", "the chance to arrive was 98 % (worst: a ramp), it is 79 % (worst: stairs)"),
    ):
        world.route_valid = False
        world.run(0.3)
        world.route_valid = True
        world.answer(p_fail=p_fail, worst=worst)
        assert world.status.chance_change == said
        events.take(t.GOAL_STATUS, world.status)
    assert [event.text for event in events.due() if event.kind == "chance"] == [
        "the chance to arrive was 98 % (worst: a ramp), it is 80 % (worst: stairs)"
    ]
