"""The step `dock`: before the dock first, then straight to the pose that the mission has or that somebody tells."""

from __future__ import annotations

import math
from typing import Any

import pytest

from hal.types import NS
from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.missions.file import MissionFile, describe
from rbtrg_robot.stages.mission.attempt import LONGEST_WAIT
from rbtrg_robot.stages.mission.dock import DOCK_AHEAD, FARTHEST_OFF, SEEN_WITHIN
from rbtrg_robot.wire.convert import rpy_quaternion
from rbtrg_robot.wire.messages import header
from tests.rbtrg_robot.stages.mission.test_executor import World, order, step


class Docks(World):
    """A navigator that comes where it is sent, and somebody who may tell the pose of the dock."""

    def __init__(self) -> None:
        super().__init__()
        self.sent_to: list[tuple[float, float, float]] = []

    def _navigate(self, request: Any) -> None:
        if request.action == 0 and request.id != self.goal.id:
            self.sent_to.append((request.x, request.y, request.yaw))
        super()._navigate(request)

    def tell(self, x: float, y: float, yaw: float = 0.0, frame: str = "map", age: float = 0.0) -> None:
        pose = msg.PoseStamped(header=header(self.now - round(age * NS), frame))
        pose.pose.position.x, pose.pose.position.y = x, y
        q = rpy_quaternion((0.0, 0.0, yaw))
        o = pose.pose.orientation
        o.x, o.y, o.z, o.w = q
        self.take(self.stage.on(t.DOCK_POSE, pose))

    def watch(self, seconds: float, *pose: float, **how: Any) -> None:
        """A pose every half second."""
        for _ in range(round(2 * seconds)):
            self.tell(*pose, **how)
            self.run(0.5)


def given(**pose: float) -> msg.MissionOrder:
    return MissionFile.model_validate(
        {"steps": [{"dock": {"x": 4.0, "y": 1.0, "yaw_deg": 90.0} | pose}]}
    ).order("o1")


def test_a_pose_given_by_hand_is_come_to_from_before_it() -> None:
    world = Docks()
    world.ask("run", order=given())
    world.run(10.0)
    before, at = world.sent_to
    assert before == pytest.approx((4.0, 1.0 - DOCK_AHEAD, math.pi / 2))
    assert at == pytest.approx((4.0, 1.0, math.pi / 2))
    state = world.state
    assert state.phase == "finished"
    assert "at the dock, 4.00 1.00, 90 deg, as the mission has it" in state.result_description[0]


def test_a_pose_that_is_told_counts_and_must_be_fresh_for_the_last_stretch() -> None:
    world = Docks()
    world.ask("run", order=given())
    world.watch(10.0, 4.2, 1.1, math.pi / 2)
    assert world.sent_to[-1] == pytest.approx((4.2, 1.1, math.pi / 2))
    assert world.state.phase == "finished"
    assert "as seen" in world.state.result_description[0]

    world = Docks()
    world.ask("run", order=given())
    world.tell(4.2, 1.1, math.pi / 2)
    world.run(0.5 + 1.0 + SEEN_WITHIN + 2.0)
    assert len(world.sent_to) == 1, "no last stretch by an old pose"
    assert world.state.phase == "failed"
    assert "not seen from before it" in world.state.reason


def test_a_pose_of_another_dock_or_one_that_is_old_tells_nothing() -> None:
    world = Docks()
    world.ask("run", order=given())
    world.watch(10.0, 4.0 + FARTHEST_OFF + 0.1, 1.0, 0.0)
    assert world.sent_to[-1] == pytest.approx((4.0, 1.0, math.pi / 2))
    world = Docks()
    world.ask("run", order=order(step("dock")))
    world.watch(5.0, 4.0, 1.0, age=3.0)
    assert world.sent_to == []
    world.tell(math.nan, 1.0)
    world.run(1.0)
    assert world.sent_to == []


def test_a_dock_in_the_frame_of_the_body_lies_where_the_robot_looks() -> None:
    world = Docks()  # it stands at 7, 1 in `odom`, which lies elsewhere in `map`
    pose = world.stage._world.pose
    assert pose is not None
    world.ask("run", order=order(step("dock")))
    world.watch(10.0, 2.0, 0.0, frame="base_link")
    x, y, yaw = pose
    assert world.sent_to[-1] == pytest.approx(
        (x + 2.0 * math.cos(yaw), y + 2.0 * math.sin(yaw), yaw), abs=1e-6
    )


def test_nobody_tells_where_the_dock_is() -> None:
    world = Docks()
    world.ask("run", order=order(step("dock")))
    world.run(LONGEST_WAIT + 2.0)
    assert world.sent_to == []
    assert world.state.phase == "failed"
    assert "/dock/pose" in world.state.reason


def test_a_goal_that_fails_fails_the_step() -> None:
    world = Docks()
    world.ends = ("aborted", "no_route")
    world.ask("run", order=given())
    world.run(5.0)
    assert world.state.phase == "failed"
    assert "no route" in world.state.reason


def test_the_file_says_it_in_words() -> None:
    steps = MissionFile.model_validate(
        {"steps": ["dock", {"dock": None}, {"dock": {"x": 1, "y": 2, "yaw_deg": -90}}]}
    )
    words = [describe(each) for each in steps.order("o").steps]
    assert words == ["dock where /dock/pose tells"] * 2 + ["dock at 1.00 2.00 yaw -90 deg"]
