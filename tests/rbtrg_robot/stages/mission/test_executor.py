"""The mission's lifecycle, message by message, with a navigator and a robot that do as the test says."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hal.types import NS
from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.config import load
from rbtrg_robot.provenance import fingerprint
from rbtrg_robot.stage_config import CommsConfig
from rbtrg_robot.stages.mission.executor import MissionStage, build
from rbtrg_robot.stages.mission.order import EVERYWHERE, Kind
from rbtrg_robot.topics import Topic
from rbtrg_robot.wire.convert import odometry_msg, rpy_quaternion
from rbtrg_robot.wire.messages import array, decode, encode, header
from tests.rbtrg_robot.hearsay import map_offset

ALL = EVERYWHERE | {Kind.RECORD, Kind.PHOTO}


def goto(x: float, **fields: Any) -> msg.MissionStep:
    return step("goto", x=x, **fields)


def step(kind: str, **fields: Any) -> msg.MissionStep:
    fields = {"id": "", "blocking_type": "HARD", "on_failure": "stop"} | fields
    return msg.MissionStep(kind=kind, **fields)


def order(*steps: msg.MissionStep, loops: Any = (), **fields: Any) -> msg.MissionOrder:
    for number, each in enumerate(steps, 1):
        each.id = each.id or f"s{number}"
    fields = {
        "order_id": "o1",
        "name": "round",
        "frame": "map",
        "on_comms_loss": "continue",
        "comms_timeout": 5.0,
        "start": 1,
    } | fields
    return msg.MissionOrder(steps=list(steps), loops=list(loops), **fields)


class World:
    """Navigator, robot and operator."""

    def __init__(
        self, possible: frozenset[Kind] = ALL, prior_map: str = "", comms: CommsConfig = CommsConfig()
    ) -> None:
        self.possible, self.prior_map, self.comms = possible, prior_map, comms
        self.stage = MissionStage(possible, prior_map, 0.1, comms)
        self.now = 10**12
        self.goal = msg.GoalStatus(state="idle")
        self.navigating = True
        self.drives = 1.0
        """Seconds from a goal to its end; the end is `ends`."""
        self.ends: tuple[str, str] = ("reached", "")
        self.set_at = 0
        self.goals: list[float] = []
        """x of every goal the navigator took."""
        self.robot = msg.RobotState(phase="ready", battery=1.0)
        self.obeys = True
        self.postures: list[str] = []
        self.kept: dict[Topic, bytes] = {}
        self.requests = 0
        self.stage.on(t.TF_STATIC, map_offset())
        self.stand(7.0, 1.0)

    def stand(self, x: float, y: float) -> None:
        self.stage.on(t.ODOM, odometry_msg(0, (x, y, 0.0), rpy_quaternion((0, 0, 0)), (0,) * 3, (0,) * 3))

    def drive(self, *corners: tuple[float, float]) -> None:
        for (x0, y0), (x1, y1) in pairwise(corners):
            steps = round(math.dist((x0, y0), (x1, y1)) / 0.1)
            for k in range(steps + 1):
                self.stand(x0 + k / steps * (x1 - x0), y0 + k / steps * (y1 - y0))

    def sent(self, x: float, **fields: Any) -> None:
        """Somebody's goal is under way."""
        self.goal = msg.GoalStatus(id=f"theirs {x}", state="moving", owner="bob", x=x, **fields)
        self.set_at, self.drives = self.now, 1000.0

    def present(self) -> None:
        self.take(self.stage.on(t.PRESENCE, msg.Presence(owner="anna")))

    def take(self, outputs: list[tuple[Topic, Any]]) -> None:
        for topic, message in outputs:
            payload = encode(message)  # every output must survive the wire
            message = decode(payload, topic.kind)
            self.kept[topic] = payload
            if topic is t.GOAL_REQUEST and self.navigating:
                self._navigate(message)
            elif topic is t.ROBOT_COMMAND:
                self.postures.append(message.mode)
                if self.obeys:
                    self.robot.phase = {"sit": "sitting", "stand": "ready"}[message.mode]

    def _navigate(self, request: Any) -> None:
        active = self.goal.state in ("moving", "paused")
        if request.action == 1:
            if active and request.id == self.goal.id:
                self.goal.state, self.goal.reason = "cancelled", "cancelled"
        elif request.id != self.goal.id:
            self.goals.append(request.x)
            self.goal = msg.GoalStatus(id=request.id, state="moving", owner=request.owner)
            self.set_at = self.now

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds * 10)):
            self.now += NS // 10
            self.take(self.stage.tick(self.now))
            if self.goal.state == "moving" and self.now - self.set_at >= self.drives * NS:
                self.goal.state, self.goal.reason = self.ends
            if self.navigating:
                self.goal.header = header(self.now, "map")
                self.take(self.stage.on(t.GOAL_STATUS, decode(encode(self.goal), msg.GoalStatus)))
            self.robot.header = header(self.now, "base_link")
            self.take(self.stage.on(t.ROBOT_STATE, decode(encode(self.robot), msg.RobotState)))

    def until(self, phase: str, limit: float = 60.0) -> None:
        for _ in range(round(limit * 10)):
            if self.state.phase == phase:
                return
            self.run(0.1)
        raise AssertionError(f"not {phase} but {self.state.phase}: {self.state.reason}")

    def ask(self, action: str, **fields: Any) -> str:
        """Send a request twice; why it was refused, or empty."""
        self.requests += 1
        fields = {"id": f"r{self.requests}", "action": action, "owner": "anna"} | fields
        for _ in range(2):
            request = decode(encode(msg.MissionRequest(**fields)), msg.MissionRequest)
            self.take(self.stage.on(t.MISSION_REQUEST, request))
        assert self.state.request == fields["id"]
        return str(self.state.refused)

    def start(self, *steps: msg.MissionStep, **fields: Any) -> None:
        assert self.ask("run", order=order(*steps, **fields)) == ""

    def restart(self) -> None:
        """The process dies and comes back with what the supervisor kept; the latched topics tell it the rest."""
        self.stage = MissionStage(self.possible, self.prior_map, 0.1, self.comms)
        self.stage.on(t.TF_STATIC, map_offset())
        for topic in (t.MISSION_ORDER, t.MISSION_STATE):
            if topic in self.kept:
                self.take(self.stage.on(topic, decode(self.kept[topic], topic.kind)))
        self.take(self.stage.on(t.GOAL_STATUS, decode(encode(self.goal), msg.GoalStatus)))

    @property
    def state(self) -> Any:
        return decode(self.kept[t.MISSION_STATE], msg.MissionState)


