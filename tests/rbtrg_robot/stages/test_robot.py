"""One command path: who has the motion, and what a `resume` releases."""

from __future__ import annotations

import json
from typing import Any

import pytest

from hal.safety.gate import SafetyGate
from hal.safety.monitors import BLIND_HANDS, OLD_HANDS, Monitor, taken_out
from hal.types import NS
from hal.unitree.api import SPORT, Sport
from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.orders.robot import Stop
from rbtrg_robot.stages.robot import STEP_PERIOD, RobotStage
from rbtrg_robot.topics import Topic
from rbtrg_robot.wire.messages import decode, encode, header
from tests.hal.unitree.world import World
from tests.rbtrg_robot.hearsay import all_clear

WATCHED = frozenset({"tracker", "guard"})


def endpoint(who: str, topic: Topic) -> str:
    """A sender as the bus tells it: a process is another one on each of its topics."""
    return f"{who} {topic.name}"


class Rig:
    """The robot process in front of a robot that does what it is told. Velocities [m/s] by source; None: silent."""

    def __init__(self, world: World | None = None) -> None:
        self.world = world or World(epoch=10 * NS)
        gate = SafetyGate(self.world.backend.capabilities)
        self.stage = RobotStage(self.world.backend, gate, simulated=False, watched=WATCHED)
        self.stage.warm_up()
        for process in WATCHED:
            self.stage.alive(process, True)
        self.tracker: float | None = 0.3
        self.teleop: float | None = None
        self.link = 0.1
        """[s] there and back again on the link of the hand."""
        self.state: msg.RobotState = msg.RobotState()

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds * NS / STEP_PERIOD)):
            self.world.advance(STEP_PERIOD / NS)
            if self.world.now % (4 * STEP_PERIOD) == 0:
                self.stage.on(t.MOTION_LIMITS, all_clear(self.world.now))
                self.say(t.CMD_VEL, self.tracker, "tracker")
                self.say(t.TELEOP, self.teleop, "hand")
            for topic, message in self.stage.tick(self.world.now):
                if topic is t.ROBOT_STATE:
                    self.state = message

    def say(self, topic: Topic, speed: float | None, who: str) -> None:
        """One command; the hand echoes what it saw."""
        if speed is not None:
            stamp = self.world.now - (round(self.link * NS) if topic is t.TELEOP else 0)
            command = msg.TwistStamped(header=header(max(stamp, 0), "base_link"))
            command.twist.linear.x = speed
            self.stage.on(topic, command, endpoint(who, topic))

    def tilt(self, seconds: float, who: str = "tracker", topic: Topic = t.TRUNK) -> None:
        """The trunk nose-down by 0.2 rad; whatever the velocities are."""
        for _ in range(round(seconds / 0.02)):
            command = msg.TrunkCommand(header=header(self.world.now, "base_link"), pitch=0.2)
            self.stage.on(topic, command, endpoint(who, topic))
            self.run(0.02)

    def stop(self) -> Stop:
        """One that was heard."""
        order = Stop("Anna")
        self.hear(order)
        return order

    def hear(self, order: Stop) -> None:
        """It comes to the robot, which tells its state."""
        self.stage.on(*order.message())
        self.run(0.01)

    def order(self, mode: str, latch: int = 0) -> None:
        self.stage.on(t.ROBOT_COMMAND, msg.RobotCommand(mode=mode, latch=latch, cause="test"))
        self.run(0.1)

    @property
    def speed(self) -> float:
        return float(self.state.vx)


@pytest.fixture
def rig() -> Rig:
    made = Rig()
    made.run(1.0)
    assert made.speed == 0.3
    return made


def refused(state: Any) -> dict[str, int]:
    return dict(zip(state.refused_reason, state.refused_count, strict=True))


