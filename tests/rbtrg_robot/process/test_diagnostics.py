"""/diagnostics tells what `status` knows, and the figures of the backend."""

from __future__ import annotations

from pathlib import Path
from typing import Any
from unittest.mock import Mock

import pytest

from hal.lidar.config import only
from hal.safety.gate import SafetyGate
from hal.types import NS
from hal.unitree.config import UnitreeConfig
from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.cli.table import render
from rbtrg_robot.process import diagnostics as module
from rbtrg_robot.process.diagnostics import ERROR, OK, STALE, WARN, Diagnosis
from rbtrg_robot.process.health import Health
from rbtrg_robot.process.supervisor import Supervisor
from rbtrg_robot.stages.robot import STEP_PERIOD, RobotStage
from rbtrg_robot.wire.messages import decode, encode
from tests.hal.unitree.robot import LOW_STATE_RATE
from tests.hal.unitree.world import World
from tests.rbtrg_robot.process.test_broken_messages import supervisor

__all__ = ["supervisor"]

ROBOT = {
    "mode": "ready", "cause": "", "estop": False, "estop_cause": "", "hold": "", "battery": 0.8, "realtime_factor": 1.0,
    "refused": {"stale": 3}, "localization": "good", "localization_reason": "", "map_warning": "",
    "x": 1.0, "y": 2.0, "z": 0.4, "yaw": 0.1, "speed": 0.2, "yaw_rate": 0.3, "pose_age": 0.01, "location": "found",
    "tracker": "tracking", "tracker_hold": "", "tracker_slow": "a slope",
    "goal": {"id": "g1", "state": "moving", "reason": "", "detail": "", "x": 4.0, "y": 0.0, "distance_left": 3.0,
    "replans": 1, "recoveries": 2, "p_fail": 0.02, "chance": "98 % to arrive"},
    "advice": {"late telemetry": "check the cable"},
    "calibration": "", "lidars": {"main": {"time_offset": 0.0101, "sigma": 0.0002, "applied": 0.0098}},
}  # fmt: skip


def status(state: str = "ready", age: float | None = 0.1, ok: bool = True, **robot: Any) -> dict[str, Any]:
    names = ("robot", "odometry", "elevation", "navigator", "tracker", "mission")
    row = {"pid": 7, "restarts": 0, "cpu": 1.0, "memory_mb": 2.0, "dropped": 0, "refused": 0, "detail": ""}
    return {
        "version": "1",
        "pid": 6,
        "ready": True,
        "uptime": 9.0,
        "log_dir": "/logs/run",
        "refused": 0,
        "processes": [{"process": name, "state": state, "heartbeat_age": age, **row} for name in names],
        "topics": [{"topic": "/odom", "rate": 9.7, "nominal": 10, "age": None, "ok": ok}],
        "robot": ROBOT | robot,
    }


def levels(found: dict[str, Any]) -> dict[str, int]:
    message = Diagnosis("rex").message(found, 5 * NS)
    back = decode(encode(message), msg.DiagnosticArray)
    assert {entry.hardware_id for entry in back.status} == {"rex"}
    return {entry.name.removeprefix("rbtrg: "): entry.level for entry in back.status}


ALL_WELL = {
    **{f"process {name}": OK for name in ("robot", "odometry", "elevation", "navigator", "tracker", "mission")},
    "stack": OK, "topics": OK, "robot": OK, "odometry": OK, "map": OK, "network": OK,
    "goal": OK, "tracker": OK, "mission": OK,
}  # fmt: skip


@pytest.mark.parametrize(
    ("found", "differs"),
    [
        (status(), {}),
        (status(ok=False), {"topics": WARN}),
        (status(mode="fault"), {"robot": ERROR}),
        (status(estop=True), {"robot": WARN}),
        (status(mode="sitting"), {}),
        (status(localization="degraded"), {"odometry": WARN}),
        (status(localization="lost"), {"odometry": ERROR}),
        (status(calibration="the stamps are off"), {"odometry": WARN}),
        (status(map_warning="the prior map does not fit"), {"map": WARN}),
        (status(age=5.0), dict.fromkeys([n for n in ALL_WELL if n not in ("stack", "topics", "network")], STALE)),
        (
            status(state="failed: no scene", age=None),
            {**dict.fromkeys([n for n in ALL_WELL if n.startswith("process")], ERROR),
            **dict.fromkeys(("robot", "odometry", "map", "goal", "tracker", "mission"), STALE)},
        ),
        (status(tracker_hold="/odom is 0.9 s old"), {"tracker": WARN}),
        (status(goal=ROBOT["goal"] | {"state": "aborted", "reason": "stuck"}), {"goal": WARN}),
    ],
)  # fmt: skip
def test_levels(found: dict[str, Any], differs: dict[str, int]) -> None:
    assert levels(found) == ALL_WELL | differs


def test_nothing_heard_yet_is_stale() -> None:
    found = status(state="starting", age=None)
    found["robot"] = {"realtime_factor": None}
    told = levels(found)
    assert (told["robot"], told["odometry"], told["map"]) == (STALE, STALE, STALE)
    assert told["process robot"] == WARN


def test_values_are_those_of_status() -> None:
    entries = {e.name: e for e in Diagnosis("rex").message(status(), 0).status}
    assert {p.key: p.value for p in entries["rbtrg: topics"].values} == {"/odom": "9.7 of 10 Hz"}
    clock = {p.key: p.value for p in entries["rbtrg: odometry"].values}
    assert clock["main time_offset [ms]"] == "10.10"
    body = {p.key: p.value for p in entries["rbtrg: robot"].values}
    assert (body["battery"], body["refused: stale"]) == ("0.8", "3")
    assert body["advice: late telemetry"] == "check the cable"