@pytest.fixture
def world() -> World:
    made = World()
    made.run(0.3)
    return made


def test_the_steps_are_done_in_their_order(world: World) -> None:
    assert world.state.phase == "idle"
    world.start(goto(1.0), step("sit"), step("wait", duration=2.0), step("stand"), goto(2.0))
    world.run(0.3)
    assert world.state.action_status == ["RUNNING", "WAITING", "WAITING", "WAITING", "WAITING"]
    began = world.now
    world.until("finished")
    assert world.goals == [1.0, 2.0]
    assert list(dict.fromkeys(world.postures)) == ["sit", "stand"]
    assert (world.now - began) / NS > 1.0 + 1.0 + 2.0 + 1.0 + 1.0
    assert set(world.state.action_status) == {"FINISHED"}
    assert world.robot.phase == "ready"


def test_a_photo_is_asked_for_until_one_of_now_comes(world: World) -> None:
    def shoot(stamp: int) -> None:
        world.take(world.stage.on(t.PHOTO, msg.CompressedImage(header=header(stamp, "camera_front"))))

    shoot(world.now)
    world.start(step("photo", on_failure="skip"), step("photo"))
    world.run(1.0)
    assert decode(world.kept.pop(t.PHOTO_REQUEST), msg.String).data == "s1"
    shoot(world.now - 2 * NS)  # exposed before the step began
    world.run(2.0)
    assert t.PHOTO_REQUEST in world.kept
    assert world.state.action_status == ["RUNNING", "WAITING"]
    world.run(30.0)
    assert world.state.action_status == ["FAILED", "RUNNING"]
    assert "no photo within 30 s" in world.state.result_description[0]
    shoot(world.now)
    world.until("finished")


