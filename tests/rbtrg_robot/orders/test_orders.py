"""Orders to the robot, message by message."""

from __future__ import annotations

from rbtrg_robot import topics as t
from rbtrg_robot.msg import RobotState
from rbtrg_robot.orders.limits import ANSWER_LIMIT, PATIENCE, REPEAT
from rbtrg_robot.orders.robot import Resume, Stop


def test_a_stop_is_sent_again_and_again_until_the_robot_says_it() -> None:
    order = Stop("Anna")
    order.take(t.ROBOT_STATE, RobotState(estop=True, estop_cause="of before"))
    assert order.outcome is None, "nothing was sent yet"
    for k in range(5):
        ((topic, message),) = order.tick(1.25 * k * REPEAT)
        assert (topic, message.mode, message.cause) == (t.ROBOT_STOP, "stop", "Anna")
        assert order.tick((1.25 * k + 0.5) * REPEAT) == []
        order.take(t.ROBOT_STATE, RobotState(estop=False))
    order.take(t.ROBOT_STATE, RobotState(estop=True, estop_cause="emergency stop: Anna"))
    assert order.outcome is not None
    assert (order.outcome.ok, order.outcome.words) == (True, "stopped: emergency stop: Anna")
    assert order.tick(9.0) == []


def test_a_stop_that_nobody_confirms_is_no_success() -> None:
    order = Stop()
    order.tick(0.0)
    assert order.tick(PATIENCE + 0.1) == []
    assert order.outcome is not None
    assert not order.outcome.ok
    assert "use the hardware stop" in order.outcome.words


def test_resume_releases_what_it_heard_of_first_and_no_newer_stop() -> None:
    order = Resume()
    assert order.tick(0.0) == [], "nobody knows yet of what"
    order.take(t.ROBOT_STATE, RobotState(estop=True, latch=5))
    for now in (0.1, 0.2 + REPEAT):
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
