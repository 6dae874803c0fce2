"""What `status` says is true: the pose is in the map frame, rates come from the publishers' own counts."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import pytest

from rbtrg_robot import topics as t
from rbtrg_robot.config import load
from rbtrg_robot.orders.words import robot_line
from rbtrg_robot.process import health as module
from rbtrg_robot.process.events import Events
from rbtrg_robot.process.health import Health
from rbtrg_robot.process.supervisor import Supervisor
from rbtrg_robot.wire.convert import MAP, ODOM, transform_msg
from rbtrg_robot.wire.messages import array, decode, encode, header


def take(health: Health, topic: t.Topic, message: Any) -> None:
    assert topic in Health.WATCHED
    health.take(topic, decode(encode(message), topic.kind))


def beat(count: int, newest: int) -> Any:
    return t.HEARTBEAT.kind(
        header=header(1, ""),
        process="odometry",
        pid=1,
        state="ready",
        topic=["/odom"],
        published=array([count], "uint64"),
        newest=array([newest], "int64"),
    )


def test_pose_is_in_the_map_frame() -> None:
    health = Health(simulated=True)
    shift = transform_msg(
        0, MAP, ODOM, (-4.5, -4.0, 0.3), (0.0, 0.0, math.sin(math.pi / 4), math.cos(math.pi / 4))
    )
    take(health, t.TF_STATIC, t.TF_STATIC.kind(transforms=[shift]))
    odom = t.ODOM.kind(header=header(1, ODOM))
    odom.pose.pose.position.x, odom.pose.pose.position.z = 2.0, 0.1
    odom.pose.pose.orientation.w = 1.0
    take(health, t.ODOM, odom)
    row = health.robot_row()
    assert (row["x"], row["y"], row["z"]) == pytest.approx((-4.5, -2.0, 0.4))
    assert row["yaw"] == pytest.approx(math.pi / 2)


def test_an_old_pose_is_told_as_old_and_without_its_speed() -> None:
    health = Health(simulated=True)
    odom = t.ODOM.kind(header=header(2_000_000_000, ODOM))
    odom.pose.pose.orientation.w, odom.twist.twist.linear.x = 1.0, 0.48
    take(health, t.ODOM, odom)
    for now, words in (
        (2_200_000_000, "at 0.00 0.00 yaw 0 deg, 0.48 m/s"),
        (14_000_000_000, "12 s ago at 0.00 0.00 yaw 0 deg, real"),
    ):
        take(health, t.ROBOT_STATE, t.ROBOT_STATE.kind(header=header(now, ""), phase="ready"))
        assert f"robot: ready, {words}" in robot_line(health.robot_row())


def test_nothing_is_said_of_a_topic_before_its_process_and_the_simulator_are_ready(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    health = Health(simulated=True)
    now = 100.0
    monkeypatch.setattr(module.time, "monotonic", lambda: now)

    def says(process: str, state: str) -> bool | None:
        """What `status` says of the odometry's topic after this heartbeat."""
        message = t.HEARTBEAT.kind(header=header(1, ""), process=process, pid=1, state=state)
        take(health, t.HEARTBEAT, message)
        verdict: bool | None = health.topic_row(t.ODOM)["ok"]
        return verdict

    assert health.topic_row(t.ODOM)["ok"] is None
    assert says("robot", "starting") is None
    assert says("odometry", "ready") is None
    now += 90.0  # others compile, and simulated time waits for them
    assert says("odometry", "ready") is None
    assert says("robot", "ready") is None
    assert health.unhealthy_topics((t.ODOM,)) == [t.ODOM.name], "the stack is not ready before it is well"
    now += 2.1
    assert says("odometry", "ready") is False
    health.forget("odometry")
    assert health.topic_row(t.ODOM)["ok"] is None


def test_a_topic_is_well_at_its_rate_only(monkeypatch: pytest.MonkeyPatch) -> None:
    health = Health(simulated=False)
    now = 100.0
    monkeypatch.setattr(module.time, "monotonic", lambda: now)
    for count in range(0, 40, 5):
        take(health, t.HEARTBEAT, beat(count, 0))
        now += 0.5
    assert health.topic_row(t.ODOM)["rate"] == pytest.approx(10.0)
    assert health.topic_row(t.ODOM)["ok"]
    for _ in range(8):
        take(health, t.HEARTBEAT, beat(40, 0))
        now += 0.5
    assert health.topic_row(t.ODOM)["rate"] < 1.0
    assert not health.topic_row(t.ODOM)["ok"]
    assert health.unhealthy_topics((t.ODOM, t.CLOCK)) == ["/odom"]


def test_a_forgotten_process_has_no_heartbeat() -> None:
    health = Health(simulated=False)
    take(health, t.HEARTBEAT, beat(0, 0))
    assert health.beat_age("odometry") is not None
    health.forget("odometry")
    assert health.beat_age("odometry") is None


def test_a_prior_map_that_does_not_fit_is_in_the_status_line() -> None:
    health = Health(simulated=True)
    take(
        health,
        t.ROBOT_STATE,
        t.ROBOT_STATE.kind(header=header(1, ""), phase="ready", realtime_factor=1.0),
    )
    for warning in ("the prior map does not fit", ""):
        take(health, t.MAP_STATUS, t.MAP_STATUS.kind(header=header(1, "map"), warning=warning))
        assert health.robot_row()["map_warning"] == warning
        assert ("MAP: the prior map does not fit" in robot_line(health.robot_row())) == bool(warning)