def test_who_drives_by_hand_takes_the_motion_until_resume(rig: Rig) -> None:
    rig.teleop = -0.2
    rig.run(0.5)
    assert rig.speed == -0.2
    assert rig.state.taken == "teleop has the motion"
    assert not rig.state.estop
    rig.teleop = None
    rig.run(0.3)
    assert rig.speed == 0.0, "silent for longer than the deadman"
    rig.run(1.0)
    assert rig.speed == 0.0, "the tracker does not take over by itself"
    assert rig.state.hold == "teleop had the motion; `rbtrg-robot resume` gives it back"
    rig.order("resume", rig.state.latch)
    rig.run(0.5)
    assert (rig.speed, rig.state.taken, rig.state.latch) == (0.3, "", 0)


def test_the_emergency_stop_stands_above_the_hand(rig: Rig) -> None:
    rig.teleop = 0.2
    rig.run(0.5)
    rig.order("stop")
    rig.run(0.5)
    assert rig.speed == 0.0
    rig.order("resume", rig.state.latch)
    rig.run(0.5)
    assert rig.speed == 0.2, "the hand drives on, it still speaks"
    assert rig.state.taken == "teleop has the motion"


def test_resume_releases_the_stop_it_names_and_no_newer_one(rig: Rig) -> None:
    rig.order("stop")
    first = rig.state.latch
    assert first > 0
    for wrong in (0, first - 1, first + 1):
        rig.order("resume", wrong)
        assert rig.state.estop
    assert refused(rig.state)["resume of another stop"] == 3
    rig.order("resume", first)
    assert not rig.state.estop
    rig.order("stop")
    assert rig.state.latch > first
    rig.order("resume", first)  # a late repeat
    rig.run(0.5)
    assert rig.state.estop
    assert rig.speed == 0.0


def test_each_of_two_senders_hears_of_his_own_stop_and_of_no_other(rig: Rig) -> None:
    anna, bob = Stop("Anna"), rig.stop()
    anna.take(t.ROBOT_STATE, rig.state)
    assert anna.outcome is None, "hers was lost"
    bob.take(t.ROBOT_STATE, rig.state)
    assert bob.outcome is not None
    first = rig.state.latch
    for _ in range(3):
        rig.hear(anna)
    anna.take(t.ROBOT_STATE, rig.state)
    assert anna.outcome is not None
    rig.order("resume", first)
    assert rig.state.estop
    rig.order("resume", rig.state.latch)
    assert not rig.state.estop


def test_a_stop_on_a_robot_that_stands_already_needs_its_own_resume(rig: Rig) -> None:
    rig.world.faults.remote = (0.5, 0.0, 0.0, 0.0, 0.0)
    rig.run(0.1)
    first = rig.state.latch
    assert rig.state.estop_cause == "the operator's remote drives"
    rig.world.faults.remote = (0.0,) * 5
    rig.run(0.1)
    rig.order("stop")
    rig.order("resume", first)
    assert rig.state.estop
    rig.order("resume", rig.state.latch)
    assert not rig.state.estop


def test_the_sticks_of_the_robots_own_remote_end_every_word_to_it(rig: Rig) -> None:
    rig.world.faults.remote = (0.5, 0.0, 0.0, 0.0, 0.0)
    before = len(rig.world.sent)
    rig.run(1.0)
    said = [request.api for _, service, request in rig.world.sent[before:] if service == SPORT]
    assert Sport.STOP_MOVE in said[:2], "at once; one Move was due before the sticks were seen"
    silent = len(rig.world.sent)
    rig.run(1.0)
    assert len(rig.world.sent) == silent, "whoever holds the remote has the robot for himself"


def test_a_second_source_of_commands_is_refused_and_counted(rig: Rig) -> None:
    for _ in range(20):
        rig.say(t.CMD_VEL, -0.9, "somebody")
        rig.run(0.02)
    rig.run(0.1)
    assert rig.speed == 0.3
    assert refused(rig.state)["another tracker has the say"] == 20


def test_a_hand_needs_the_guard_and_nobody_else(rig: Rig) -> None:
    rig.stage.alive("tracker", False)
    rig.teleop = 0.2
    rig.run(0.5)
    assert rig.speed == 0.2
    rig.stage.alive("guard", False)
    rig.run(0.1)
    assert rig.speed == 0.0