def test_loops_begin_again_and_a_mission_may_begin_in_its_middle(world: World) -> None:
    world.start(goto(1.0), goto(2.0), goto(3.0), loops=[msg.MissionLoop(2, 3, 2)], start=2)
    world.until("finished")
    assert world.goals == [2.0, 3.0, 2.0, 3.0]
    assert world.state.action_status == ["WAITING", "FINISHED", "FINISHED"]


@pytest.mark.parametrize(
    ("policy", "goals", "phase", "step_now"),
    [
        ({"on_failure": "stop"}, [1.0], "failed", 1),
        ({"on_failure": "retry", "retries": 2}, [1.0] * 3, "failed", 1),
        ({"on_failure": "skip"}, [1.0, 2.0], "finished", 2),
        ({"on_failure": "return"}, [1.0, 0.0], "failed", 1),
    ],
)
def test_a_failed_step_is_treated_as_the_mission_says(
    world: World, policy: dict[str, Any], goals: list[float], phase: str, step_now: int
) -> None:
    world.ends = ("aborted", "no_route")
    world.start(goto(1.0, **policy), goto(2.0))
    while world.goals != goals:
        world.run(0.1)
    world.ends = ("reached", "") if policy["on_failure"] in ("skip", "return") else world.ends
    world.until(phase)
    assert world.goals == goals
    assert world.state.step == step_now
    assert world.state.action_status[0] == "FAILED"
    assert "no route" in world.state.result_description[0]
    if phase == "failed":
        assert world.state.reason.startswith("step 1 (goto): no route to the goal")
    assert world.state.reason.endswith("; the robot is back") == (policy["on_failure"] == "return")


@pytest.mark.parametrize("word", ["", "soon", "MOVING"])
def test_a_goal_status_that_says_what_no_navigator_says_is_no_answer(world: World, word: str) -> None:
    world.ends = (word, "")
    world.start(goto(1.0), goto(2.0))
    world.until("paused")
    assert world.goals == [1.0]
    assert "the navigator does not answer" in world.state.reason


def test_a_way_home_that_fails_too_ends_where_it_is(world: World) -> None:
    world.ends = ("aborted", "stuck")
    world.start(goto(1.0, on_failure="return"), has_home=True, home_x=-3.0)
    world.until("failed")
    assert world.goals == [1.0, *[-3.0] * 4], "it is tried three times more"
    assert "did not get back: the robot is stuck" in world.state.reason


@pytest.mark.parametrize("cause", ["estop", "taken", "goal", "cancelled"])
def test_whoever_takes_the_robot_keeps_it_until_the_mission_is_told_to_go_on(
    world: World, cause: str
) -> None:
    world.start(goto(1.0), goto(2.0))
    world.run(0.5)
    if cause == "estop":
        world.robot.estop, world.robot.estop_cause = True, "operator"
        world.goal.state, world.goal.reason = "aborted", "emergency_stop"
    elif cause == "taken":
        world.robot.taken = "teleop has the motion"
        world.goal.state = "paused"
    elif cause == "goal":
        world.goal = msg.GoalStatus(id="theirs", state="moving", owner="bob")
        world.set_at, world.drives = world.now, 5.0
    else:
        world.goal.state, world.goal.reason = "cancelled", "cancelled"
    world.run(0.3)
    assert world.state.phase == "paused"
    assert world.state.reason
    assert world.state.action_status == ["PAUSED", "WAITING"]
    if cause == "taken":
        assert world.goal.state == "cancelled"
    if cause != "cancelled":
        assert world.ask("resume") != ""
        world.run(10.0 if cause == "goal" else 1.0)
        assert world.state.phase == "paused"
    world.robot.estop, world.robot.taken = False, ""
    world.goal.state = "reached" if cause == "goal" else "cancelled"
    world.run(20.0)
    assert world.state.phase == "paused"
    assert world.goals == [1.0]
    assert world.ask("resume") == ""
    world.drives = 1.0
    world.until("finished")
    assert world.goals == [1.0, 1.0, 2.0]


