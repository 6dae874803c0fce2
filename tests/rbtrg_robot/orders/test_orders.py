"""Orders to the robot, message by message."""

from __future__ import annotations

from rbtrg_robot import topics as t
from rbtrg_robot.latch import NAME_COUNT, number
from rbtrg_robot.msg import RobotState
from rbtrg_robot.orders.limits import ANSWER_LIMIT, REPEAT_PERIOD, STOP_PATIENCE
from rbtrg_robot.orders.robot import Resume, Stop


def test_a_stop_is_sent_again_and_again_until_the_robot_says_it() -> None:
    order = Stop("Anna")
    order.take(t.ROBOT_STATE, RobotState(estop=True, estop_cause="of before", latch=77))
    assert order.outcome is None, "nothing was sent yet"
    for k in range(5):
        ((topic, message),) = order.tick(1.25 * k * REPEAT_PERIOD)
        assert (topic, message.mode, message.cause) == (t.ROBOT_STOP, "stop", "Anna")
        assert order.tick((1.25 * k + 0.5) * REPEAT_PERIOD) == []
        order.take(t.ROBOT_STATE, RobotState(estop=False))
    latch = number(10**18, message.latch)
    order.take(t.ROBOT_STATE, RobotState(estop=True, estop_cause="emergency stop: Anna", latch=latch))
    assert order.outcome is not None
    assert (order.outcome.ok, order.outcome.words) == (True, "stopped: emergency stop: Anna")
    assert order.tick(9.0) == []


def test_a_stop_that_was_lost_is_not_confirmed_by_the_state_of_another() -> None:
    order, latch = Stop("Anna"), number(10**18, Stop("Bob").message()[1].latch)
    ((_, lost),) = order.tick(0.0)
    # Bob's stop was told before, and somebody has released it meanwhile: this state was under way.
    order.take(t.ROBOT_STATE, RobotState(estop=True, estop_cause="emergency stop: Bob", latch=latch))
    assert order.outcome is None
    ((topic, again),) = order.tick(1.1 * REPEAT_PERIOD)
    assert (topic, again.latch) == (t.ROBOT_STOP, lost.latch)
    order.take(t.ROBOT_STATE, RobotState(estop=True, latch=number(latch + 1, again.latch)))
    assert order.outcome is not None
    assert order.outcome.ok


def test_the_number_of_a_latch_rises_and_ends_in_the_name_of_the_stop() -> None:
    latch = 0
    for name in (5, 5, NAME_COUNT - 1, 1, 0):
        before, latch = latch, number(latch + 1, name)
        assert before < latch <= before + NAME_COUNT
        assert name in (0, latch % NAME_COUNT)
    assert number(latch + 1, 0) == latch + 1


def test_a_stop_that_nobody_confirms_is_no_success() -> None:
    order = Stop()
    order.tick(0.0)
    assert order.tick(STOP_PATIENCE + 0.1) == []
    assert order.outcome is not None
    assert not order.outcome.ok
    assert "use the hardware stop" in order.outcome.words


def test_resume_releases_what_it_heard_of_first_and_no_newer_stop() -> None:
    order = Resume()
    assert order.tick(0.0) == [], "nobody knows yet of what"
    order.take(t.ROBOT_STATE, RobotState(estop=True, latch=5))
    for now in (0.1, 0.2 + REPEAT_PERIOD):
        ((topic, message),) = order.tick(now)
        assert (topic, message.mode, message.latch) == (t.ROBOT_COMMAND, "resume", 5)
        order.take(t.ROBOT_STATE, RobotState(estop=True, latch=5))
    order.take(t.ROBOT_STATE, RobotState(estop=True, estop_cause="emergency stop: Bob", latch=6))
    assert order.outcome is not None
    assert not order.outcome.ok
    assert "stopped again: emergency stop: Bob" in order.outcome.words
    assert order.tick(9.0) == []


def test_resume_is_done_when_nothing_is_latched() -> None:
    order = Resume()
    order.take(t.ROBOT_STATE, RobotState(estop=True, latch=5))
    order.tick(0.0)
    order.take(t.ROBOT_STATE, RobotState(latch=0))
    assert order.outcome is not None
    assert (order.outcome.ok, order.outcome.words) == (True, "resumed")
    idle = Resume()
    idle.take(t.ROBOT_STATE, RobotState(latch=0))
    assert idle.outcome is not None
    assert idle.outcome.words == "nothing to resume"
    silent = Resume()
    silent.tick(0.0)
    silent.tick(ANSWER_LIMIT + 0.1)
    assert silent.outcome is not None
    assert not silent.outcome.ok