@pytest.mark.parametrize(
    ("link", "refused_as"),
    [
        (0.0, ""),
        (0.4, ""),
        pytest.param(-0.3, "", marks=pytest.mark.campaign),
        (0.6, "old hands"),
        pytest.param(3.0, "old hands", marks=pytest.mark.campaign),
        (-1.0, "blind hands"),
        pytest.param(1e9, "blind hands", marks=pytest.mark.campaign),
    ],
)
def test_hands_that_saw_the_robot_too_long_ago_move_nothing(rig: Rig, link: float, refused_as: str) -> None:
    """Through a link of 3 s it moved 0.30 m, all after the hands had let go."""
    rig.link, rig.teleop = link, 0.2
    rig.run(0.3)
    x = rig.world.body.x
    rig.run(1.0)
    assert (rig.speed == 0.2) == (not refused_as)
    assert (rig.world.body.x - x > 0.1) == (not refused_as)
    assert set(refused(rig.state)) == ({refused_as} if refused_as else set())
    assert not refused_as or f"command refused, {refused_as}: " in rig.state.hold
    if refused_as != "blind hands":
        assert rig.state.hands == pytest.approx(max(link, 0.0), abs=0.01)
    rig.teleop = None
    rig.run(1.5)
    assert rig.state.hands == -1.0


@pytest.mark.parametrize("row", [OLD_HANDS, BLIND_HANDS])
def test_without_the_monitor_old_hands_drive(rig: Rig, row: Monitor) -> None:
    rig.link, rig.teleop = (3.0 if row is OLD_HANDS else -3.0), 0.2
    with taken_out(row.name):
        rig.run(1.0)
    assert rig.speed == 0.2


def test_a_trunk_is_not_tilted_by_old_hands(rig: Rig) -> None:
    rig.teleop = 0.0
    rig.run(1.0)
    for age, tilted in ((3.0, False), (0.1, True)):
        for _ in range(25):
            stamp = rig.world.now - round(age * NS)
            command = msg.TrunkCommand(header=header(stamp, "base_link"), pitch=0.2)
            rig.stage.on(t.TELEOP_TRUNK, command, endpoint("hand", t.TELEOP_TRUNK))
            rig.run(0.02)
        assert (rig.state.trunk_pitch > 0.1) == tilted


@pytest.mark.parametrize("latch", [2**63 - 1, -5])
def test_a_restored_latch_of_no_possible_number_keeps_no_stop_from_being_told(rig: Rig, latch: int) -> None:
    rig.stage.on(t.ROBOT_STATE, msg.RobotState(estop=True, estop_cause="of before", latch=latch))
    order = rig.stop()
    order.take(t.ROBOT_STATE, decode(encode(rig.state), msg.RobotState))
    assert order.outcome is not None
    assert order.outcome.ok
    assert rig.state.latch > 0


@pytest.mark.parametrize("taken", [False, True])
def test_what_was_latched_before_a_crash_is_latched_after_it(rig: Rig, taken: bool) -> None:
    if taken:
        rig.teleop = 0.2
        rig.run(0.5)
    else:
        rig.order("stop")
    before = rig.state
    again = Rig()
    again.stage.on(t.ROBOT_STATE, before)
    again.run(1.0)
    assert again.speed == 0.0
    assert again.state.latch == before.latch
    assert again.state.estop_cause == before.estop_cause
    again.order("resume", before.latch)
    again.run(0.5)
    assert again.speed == 0.3


def test_a_hand_with_a_broken_command_leaves_the_robot_at_rest(rig: Rig) -> None:
    rig.teleop = float("nan")
    rig.run(0.1)
    assert rig.speed == 0.0