@pytest.mark.parametrize("cause", ["estop", "taken"])
def test_a_step_without_a_goal_is_paused_as_soon_as_somebody_takes_the_robot(
    world: World, cause: str
) -> None:
    world.start(step("wait", duration=1.0), step("sit"))
    world.run(0.3)
    setattr(world.robot, cause, True if cause == "estop" else "teleop has the motion")
    world.run(5.0)
    assert (world.state.phase, world.state.step) == ("paused", 1)
    world.robot.estop, world.robot.taken = False, ""
    world.run(5.0)
    assert (world.state.phase, world.postures) == ("paused", [])
    assert world.ask("resume") == ""
    world.until("finished")


def test_an_operator_pauses_skips_answers_and_stops(world: World) -> None:
    question = step("ask", text="open?", choices=["yes", "no"], on_failure="skip")
    world.start(goto(1.0), question, goto(2.0), goto(3.0))
    world.run(0.5)
    assert world.ask("pause") == ""
    world.run(0.5)
    assert world.goal.state == "cancelled"
    assert world.state.reason == "paused by anna"
    assert world.ask("skip", step=2) != ""
    assert world.ask("skip", step=1) == ""
    world.run(1.0)
    assert (world.state.phase, world.state.step) == ("paused", 2)
    assert world.ask("answer", answer="yes") == "the mission asks nothing now"
    assert world.ask("resume") == ""
    world.run(3.0)
    assert (world.state.question, world.state.choices) == ("open?", ["yes", "no"])
    assert "none of yes, no" in world.ask("answer", answer="perhaps")
    assert world.ask("answer", answer="no", step=2) == ""
    world.run(0.3)
    assert world.state.question == ""
    assert world.state.result_description[1] == "answered 'no'"
    assert world.goals == [1.0, 2.0]
    assert world.ask("stop", order_id="o0") == "that mission is over"
    assert world.ask("stop") == ""
    world.run(0.5)
    assert world.goal.state == "cancelled"
    assert (world.state.phase, world.state.reason) == ("stopped", "stopped by anna")
    assert world.ask("resume") == "no mission is under way"


def test_a_question_nobody_answers_fails(world: World) -> None:
    world.start(step("ask", text="?", choices=["yes"], timeout=3.0))
    world.until("failed", 5.0)
    assert "no answer within 3 s" in world.state.reason


def test_a_posture_the_robot_refuses_fails(world: World) -> None:
    world.obeys = False
    world.robot.cause = "sit refused: robot is fault"
    world.start(step("sit"))
    world.until("failed", 5.0)
    assert "sit refused" in world.state.reason
    world.robot.cause = ""
    world.start(step("sit"), order_id="o2")
    world.until("failed", 40.0)
    assert "no `sit` within 30 s: the robot is ready" in world.state.reason


def test_a_silent_navigator_is_no_endless_wait(world: World) -> None:
    world.navigating = False
    world.start(goto(1.0))
    world.until("paused", 15.0)
    assert "does not answer" in world.state.reason


@pytest.mark.parametrize("policy", ["continue", "hold", "return"])
def test_without_an_operator_in_contact(world: World, policy: str) -> None:
    world.drives = 100.0
    world.start(goto(1.0), goto(2.0), on_comms_loss=policy, comms_timeout=2.0)
    for _ in range(5):
        world.run(1.0)
        world.take(world.stage.on(t.PRESENCE, msg.Presence(owner="anna")))
    assert (world.state.phase, world.goals) == ("running", [1.0])
    world.run(2.5)
    if policy == "continue":
        assert (world.state.phase, world.goal.state) == ("running", "moving")
    elif policy == "hold":
        assert (world.state.phase, world.goal.state) == ("holding", "cancelled")
        assert "no operator in contact for 2 s" in world.state.reason
        world.take(world.stage.on(t.PRESENCE, msg.Presence(owner="anna")))
        world.run(0.5)
        assert (world.state.phase, world.goals) == ("running", [1.0, 1.0])
    else:
        assert world.state.returning
        assert world.goals == [1.0, 0.0]
        world.drives = 0.0
        world.until("failed")
        assert world.state.reason == "no operator in contact for 2 s; the robot is back"


