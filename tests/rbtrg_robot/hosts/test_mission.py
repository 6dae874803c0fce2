"""A mission in the closed loop on flat ground: the process dies on the way, and the robot is stopped."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.config import load
from rbtrg_robot.hosts.lockstep import Lockstep
from rbtrg_robot.hosts.offline import rerun
from rbtrg_robot.log.read import read_run
from rbtrg_robot.topics import Topic
from rbtrg_robot.wire.convert import yaw_of
from rbtrg_robot.wire.messages import decode
from tests.rbtrg_robot.stages.mission.test_executor import goto, order, step


class Run:
    """A stack, and what its mission says."""

    def __init__(self, stack: Lockstep) -> None:
        self.stack = stack
        self.state = msg.MissionState()
        self.phases: list[str] = []
        self.asked = 0
        stack.host.listen(self._note)

    def _note(self, topic: Topic, payload: bytes, _now: int) -> None:
        if topic is t.MISSION_STATE:
            self.state = decode(payload, msg.MissionState)
            if self.phases[-1:] != [self.state.phase]:
                self.phases.append(self.state.phase)

    def ask(self, action: str, **fields: object) -> None:
        self.asked += 1
        request = msg.MissionRequest(id=str(self.asked), owner="test", action=action, **fields)  # type: ignore[arg-type]
        self.stack.host.inject(t.MISSION_REQUEST, request)
        assert (self.state.request, self.state.refused) == (str(self.asked), "")

    def until(self, phase: str, timeout: float = 40.0) -> None:
        self.stack.run_until(lambda: self.state.phase == phase, timeout, f"a {phase} mission")

    @property
    def truth(self) -> tuple[float, float, float]:
        pose = self.stack.newest[t.TRUTH].pose.pose
        return pose.position.x, pose.position.y, yaw_of(pose.orientation)

    @property
    def speed(self) -> float:
        twist = self.stack.newest[t.TRUTH].twist.twist.linear
        return math.hypot(twist.x, twist.y)


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Down, up and to a place; on the way there the mission process is killed and the robot is stopped."""
    path = tmp_path_factory.mktemp("mission") / "log_0.mcap"
    config = load(None, ["sim.lidar_step=8"], scene="flat")
    with Lockstep(config, Lockstep.open_log(config, path)) as stack:
        stack.wait_ready()
        run = Run(stack)
        stack.run(1.1)
        x, y, yaw = run.truth
        ahead = (x + 1.0 * math.cos(yaw), y + 1.0 * math.sin(yaw))
        run.ask("run", order=order(step("sit"), step("stand"), goto(ahead[0], y=ahead[1])))
        stack.run_until(lambda: stack.newest[t.ROBOT_STATE].phase == "sitting", 10.0, "sitting")
        stack.run_until(lambda: run.speed > 0.2, 20.0, "motion")
        goal = stack.newest[t.GOAL_STATUS].id
        stack.kill("mission")
        stack.run(0.3)
        assert run.speed > 0.1  # the navigator has the goal
        stack.restart("mission")
        stack.run(0.2)
        assert stack.newest[t.GOAL_STATUS].id == goal
        assert run.state.phase == "running"
        stack.command("stop", "test")
        run.until("paused", 0.1)
        assert "emergency stop" in run.state.reason
        stack.run(0.5)
        stack.command("resume")
        stack.run(0.5)
        assert run.state.phase == "paused"
        assert run.speed < 0.05
        run.ask("resume")
        run.until("finished")
        assert math.dist(run.truth[:2], ahead) < 0.25
        assert run.state.action_status == ["FINISHED"] * 3
        stack.run(0.3)
    return path


def states(path: Path) -> list[bytes]:
    return [e.data for e in read_run(path) if e.topic == t.MISSION_STATE.name]


def test_a_mission_goes_on_through_a_death_and_only_on_command_after_a_stop(log: Path) -> None:
    phases = [decode(data, msg.MissionState).phase for data in states(log)]
    assert list(dict.fromkeys(phases)) == ["idle", "running", "paused", "finished"]


def test_the_mission_can_be_run_again_from_the_log(log: Path, tmp_path: Path) -> None:
    rerun(log, ["mission"], tmp_path / "again.mcap")
    again = [decode(data, msg.MissionState) for data in states(tmp_path / "again.mcap")]
    assert again[-1].action_status == ["FINISHED"] * 3
    assert [s.phase for s in again].count("paused") >= 1


@pytest.mark.campaign
def test_without_an_operator_in_contact_the_robot_stands_or_drives_home() -> None:
    with Lockstep(load(None, ["sim.lidar_step=8"], scene="flat")) as stack:
        stack.wait_ready()
        run = Run(stack)
        stack.run(1.1)
        start = run.truth
        x, y, yaw = start
        ahead = (x + 2.0 * math.cos(yaw), y + 2.0 * math.sin(yaw))

        def begin(loss: str) -> None:
            there = goto(ahead[0], y=ahead[1])
            run.ask("run", order=order(there, order_id=loss, on_comms_loss=loss, comms_timeout=1.0))

        begin("hold")
        stack.run(0.7)
        stack.host.inject(t.PRESENCE, msg.Presence(owner="test"))
        stack.run_until(lambda: run.speed > 0.2, 3.0, "motion")
        run.until("holding", 1.5)
        stack.run(0.7)
        assert run.speed < 0.05
        stack.host.inject(t.PRESENCE, msg.Presence(owner="test"))
        stack.run(0.2)
        assert run.state.phase == "running"  # by itself
        run.ask("stop")
        begin("return")
        run.until("failed")
        assert "no operator in contact for 1 s; the robot is back" in run.state.reason
        assert math.dist(run.truth[:2], start[:2]) < 0.3
