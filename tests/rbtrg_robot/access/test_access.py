"""Who gets in over TLS, and what passes: a real router on loopback."""

from __future__ import annotations

import contextlib
import json
import socket
import ssl
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import zenoh
from typer.testing import CliRunner

from hal.safety.gate import SafetyGate
from hal.types import NS
from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.access import rules
from rbtrg_robot.access.certificates import KeysError
from rbtrg_robot.access.identity import CA, CERTIFICATE, CONNECT, KEY, NAME, client_tls, server_tls
from rbtrg_robot.cli import stop as module
from rbtrg_robot.cli.main import app
from rbtrg_robot.cli.stop import stop
from rbtrg_robot.config import load
from rbtrg_robot.latch import number
from rbtrg_robot.scope import ROBOT, Scope
from rbtrg_robot.stages.navigation import navigator
from rbtrg_robot.stages.robot import STEP_PERIOD, RobotStage
from rbtrg_robot.topics import Role
from rbtrg_robot.wire import keys as wire
from rbtrg_robot.wire.bus import Bus, BusError
from rbtrg_robot.wire.convert import odometry_msg
from rbtrg_robot.wire.messages import header
from rbtrg_robot.wire.session import Security
from tests.hal.unitree.world import World
from tests.rbtrg_robot.hearsay import map_offset
from tools.bench import access
from tools.bench.access import NOBODY, Site, site
from tools.bench.ports import free_port


@pytest.fixture(scope="module")
def place() -> Iterator[Site]:
    """One for all."""
    with site() as made:
        yield made


def test_a_topic_is_closed_unless_its_row_opens_it() -> None:
    """A new topic is nobody's from outside; who opens one changes this test too."""
    opened = {role: {topic.name for topic in rules.publishable(role)} for role in Role}
    assert opened[Role.OBSERVER] == {"/robot/stop"}
    assert opened[Role.OPERATOR] == access.OPERATOR_MAY - access.OBSERVER_MAY
    assert t.Topic("/new", t.CMD_VEL.kind, 0, t.Qos.STATE, 1, "", "").publish_by is None


def test_a_role_without_people_is_no_subject() -> None:
    """Zenoh refuses a subject with an empty list of names."""
    made = rules.access_control(Scope(), {Role.OPERATOR: [], Role.OBSERVER: ["observer:bob:00000000"]})
    assert [s["id"] for s in made["subjects"]] == ["local", "observer"]
    assert all(s["id"] == "local" or s["cert_common_names"] for s in made["subjects"])
    assert [p["subjects"] for p in made["policies"]] == [["local"], ["observer"]]


def test_the_rules_of_a_robot_with_a_name_open_its_own_topics_alone() -> None:
    made = rules.access_control(Scope.of(0, "a"), {})
    keys = {rule["id"]: rule["key_exprs"] for rule in made["rules"]}
    assert all(key.startswith("0/a/") for role in Role for key in keys[role.value])
    assert "0/a/rbtrg/status" in keys["ask"]
    assert "0/**" not in keys["see"] + keys["hear"]
    assert len(keys["stop"]) == 1, "the emergency stop alone needs no name"


@pytest.mark.parametrize("who", ["foreign", "robot", NOBODY])
def test_who_has_no_certificate_of_a_person_does_not_get_in(place: Site, who: str) -> None:
    with pytest.raises(BusError, match="does not let us in"):
        place.enter(who)


def test_a_person_cannot_pass_for_the_robot(place: Site) -> None:
    endpoint = f"tls/127.0.0.1:{free_port()}"
    observer = Security(client_tls(place.folders["observer"]))
    with Bus(endpoint, "robot", router=True, security=Security(server_tls(place.folders["robot"]))):
        Bus(endpoint, "cli", security=observer).close()
    with (
        Bus(endpoint, "false", router=True, security=Security(server_tls(place.folders["operator"]))),
        pytest.raises(BusError, match="does not let us in"),
    ):
        Bus(endpoint, "cli", security=observer)