@pytest.mark.parametrize("policy", ["continue", "hold", "return"])
def test_a_goal_of_somebody_without_an_operator_in_contact(policy: Any) -> None:
    world = World(comms=CommsConfig(timeout=3.0, on_loss=policy))
    world.drive((0.0, 0.0), (9.0, 0.0), (9.0, 6.0))
    world.sent(20.0)
    world.run(2.0)
    world.present()
    world.run(2.5)
    assert (world.goal.id, world.goal.state) == ("theirs 20.0", "moving")
    world.run(2.0)
    if policy == "continue":
        assert (world.goal.id, world.goal.state) == ("theirs 20.0", "moving")
        return
    assert "no operator in contact for 3 s" in world.state.reason + world.state.failure
    if policy == "hold":
        assert (world.state.phase, world.state.name, world.goal.state) == (
            "holding",
            "goal of bob",
            "cancelled",
        )
        world.present()
        world.run(0.5)
        assert (world.state.phase, world.goals) == ("running", [20.0])  # it goes on by itself
        return
    assert world.state.returning
    world.drives = 1.0
    world.run(2.0)
    assert world.goals[:2] == [pytest.approx(9.0, abs=0.4), pytest.approx(7.0, abs=0.5)], "along the trail"
    world.present()
    world.run(0.5)
    assert (world.state.phase, world.goal.state) == ("paused", "cancelled")
    assert "it came back until one was" in world.state.reason
    assert world.ask("resume") == ""
    world.run(0.5)
    assert world.goals[-1] == 20.0


def test_without_contact_the_robot_comes_all_the_way_home() -> None:
    world = World(comms=CommsConfig(timeout=3.0, on_loss="return"))
    world.drive((0.0, 0.0), (9.0, 0.0))
    world.sent(20.0)
    world.run(4.0)
    world.drives = 0.5
    world.until("failed")
    assert world.goals[-1] == 0.0
    assert sorted(world.goals, reverse=True) == world.goals
    assert "the robot is back" in world.state.reason
    world.run(10.0)
    assert world.goal.state == "reached"


@pytest.mark.parametrize("what", ["home", "explore"])
def test_a_robot_that_holds_for_an_operator_comes_home_before_the_battery_is_too_low(what: str) -> None:
    world = World(comms=CommsConfig(timeout=3.0, on_loss="hold"))
    world.drive((0.0, 0.0), (40.0, 0.0))
    world.robot.battery = 0.14
    world.run(0.3)
    world.start(step(what), on_comms_loss="", comms_timeout=0.0)  # as the stack says
    world.drives = 1000.0
    world.run(5.0)
    assert (world.state.phase, world.goal.state) == ("holding", "cancelled" if what == "home" else "idle")
    world.robot.battery = 0.12
    world.run(0.3)
    world.stand(40.0, 0.0)
    world.run(1.0)
    assert world.state.returning
    assert (world.goals[-1], world.goal.state) == (0.0, "moving")


def test_a_goal_that_leads_home_is_left_alone() -> None:
    world = World()
    world.drive((0.0, 0.0), (40.0, 0.0))
    world.robot.battery = 0.12
    world.sent(0.0)
    world.run(0.5)
    world.stand(40.0, 0.0)
    world.run(5.0)
    assert world.goal.id == "theirs 0.0"


