"""An operator says where the robot stands, and loads a map, in the closed loop on flat ground."""

from __future__ import annotations

import math
from typing import Any

import pytest

from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.config import load
from rbtrg_robot.hosts.lockstep import Lockstep
from rbtrg_robot.topics import Topic
from rbtrg_robot.wire.convert import MAP, point, yaw_of, yaw_quaternion
from rbtrg_robot.wire.frames import MapFrame
from rbtrg_robot.wire.messages import decode, header


class Placed:
    """A stack, and where it thinks the robot is in `map`."""

    def __init__(self, stack: Lockstep) -> None:
        self.stack = stack
        self.frame = MapFrame()
        self.map = msg.GridMap()
        self.told = 0
        """How often the offset of `odom` was told."""
        stack.host.listen(self._note)

    def _note(self, topic: Topic, payload: bytes, _now: int) -> None:
        if topic is t.TF_STATIC:
            self.told += 1
            self.frame.take(decode(payload, msg.TFMessage))
        elif topic is t.MAP_FULL:
            self.map = decode(payload, msg.GridMap)

    def say(self, x: float, y: float, yaw: float) -> None:
        message = msg.PoseWithCovarianceStamped(header=header(self.stack.now, MAP))
        message.pose.pose.position, message.pose.pose.orientation = point((x, y, 0.0)), yaw_quaternion(yaw)
        self.stack.host.inject(t.INITIAL_POSE, message)

    @property
    def here(self) -> tuple[float, float, float]:
        return self.frame.pose2(*planar(self.stack.newest[t.ODOM]))

    @property
    def truth(self) -> tuple[float, float, float]:
        return planar(self.stack.newest[t.TRUTH])


def planar(odom: Any) -> tuple[float, float, float]:
    pose = odom.pose.pose
    return pose.position.x, pose.position.y, yaw_of(pose.orientation)


def test_a_robot_that_started_elsewhere_is_told_its_place_while_it_stands() -> None:
    with Lockstep(load(None, ["sim.lidar_step=8"], scene="flat")) as stack:
        placed = Placed(stack)
        stack.wait_ready()
        stack.run(1.0)
        epoch = stack.newest[t.MAP_STATUS].epoch
        x, y, yaw = placed.truth
        placed.say(x + 3.0, y - 2.0, yaw + 1.0)
        stack.run(0.3)
        assert placed.here == pytest.approx((x + 3.0, y - 2.0, yaw + 1.0), abs=0.03)
        placed.say(*placed.truth)
        stack.run(0.5)
        assert placed.here == pytest.approx(placed.truth, abs=0.03)
        assert stack.newest[t.MAP_STATUS].epoch == epoch + 2  # what was mapped stood elsewhere
        placed.say(*placed.truth)
        stack.run(0.3)
        assert stack.newest[t.MAP_STATUS].epoch == epoch + 2  # a repeat
        told = placed.told
        # A map that was made of this place takes the place of the present one.
        stack.host.inject(t.MAP_REQUEST, msg.MapRequest(action="full"))
        prior = msg.MapPrior(header=header(stack.now, MAP), id="sha256:0123456789abcdef", map=[placed.map])
        stack.host.inject(t.MAP_PRIOR, prior)
        stack.run(1.0)
        status = stack.newest[t.MAP_STATUS]
        assert (status.prior, status.epoch, status.warning) == (prior.id, epoch + 3, "")
        assert "the map was loaded" in status.detail
        # It drives to where it is told in the new frame; while it moves its pose is not taken.
        x, y, yaw = placed.truth
        stack.send_goal(x + 1.2 * math.cos(yaw), y + 1.2 * math.sin(yaw))
        stack.run_until(lambda: stack.newest[t.ODOM].twist.twist.linear.x > 0.2, 20.0, "motion")
        placed.say(0.0, 0.0, 0.0)
        placed.map.header = header(1, MAP)
        stack.host.inject(t.MAP_PRIOR, msg.MapPrior(id="x", map=[placed.map]))
        assert placed.told == told
        assert stack.finish_goal(20.0).state == "reached"
        assert math.dist(placed.truth[:2], (x + 1.2 * math.cos(yaw), y + 1.2 * math.sin(yaw))) < 0.25
        assert stack.newest[t.MAP_STATUS].prior == prior.id
        # A restarted odometry keeps what it was told.
        stack.kill("odometry")
        stack.run(0.3)
        stack.restart("odometry")
        stack.run(1.0)
        assert placed.here == pytest.approx(placed.truth, abs=0.1)
        # A goal that waits is ended by a new pose.
        stack.send_goal(x, y)
        stack.run(0.05)
        placed.say(x + 5.0, y, yaw)
        ended = stack.finish_goal(1.0)
        assert (ended.state, ended.reason) == ("aborted", "localization_lost")