@pytest.mark.parametrize("who", ["operator", "observer", "removed"])
def test_what_each_may_publish(place: Site, who: str) -> None:
    cells = access.publish(place, who)
    assert {name for name, (got, _) in cells.items() if got} == access.MAY_PUBLISH[who] & set(t.BY_NAME)
    assert len(cells) > len(t.TOPICS)


@pytest.mark.parametrize("who", ["operator", "observer", "removed"])
def test_latched_messages_and_tokens_reach_who_may_see(place: Site, who: str) -> None:
    """`**` alone matches neither."""
    sees = who != "removed"
    got = {name: got for name, (got, _) in access.look(place, who).items()}
    assert got == {"latched": sees, "tokens": sees, "status": sees, "other question": False}


@pytest.mark.parametrize("who", ["operator", "observer", "removed"])
def test_messages_reach_who_may_see(place: Site, who: str) -> None:
    with place.enter(who) as bus:
        seen = place.seen(bus, [t.IMU, t.GOAL_STATUS, t.HEARTBEAT])
    assert seen == ({"/imu/data", "/goal/status", "/heartbeat"} if who != "removed" else set())


@pytest.mark.parametrize("who", ["operator", "observer"])
def test_nobody_outside_passes_for_a_process(place: Site, who: str) -> None:
    with place.enter(who) as bus:
        assert not place.deceived(bus)


@pytest.mark.parametrize("who", ["somebody", "removed"])
def test_connections_that_say_nothing_keep_nobody_out(who: str) -> None:
    """More than Zenoh takes at a time unless it is told. Processes that were started anew, and commands, did not get in
    either."""
    with site() as place, contextlib.ExitStack() as held, place.enter("operator") as before:
        host, port = place.endpoint.partition("/")[2].split(":")
        tls = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
        tls.check_hostname = False
        tls.load_verify_locations(place.folders["removed"] / CA)
        tls.load_cert_chain(place.folders["removed"] / CERTIFICATE, place.folders["removed"] / KEY)
        for _ in range(300):
            one = socket.create_connection((host, int(port)), timeout=20.0)
            held.enter_context(one if who == "somebody" else tls.wrap_socket(one))
        with Bus(place.local, "tracker"), place.enter("observer"):
            stop = wire.key(t.ROBOT_STOP, Scope())
            assert place.arrived(before.session, [stop], b"beside them") == {stop}


def stopped(place: Site, who: str, robot: str, monkeypatch: pytest.MonkeyPatch) -> int:
    """Exit status of a stop from another computer; the robot confirms the second one it hears."""
    monkeypatch.setenv(CONNECT, place.endpoint)
    monkeypatch.setenv(NAME, str(place.folders[who]))
    end = threading.Event()

    def run() -> None:
        with Bus(place.local, "robot", place.inside.scope) as bus:
            bus.subscribe([t.ROBOT_STOP])
            heard: list[int] = []
            while not end.is_set():
                heard += [received.decode().latch for received in bus.take(0.05)]
                latch = number(10**18, heard[-1]) if len(heard) > 1 else 0
                state = t.ROBOT_STATE.kind(estop=latch > 0, estop_cause="operator", latch=latch)
                bus.publish(t.ROBOT_STATE, state, 0)

    thread = threading.Thread(target=run)
    thread.start()
    try:
        return stop(robot, patience=20.0)
    finally:
        end.set()
        thread.join()