@pytest.mark.parametrize("what", ["goal", "mission", "stands", "no return", "by hand", "stopped"])
def test_a_battery_that_the_way_home_needs_brings_the_robot_home(what: str) -> None:
    world = World()
    world.drive((0.0, 0.0), (40.0, 0.0))  # 40 m at 0.05 % and a fifth more: 2.4 %, and 1 % kept beside
    stays = what == "no return"
    if what == "mission":
        world.drives = 1000.0
        world.start(goto(50.0), goto(60.0))
    elif what != "by hand":
        world.sent(50.0, no_return=stays)
    world.run(0.5)
    if what == "stands":
        world.goal.state = "reached"
    elif what == "stopped":
        world.robot.estop, world.goal.state = True, "aborted"
    world.robot.battery = 0.138
    world.stand(40.0, 0.0)
    world.run(1.0)
    assert (world.state.warning == "") is True
    before = list(world.goals)
    for _ in range(40):
        world.robot.battery -= 0.0002
        world.stand(40.0, 0.0)
        world.run(1.0)
        if world.goals != before:
            break
        if world.robot.battery > 0.1345:
            assert world.goals == before
    if what in ("no return", "by hand", "stopped"):
        assert world.goals == before
        assert not world.state.warning or what == "stopped"
        world.robot.estop = False
        world.run(5.0)
        assert world.goals == before, "a robot that is let go stands"
        return
    assert world.goals == [*before, 0.0]
    world.set_at, world.drives = world.now, 1.0
    world.until("finished" if what == "stands" else "failed")
    if what != "stands":
        assert world.state.reason.startswith("the battery (13 %) is needed for the way home of 40 m")
        assert world.state.reason.endswith("the robot is back")
    world.stand(0.0, 0.0)
    world.run(20.0)
    assert world.goals == [*before, 0.0]


def test_the_battery_is_told_two_minutes_ahead_and_a_way_home_that_somebody_stops_is_not_begun_again() -> (
    None
):
    world = World()
    world.drive((0.0, 0.0), (40.0, 0.0))
    world.sent(50.0)
    world.robot.battery, first = 0.2, world.now
    world.run(0.5)
    while not world.goals:
        first = world.now if not world.state.warning else first
        world.robot.battery -= 0.0002
        world.stand(40.0, 0.0)
        world.run(1.0)
    assert (
        119.0 < (world.now - first) / NS < 240.0
    )  # it is reckoned with a robot that drives on, and this one stands
    assert world.ask("stop") == ""
    world.run(30.0)
    assert world.goals == [0.0]


def test_an_exploration_that_was_interrupted_remembers_over_a_restart(world: World) -> None:
    world.start(step("explore"), step("home"))
    world.run(3.0)
    question = world.kept[t.EXPLORE_QUESTION]
    sequence = decode(question, msg.ExploreQuestion).sequence
    views = msg.Viewpoints(sequence=sequence, x=array([5.0], "float64"), y=array([0.0], "float64"))
    world.take(world.stage.on(t.VIEWPOINTS, views))
    world.ends = ("aborted", "no_route")
    world.run(4.0)
    assert '"x": 5.0' in world.state.memory
    world.ask("pause")
    world.restart()
    world.ask("resume")
    world.stand(7.0, 1.0)
    world.run(3.0)
    assert decode(world.kept[t.EXPLORE_QUESTION], msg.ExploreQuestion).barred.tolist() == [5.0, 0.0]


def test_a_restarted_stage_goes_on_where_it_was(world: World) -> None:
    world.start(goto(1.0), step("wait", duration=1.0), goto(2.0))
    world.run(0.5)
    assert world.state.action_status[0] == "RUNNING"
    goal = world.goal.id
    world.restart()
    world.run(0.3)
    assert (world.goal.id, world.goals) == (goal, [1.0])  # the same goal, not a new one
    world.until("finished")
    assert world.goals == [1.0, 2.0]


def test_a_restarted_stage_stays_paused_and_cancels_what_was_left(world: World) -> None:
    world.start(goto(1.0))
    world.run(0.5)
    world.navigating = False
    world.ask("pause")  # the navigator does not hear the cancellation
    world.restart()
    world.navigating = True
    world.run(1.0)
    assert world.state.phase == "paused"
    assert world.goal.state == "cancelled"
    assert world.state.reason == "paused by anna"