def test_the_trunk_tilts_at_rest_and_a_stop_levels_it(rig: Rig) -> None:
    rig.tilt(1.0)
    assert rig.state.trunk_pitch == 0.0, "it drives"
    assert refused(rig.state)["not standing still"] > 0
    rig.tracker = 0.0
    rig.run(1.0)
    rig.tilt(1.0)
    assert rig.state.trunk_pitch == pytest.approx(0.2)
    eulers = [json.loads(r.parameter)["y"] for _, _, r in rig.world.sent if r.api == Sport.EULER]
    assert max(eulers) == pytest.approx(0.2)
    rig.order("stop")
    rig.tilt(0.5)
    assert rig.state.trunk_pitch == 0.0


@pytest.mark.parametrize("trouble", ["tracker dead", "by hand", "another sender"])
def test_a_tilt_ends_with_whoever_asked_for_it(rig: Rig, trouble: str) -> None:
    rig.tracker = 0.0
    rig.run(1.0)
    rig.tilt(0.5)
    assert rig.state.trunk_pitch == pytest.approx(0.2)
    if trouble == "another sender":
        rig.tilt(0.1, who="somebody")
        rig.run(0.1)
        assert refused(rig.state)["another tracker has the say"] == 5
        rig.run(0.6)
    else:
        if trouble == "tracker dead":
            rig.stage.alive("tracker", False)
        else:
            rig.teleop = 0.0
        rig.tilt(0.6)
    assert rig.state.trunk_pitch == 0.0


def test_a_hand_tilts_the_trunk_and_has_the_motion_then(rig: Rig) -> None:
    rig.tilt(0.1, "hand", t.TELEOP_TRUNK)
    rig.run(1.0)
    assert rig.speed == 0.0, "the tracker lost the motion"
    rig.tilt(0.5, "hand", t.TELEOP_TRUNK)
    assert rig.state.trunk_pitch == 0.0, "no velocity of zero beside it"
    rig.teleop = 0.0
    rig.run(0.5)
    rig.tilt(0.5, "hand", t.TELEOP_TRUNK)
    assert rig.state.trunk_pitch == pytest.approx(0.2)
    rig.tilt(0.1, "somebody", t.TELEOP_TRUNK)
    rig.run(0.1)
    assert refused(rig.state)["another teleop has the say"] == 5
    rig.tilt(0.5, "hand", t.TELEOP_TRUNK)
    assert rig.state.trunk_pitch == pytest.approx(0.2)
    rig.stage.alive("guard", False)
    rig.tilt(0.6, "hand", t.TELEOP_TRUNK)
    assert rig.state.trunk_pitch == 0.0


def test_competing_limits_count_by_their_minimum_and_go_when_they_are_old(rig: Rig) -> None:
    """Another program's limits of 9 m/s came between the guard's: the newest one counted."""

    def limits(forward: float, sender: str) -> None:
        told = msg.MotionLimits(header=header(rig.world.now, "base_link"), forward=forward)
        rig.stage.on(t.MOTION_LIMITS, told, sender)

    for _ in range(30):
        limits(0.1, "guard")
        limits(9.0, "stranger")
        rig.run(0.05)
    assert rig.speed == pytest.approx(0.1)
    rig.run(1.0)  # both are silent; those of the rig go on
    assert rig.speed == pytest.approx(0.3)


def test_a_velocity_of_an_odometry_that_is_lost_is_no_motion_and_the_wheels_still_are() -> None:
    """A robot that was thrown over and got up: its odometry integrates nonsense until a scan fits again."""
    rig = Rig()
    rig.tracker = None

    def odometry(health: str) -> None:
        for _ in range(150):
            pose = msg.Odometry(header=header(rig.world.now, "odom"))
            pose.twist.twist.linear.x = 5.8
            rig.stage.on(t.POSE, pose)
            rig.stage.on(
                t.ODOM_HEALTH, msg.OdometryHealth(header=header(rig.world.now, "odom"), health=health)
            )
            rig.run(0.02)

    odometry("lost")
    assert rig.state.estop_cause == ""
    odometry("good")
    assert "it moves by 5.80 m/s" in rig.state.estop_cause