MISSION = {"name": "round", "phase": "paused", "reason": "by hand", "step": 2, "steps": 5, "question": "on?"}
ELSEWHERE = (
    "backend",
    "map_warning",
    "localization",
    "localization_reason",
    "calibration",
    "mode",
    "tracker",
)
"""Of the robot's own entry in /diagnostics, or in the words of an entry instead of its values."""


def test_everything_that_status_knows_of_the_robot_is_told() -> None:
    health = Health(simulated=False)
    for topic in Health.WATCHED:
        health.take(topic, topic.kind())
    health.take(t.MISSION_STATE, msg.MissionState(order_id="o", phase="paused"))
    known = health.robot_row()
    told = Diagnosis("rex").message(status(mission=MISSION), 0).status
    keys = {pair.key for entry in told for pair in entry.values}
    for key, value in known.items():
        if key in ("goal", "mission"):
            assert set(value) <= keys, key
        elif key not in (*ELSEWHERE, "lidars", "refused", "advice"):
            assert key.removeprefix("tracker_") in keys, key
    words = {entry.name.removeprefix("rbtrg: "): entry.message for entry in told}
    assert words["mission"] == "paused: by hand: on?"
    assert words["tracker"] == "tracking"


def test_datagrams_lost_for_want_of_a_buffer_are_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "SNMP", tmp_path / "snmp")
    diagnosis = Diagnosis("rex")

    def network() -> tuple[int, str]:
        entry = next(e for e in diagnosis.message(status(), 0).status if e.name == "rbtrg: network")
        return entry.level, entry.message

    assert network()[0] == STALE
    for lost, level in ((40, OK), (40, OK), (43, WARN), (43, OK)):
        names = "Udp: InDatagrams NoPorts InErrors OutDatagrams RcvbufErrors"
        module.SNMP.write_text(f"Tcp: a\nTcp: 1\n{names}\nUdp: 9 8 7 6 {lost}\n")
        assert network()[0] == level, lost
    assert diagnosis._lost == 43


def test_the_robot_process_tells_the_figures_of_its_backend_once_a_second() -> None:
    world = World(options=UnitreeConfig(lidars=only("xt16")))
    gate = SafetyGate(world.backend.capabilities)
    stage = RobotStage(world.backend, gate, simulated=False, watched=frozenset())
    stage.warm_up()

    def run(seconds: float) -> list[Any]:
        told = []
        for _ in range(round(seconds * NS / STEP_PERIOD)):
            world.advance(STEP_PERIOD / NS)
            told += [message for topic, message in stage.tick(world.now) if topic is t.DIAGNOSTICS]
        return [array.status[0] for array in told]

    calm = run(3.0)
    assert len(calm) == 3
    figures = {pair.key: pair.value for pair in calm[-1].values}
    assert abs(float(figures["low_state_clock_offset"]) * NS - world.epoch) < 0.1 * NS
    assert figures["lidar_main_missed"] == "0"
    assert [entry.level for entry in calm] == [OK] * 3
    world.faults.garbage = True
    entry = run(2.0)[-1]
    assert entry.level == WARN
    assert "unreadable rt/lowstate" in entry.message


def test_how_well_the_link_to_the_robot_is_is_told() -> None:
    world = World(options=UnitreeConfig(lidars=only("xt16")), rate=LOW_STATE_RATE)
    world.backend.connect()
    world.backend.diagnostics()
    world.run(1.0)
    well = world.backend.diagnostics()
    assert well["low_state_rate"] == pytest.approx(500.0, rel=0.05)
    assert well["low_state_gaps"] == 0
    world.faults.low_silent = True
    world.run(0.1)
    world.faults.low_silent = False
    world.run(0.9)
    ill = world.backend.diagnostics()
    assert ill["low_state_rate"] == pytest.approx(450.0, rel=0.05)
    assert ill["low_state_gaps"] == 1
    assert isinstance(ill["low_state_gaps"], int), "a counter that rises is a warning"


def test_sweeps_that_never_came_are_counted() -> None:
    world = World(options=UnitreeConfig(lidars=only("xt16")))
    world.backend.connect()
    world.run(1.0)
    world.faults.lidar_silent = True
    world.run(0.5)
    world.faults.lidar_silent = False
    world.run(1.0)
    assert world.backend.diagnostics()["lidar_main_missed"] in (4, 5)


def test_status_shows_the_figures_of_the_backend_and_the_supervisor_publishes_the_rest(
    supervisor: Supervisor,
) -> None:
    entry = msg.DiagnosticStatus(
        name=t.BACKEND_FIGURES, values=[msg.KeyValue(key="late_responses", value="3")]
    )
    other = msg.DiagnosticStatus(name="rbtrg: map")
    bus: Any = supervisor._bus
    bus.put(t.DIAGNOSTICS, encode(msg.DiagnosticArray(status=[entry, other])))
    supervisor._turn(Mock())
    supervisor._turn(Mock())
    found = supervisor.status()
    assert found["robot"]["backend"] == {"late_responses": "3"}
    assert any("backend: late_responses 3" in str(part) for part in render(found).renderables)
    (published,) = bus.published  # once a second
    assert published[0] is t.DIAGNOSTICS
    assert {"rbtrg: process robot", "rbtrg: topics"} <= {e.name for e in published[1].status}