def test_a_late_repeat_of_a_request_does_nothing(world: World) -> None:
    world.start(goto(1.0), goto(2.0))
    world.run(0.3)
    world.ask("pause", id="p")
    world.ask("resume")
    world.run(0.3)
    world.take(world.stage.on(t.MISSION_REQUEST, msg.MissionRequest(id="p", action="pause")))
    assert world.state.phase == "running"
    world.until("finished")
    assert "followed before" in world.ask("run", order=order(goto(1.0)))


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (order(step("look")), "does not turn the body yet"),
        (order(step("record")), "without a recorder"),
        (order(step("dance")), "there are only goto"),
        (order(), "1 to 1000 steps"),
        (order(goto(1.0), start=2), "there is no step 2"),
        (order(goto(float("nan"))), "not finite"),
        (order(goto(1.0), map="sha256:0"), "up --map FILE"),
        (order(goto(1.0), frame="odom"), "frame 'odom'"),
        (order(goto(1.0, on_failure="dance")), "on_failure 'dance'"),
        (order(goto(1.0), on_comms_loss="dance"), "on_comms_loss 'dance'"),
        (order(goto(1.0, blocking_type="NONE")), "blocking type"),
        (order(goto(1.0), goto(2.0), loops=[msg.MissionLoop(1, 3, 2)]), "loops cross"),
        (order(step("ask")), "nothing to answer"),
        (order(goto(1.0, id="a"), goto(2.0, id="a")), "same id"),
    ],
)
def test_what_cannot_be_done_is_refused_before_it_begins(wrong: msg.MissionOrder, words: str) -> None:
    world = World(EVERYWHERE)
    world.run(0.2)
    assert words in world.ask("run", order=wrong)
    assert world.state.phase == "idle"
    world.run(1.0)
    assert t.GOAL_REQUEST not in world.kept


def test_a_second_mission_waits_and_a_stopped_robot_begins_none(world: World) -> None:
    world.start(goto(1.0))
    assert "stop it first" in world.ask("run", order=order(goto(2.0), order_id="o2"))
    world.until("finished")
    world.robot.estop, world.robot.estop_cause = True, "operator"
    world.run(0.2)
    assert "`rbtrg-robot resume`" in world.ask("run", order=order(goto(2.0), order_id="o2"))


def test_an_update_changes_what_was_not_begun(world: World) -> None:
    world.start(goto(1.0), goto(2.0))
    world.run(0.3)
    assert "not newer" in world.ask("update", order=order(goto(1.0), goto(3.0)))
    assert "begun" in world.ask("update", order=order(goto(5.0), goto(3.0), order_update_id=1))
    assert world.ask("update", order=order(goto(1.0), goto(3.0), goto(4.0), order_update_id=1)) == ""
    world.until("finished")
    assert world.goals == [1.0, 3.0, 4.0]
    assert world.state.order_update_id == 1


def test_the_stack_says_what_it_can_and_which_map_it_has(tmp_path: Any) -> None:
    path = tmp_path / "map.bin"
    path.write_bytes(b"a map")
    name = fingerprint(str(path))
    assert len(name) == len("sha256:") + 16
    assert fingerprint("") == ""
    stage = build(load(scene="flat", map_file=str(path), record=False))
    ((_, state),) = stage.tick(NS)
    assert state.map == name
    wanted = order(goto(1.0), map=name)
    outputs = dict(stage.on(t.MISSION_REQUEST, msg.MissionRequest(id="r", action="run", order=wanted)))
    assert outputs[t.MISSION_STATE].phase == "running"


@pytest.mark.parametrize(
    "wrong",
    [
        {"phase": "dancing"},
        {"step": 0},
        {"step": 3},
        {"order_id": "o2"},
        {"action_status": ["DANCING", "WAITING"]},
        {"loop_rounds": array([1], "uint32")},
    ],
)
def test_last_words_that_make_no_sense_are_no_mission(world: World, wrong: dict[str, Any]) -> None:
    world.start(goto(1.0), goto(2.0))
    state = world.state
    for name, value in wrong.items():
        setattr(state, name, value)
    world.kept[t.MISSION_STATE] = encode(state)
    world.restart()
    world.run(1.5)
    assert world.state.phase == "idle"