def running(phase: str = "ready") -> Supervisor:
    """All processes live; no topic is expected."""
    supervisor = Supervisor(load(None, []), None, lambda _line: None)  # type: ignore[arg-type]
    supervisor._expected = ()
    for name, child in supervisor._children.items():
        child.forked = SimpleNamespace(poll=lambda: None)  # type: ignore[assignment]
        alive = t.HEARTBEAT.kind(header=header(1, ""), process=name, state="ready")
        take(supervisor._health, t.HEARTBEAT, alive)
    take(supervisor._health, t.ROBOT_STATE, t.ROBOT_STATE.kind(header=header(1, ""), phase=phase))
    return supervisor


@pytest.mark.parametrize("phase", ["ready", "sitting", "standing", "disconnected", "fault"])
def test_a_stack_whose_robot_lies_is_up_one_whose_robot_is_in_trouble_is_not(phase: str) -> None:
    told = running(phase)._missing()
    assert told == ("" if phase in ("ready", "sitting") else f"the robot is {phase}")


def test_what_the_start_waits_for_is_told_by_its_first_cause() -> None:
    """A backend of somebody else that delivered nothing kept `up` waiting for half an hour without a word."""
    supervisor = running()
    supervisor._expected = (t.IMU, t.POINTS, t.POSE, t.CMD_VEL)
    silent = "the robot's backend is too slow or silent: /imu/data 0 of 200 Hz, /lidar/main/points 0 of 10 Hz"
    assert supervisor._missing() == silent
    supervisor._expected = (t.POSE,)
    assert supervisor._missing() == "/odom/fast 0 of 200 Hz"
    supervisor._health.forget("guard")
    assert supervisor._missing() == "guard has not started"


@pytest.mark.parametrize(
    ("topic", "before", "silent", "well"),
    [
        (t.ROUTE_STATUS, True, 5.0, True),
        (t.ROUTE_STATUS, True, 0.5, False),
        (t.ROUTE_STATUS, False, 5.0, False),
        (t.MAP_WINDOW, True, 5.0, False),
    ],
    ids=["at work", "alive and silent", "never well", "another's"],
)
def test_a_planner_that_looks_at_a_large_map_keeps_no_stack_from_being_ready(
    topic: t.Topic, before: bool, silent: float, well: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It prepared a prior map of 100 x 100 m for 6 s, and the start waited for it."""
    supervisor, now = running(), 100.0
    monkeypatch.setattr(module.time, "monotonic", lambda: now)
    supervisor._expected = (topic,)

    def beat_of_owner(count: int) -> None:
        published = {
            "topic": [topic.name],
            "published": array([count], "uint64"),
            "newest": array([1], "int64"),
        }
        alive = t.HEARTBEAT.kind(header=header(1, ""), process=topic.owner, state="ready", **published)
        take(supervisor._health, t.HEARTBEAT, alive)

    for turn in range(8):
        beat_of_owner(round(1 + before * turn * topic.rate / 2))
        now += 0.5
    assert (not supervisor._missing()) is before
    for _ in range(10):
        beat_of_owner(99)
        now += 0.5
    assert supervisor._missing()
    now += silent - 0.5
    assert (not supervisor._missing()) is well


def test_a_robot_that_goes_and_comes_back_is_told_on_the_screen() -> None:
    said: list[str] = []
    events = Events(said.append)
    for phase in ("ready", "disconnected", "disconnected", "ready", "moving"):
        state = t.ROBOT_STATE.kind(header=header(1, ""), phase=phase, cause="no LowState for 0.2 s")
        events.take(t.ROBOT_STATE, state)
    assert said == ["robot disconnected: no LowState for 0.2 s", "robot is back"]


@pytest.mark.parametrize(
    ("state", "line"),
    [
        (
            {"cause": "lying", "hold": "robot is sitting: lying"},
            "robot: sitting, held (robot is sitting: lying)",
        ),
        ({"cause": "lying", "hold": "no command"}, "robot: sitting (lying)"),
        (
            {"cause": "lying", "estop": True, "estop_cause": "emergency stop: cli"},
            "robot: sitting (lying), E-STOP (emergency stop: cli)",
        ),
    ],
)
def test_the_status_line_says_why_once(state: dict[str, Any], line: str) -> None:
    health = Health(simulated=True)
    take(health, t.ROBOT_STATE, t.ROBOT_STATE.kind(header=header(1, ""), phase="sitting", **state))
    assert robot_line(health.robot_row()).startswith(line + ", real-time")


def test_clocks_of_the_lidars_are_in_the_status_line() -> None:
    health = Health(simulated=True)
    take(
        health,
        t.ROBOT_STATE,
        t.ROBOT_STATE.kind(header=header(1, ""), phase="ready", realtime_factor=1.0),
    )
    odometry = t.ODOM_HEALTH.kind(
        header=header(1, "odom"),
        health="good",
        lidar=["main", "head"],
        time_offset=array([0.06, 0.0], "float64"),
        time_offset_sigma=array([0.001, 0.002], "float64"),
        time_applied=array([0.05, 0.0], "float64"),
        calibration="beyond",
    )
    take(health, t.ODOM_HEALTH, odometry)
    row = health.robot_row()
    assert row["lidars"]["main"] == {"time_offset": 0.06, "sigma": 0.001, "applied": 0.05}
    assert "CALIBRATION: beyond, stamps of the main LiDAR corrected by +50.0 ms, real" in robot_line(row)


def test_a_lidar_that_the_robot_does_not_carry_is_not_missed() -> None:
    health = Health(simulated=False, lidars=["main"])
    verdicts = [health.topic_row(x)["ok"] for x in (t.HEAD_POINTS, t.HEAD_CLOUD, t.POINTS)]
    assert verdicts[:2] == [True, True]
    assert not verdicts[2]