@pytest.mark.parametrize("who", ["operator", "observer"])
def test_stop_works_from_another_computer(
    place: Site, who: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert stopped(place, who, ROBOT, monkeypatch) == 0
    assert capsys.readouterr().out == "stopped: operator\n"


def test_a_robot_with_a_name_is_stopped_by_its_name_and_by_who_knows_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    named = Site(tmp_path, "a")
    try:
        for robot in ("a", ROBOT):
            assert stopped(named, "observer", robot, monkeypatch) == 0
        assert stop("b", patience=0.5) == 1
    finally:
        named.close()


@pytest.mark.parametrize("mode", ["stop", "resume", "stand", "?"])
def test_whatever_comes_on_the_topic_that_everybody_may_use_stops(mode: str) -> None:
    world = World(epoch=0)
    gate = SafetyGate(world.backend.capabilities)
    stage = RobotStage(world.backend, gate, simulated=False, watched=frozenset())
    stage.warm_up()
    world.advance(STEP_PERIOD / NS)
    stage.tick(world.now)
    assert not gate.status().latched
    stage.on(t.ROBOT_STOP, t.ROBOT_STOP.kind(mode=mode, cause="bob"))
    world.advance(STEP_PERIOD / NS)
    stage.tick(world.now)
    assert gate.status().latched
    assert gate.status().cause.endswith("bob")
    assert t.ROBOT_STOP in stage.inputs


def test_stop_with_a_removed_certificate_says_that_nothing_was_confirmed(
    place: Site, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv(CONNECT, place.endpoint)
    monkeypatch.setenv(NAME, str(place.folders["removed"]))
    assert stop("go2w", patience=1.5) == 1
    assert "does not confirm `stop`; use the hardware stop" in capsys.readouterr().err


def test_stop_says_at_once_that_a_computer_is_silent(
    place: Site, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """It takes the connection and says nothing: Zenoh waits 10 s for it, the operator must not."""
    told: list[str] = []
    with socket.socket() as silent:
        silent.bind(("127.0.0.1", 0))
        silent.listen()
        monkeypatch.setenv(CONNECT, f"tls/127.0.0.1:{silent.getsockname()[1]}")
        monkeypatch.setenv(NAME, str(place.folders["operator"]))

        waiting = threading.Event()

        def hang_up() -> None:
            """Once the operator has been told: the rest of the 10 s need not be waited for."""
            with silent.accept()[0]:
                end = time.monotonic() + 9.0
                while not any(told) and time.monotonic() < end:
                    time.sleep(0.02)
                    told.append(capsys.readouterr().err)
                told.append(f"while it waits: {waiting.is_set()}")
                silent.close()

        opened = module._open

        def opening(endpoint: str) -> object:
            waiting.set()
            found = opened(endpoint)
            waiting.clear()
            return found

        monkeypatch.setattr(module, "_open", opening)
        ending = threading.Thread(target=hang_up)
        ending.start()
        assert stop("go2w", patience=0.5) == 1
        ending.join()
    said = "".join(told)
    assert "while it waits: True" in said
    assert "nothing answers on tls/127.0.0.1" in said
    assert "use the hardware stop" in said


@pytest.mark.parametrize("mode", ["peer", "router"])
def test_what_an_observer_may_does_not_hang_on_how_the_session_calls_itself(place: Site, mode: str) -> None:
    settings = {
        "mode": mode,
        "connect": {"endpoints": [place.endpoint], "timeout_ms": 3000, "exit_on_failure": True},
        "listen": {"endpoints": []},
        "scouting": {"multicast": {"enabled": False}},
        "transport": {"link": {"tls": client_tls(place.folders["observer"])}},
    }
    names = [wire.key(topic, Scope()) for topic in t.TOPICS]
    with zenoh.open(zenoh.Config.from_json5(json.dumps(settings))) as session:
        got = place.arrived(session, names, f"from a {mode}".encode())
    assert got <= {wire.key(t.ROBOT_STOP, Scope())}


def test_commands_work_from_another_computer(place: Site, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(CONNECT, place.endpoint)
    monkeypatch.setenv(NAME, str(place.folders["observer"]))

    def run(*words: str) -> str:
        done = CliRunner().invoke(app, words, catch_exceptions=False)
        assert done.exit_code == 0, done.output
        return done.output

    assert json.loads(run("status", "--json")) == "well"
    assert "estop" in run("topic", "echo", "/robot/state", "-n", "1")
    refused = CliRunner().invoke(app, ["cancel"])
    assert refused.exit_code == 1
    assert "whether your certificate is an operator's" in refused.output
    monkeypatch.setenv(NAME, "nobody-of-this-name")
    with pytest.raises(BusError, match="RBTRG_CERT"):
        run("status")


def test_up_refuses_to_listen_without_keys(monkeypatch: pytest.MonkeyPatch, tmp_path: object) -> None:
    from rbtrg_robot.cli.stack import _check

    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    with pytest.raises(KeysError, match="keys init"):
        _check(load(network={"listen": ["tls/0.0.0.0:7448"]}))


def test_an_operator_resumes_sends_and_cancels_from_another_computer(
    place: Site, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The commands, TLS, the router's rules, the navigator and the gate's latch, end to end."""
    monkeypatch.setenv(CONNECT, place.endpoint)
    monkeypatch.setenv(NAME, str(place.folders["operator"]))
    end = threading.Event()
    latched = RobotLatch()
    states: list[str] = []

    def serve() -> None:
        stage = navigator.build(load(None, [], scene="flat"))
        stage.on(t.TF_STATIC, map_offset(0.0, 0.0, 0.0))
        with Bus(place.local, "navigator") as bus:
            bus.subscribe([t.GOAL_REQUEST, t.ROBOT_COMMAND])
            while not end.is_set():
                stamp = header(now := bus.clock(), "map")
                still = odometry_msg(now, np.zeros(3), (0, 0, 0, 1), np.zeros(3), np.zeros(3))
                stage.on(t.ODOM, still)
                stage.on(t.ODOM_HEALTH, msg.OdometryHealth(header=stamp, health="good"))
                stage.on(t.MAP_STATUS, msg.MapStatus(header=stamp, trusted_cells=9))
                stage.on(t.TRACKER_STATE, msg.TrackerState(header=stamp))
                outputs = stage.tick(bus.clock())
                for received in bus.take(0.05):
                    message = received.decode()
                    if received.topic is t.ROBOT_COMMAND:
                        latched.take(message)
                    else:
                        outputs += stage.on(received.topic, message)
                stage.on(t.ROBOT_STATE, latched.state())
                bus.publish(t.ROBOT_STATE, latched.state(), bus.clock())
                for topic, message in outputs:
                    bus.publish(topic, message, bus.clock())
                    if topic is t.PLAN_REQUEST:
                        line = {name: np.linspace(0.0, 0.5, 11) for name in ("x", "y", "z", "yaw", "speed")}
                        whose = {"goal_id": message.goal_id, "sequence": message.sequence}
                        plan = msg.Plan(header=stamp, ok=True, reaches_goal=True, length=0.7, **whose, **line)
                        stage.on(t.PLAN, plan)
                    if topic is t.GOAL_STATUS and message.id:
                        states.append(message.state)

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        with place.enter("operator") as bus:
            deadline = time.monotonic() + 20.0
            while not latched.released and time.monotonic() < deadline:
                bus.publish(t.ROBOT_COMMAND, msg.RobotCommand(mode="resume", latch=7), bus.clock())
                bus.take(0.05)
        assert latched.released[:1] == [7]
        for words in (("goal", "1", "0.5"), ("cancel",)):
            done = CliRunner().invoke(app, words, catch_exceptions=False)
            assert done.exit_code == 0, (words, done.output)
    finally:
        end.set()
        thread.join()
    assert "cancelled" in states
    assert states[0] in ("accepted", "planning")


class RobotLatch:
    """An emergency stop with a name, as the robot process keeps it."""

    def __init__(self) -> None:
        self.name = 7
        self.released: list[int] = []

    def take(self, message: msg.RobotCommand) -> None:
        if message.mode == "resume" and message.latch == self.name:
            self.released.append(self.name)
            self.name = 0

    def state(self) -> msg.RobotState:
        return msg.RobotState(phase="ready", estop=bool(self.name), latch=self.name)