def test_a_goal_status_that_makes_no_sense_is_none(world: World) -> None:
    world.start(goto(1.0))
    world.run(0.3)
    world.take(world.stage.on(t.GOAL_STATUS, msg.GoalStatus(id=world.goal.id, state="dancing")))
    world.until("finished")


OPERATIONS = st.lists(
    st.sampled_from(
        ["run", "pause", "resume", "skip", "answer", "estop", "release", "fail", "reach", "restart"]
    ),
    max_size=25,
)


@settings(max_examples=60, deadline=None)
@given(OPERATIONS, st.sampled_from(["retry", "skip", "return", "stop"]))
def test_whatever_happens_the_robot_drives_only_for_a_running_mission(ops: list[str], policy: str) -> None:
    world = World()
    world.drives = 1e9
    steps = [goto(1.0, on_failure=policy, retries=1), step("ask", text="?", choices=["a"]), goto(2.0)]
    world.start(*steps, loops=[msg.MissionLoop(1, 2, 2)])
    for op in ops:
        if op == "run":
            world.run(1.5)
        elif op == "restart":
            before, goal = world.state, (world.goal.id, world.goal.state)
            world.restart()
            world.run(0.2)
            if before.phase != "running":
                assert (world.state.phase, world.state.step) == (before.phase, before.step)
            elif goal[1] == "moving" and not world.robot.estop:
                assert (world.goal.id, world.goal.state) == goal
        elif op in ("estop", "release"):
            world.robot.estop = op == "estop"
            if world.robot.estop and world.goal.state == "moving":
                world.goal.state, world.goal.reason = "aborted", "emergency_stop"
        elif op in ("fail", "reach") and world.goal.state == "moving":
            world.goal.state, world.goal.reason = ("aborted", "stuck") if op == "fail" else ("reached", "")
        elif op in ("pause", "resume", "skip"):
            world.ask(op)
        elif op == "answer":
            world.ask(op, answer="a")
        world.run(0.3)
        state = world.state
        if state.phase != "running":
            assert world.goal.state != "moving"
        if world.robot.estop:
            assert state.phase != "running"
        assert 1 <= state.step <= 3
        assert state.action_status.count("RUNNING") <= (state.phase == "running")
        again = MissionStage(ALL)
        again.on(t.TF_STATIC, map_offset())
        again.on(t.MISSION_ORDER, decode(world.kept[t.MISSION_ORDER], msg.MissionOrder))
        again.on(t.MISSION_STATE, decode(world.kept[t.MISSION_STATE], msg.MissionState))
        told = again._tell(due=True)[0][1]  # what is told holds everything
        told.header, told.loop_rounds = state.header, array(told.loop_rounds, "uint32")
        told.question, told.choices = state.question, state.choices
        assert encode(told) == encode(state)


def test_home_is_where_the_run_began_until_an_operator_puts_it_elsewhere(world: World) -> None:
    world.run(0.2)
    assert (world.state.has_home, world.state.home_told, world.state.home_x) == (True, False, 0.0)
    world.start(goto(4.0), step("home"))
    world.until("finished")
    assert world.goals == [4.0, 0.0]
    put = order(has_home=True, home_x=2.0, home_y=-1.0, home_yaw=0.5)
    assert world.ask("home", order=put) == ""
    world.restart()
    world.run(0.2)
    state = world.state
    assert (state.home_told, state.home_x, state.home_y, state.home_yaw) == (True, 2.0, -1.0, 0.5)


def test_home_is_not_known_before_the_robot_knows_where_it_is() -> None:
    stage = MissionStage(ALL)
    stage.on(t.TF_STATIC, map_offset())
    stage.on(t.MAP_STATUS, msg.MapStatus(location="searching"))
    (_, state), *_ = stage.tick(10**12)
    assert not state.has_home
    request = msg.MissionRequest(id="r", action="home", order=order())
    (_, state), *_ = stage.on(t.MISSION_REQUEST, request)
    assert "not known" in state.refused
    stage.on(t.MAP_STATUS, msg.MapStatus(location="located"))
    (_, state), *_ = stage.tick(2 * 10**12)
    assert state.has_home
