"""A topic that belongs to a process is taken from that process alone, and the operator reads who else publishes it."""

from __future__ import annotations

import time
from collections.abc import Iterator
from itertools import count

import pytest

from hal.safety.monitors import STRANGER, raised, taken_out
from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.process.events import Events
from rbtrg_robot.process.health import Health
from rbtrg_robot.processes import PROCESSES, SUPERVISOR
from rbtrg_robot.topics import Topic
from rbtrg_robot.wire import keys
from rbtrg_robot.wire.bus import Bus
from rbtrg_robot.wire.heart import Heart
from rbtrg_robot.wire.messages import encode
from rbtrg_robot.wire.session import stack_id
from tools.bench.ports import free_endpoint

STACK = stack_id()
OWNED = [topic for topic in t.TOPICS if topic.owner]
TOLD = [topic for topic in OWNED if not topic.shared]
LIMIT = 10.0


@pytest.fixture(scope="module")
def endpoint() -> Iterator[str]:
    """Where the router of a stack listens."""
    where = free_endpoint()
    with Bus(where, "supervisor", router=True, stack=STACK):
        yield where


@pytest.fixture
def robot(endpoint: str) -> Iterator[Bus]:
    """A process of the stack that hears everything."""
    with Bus(endpoint, "robot", stack=STACK) as bus:
        bus.subscribe(t.TOPICS)
        yield bus


def say(bus: Bus, topic: Topic) -> None:
    """A message once somebody listens: before, it goes nowhere, but for one that late joiners get."""
    publisher = bus.advertise(topic)
    end = time.monotonic() + LIMIT
    while topic.qos is not t.Qos.LATCHED and not publisher.wanted:
        assert time.monotonic() < end
        time.sleep(0.005)
    publisher.put(encode(topic.kind()), 1)


def heard(bus: Bus, topic: Topic, number: int = 1) -> list[str]:
    """Senders of the first messages on a topic."""
    got: list[str] = []
    end = time.monotonic() + LIMIT
    while len(got) < number:
        assert time.monotonic() < end, f"{topic}: {len(got)} of {number}"
        got += [received.sender for received in bus.take(0.1) if received.topic is topic]
    return got


def test_every_topic_of_a_process_is_refused_from_others_and_taken_from_it(endpoint: str, robot: Bus) -> None:
    assert {t.MOTION_LIMITS, t.CMD_VEL, t.PATH_COMMAND, t.POSE, t.ODOM, t.TF_STATIC, t.PLAN} < set(OWNED)
    assert {t.EVENTS, t.HEARTBEAT, t.JOURNAL, t.DIAGNOSTICS} < set(OWNED)
    owners = {t.STACK, SUPERVISOR, *(p.name for p in PROCESSES)}
    assert all(topic.owner in owners and topic.publish_by is None for topic in OWNED)
    with Bus(endpoint, "somebody") as stranger:
        for topic in OWNED:
            say(stranger, topic)
        say(stranger, t.GOAL_REQUEST)  # anybody's; it comes after the others of its session
        heard(robot, t.GOAL_REQUEST)
        end = time.monotonic() + LIMIT
        while robot.refused < len(TOLD):
            assert time.monotonic() < end
            assert robot.take(0.1) == []
        assert robot.refused == len(TOLD)
    for topic in OWNED:
        name = SUPERVISOR if topic.owner == t.STACK else topic.owner
        with Bus(endpoint, name, stack=STACK) as owner:
            say(owner, topic)
            heard(robot, topic)
    assert robot.refused == len(TOLD)


@pytest.mark.parametrize(
    ("node", "stack"),
    [("guard", ""), ("guard", stack_id()), ("tracker", STACK)],
    ids=["name", "stack", "process"],
)
def test_neither_a_name_nor_another_stack_nor_another_process_makes_an_owner(
    endpoint: str, robot: Bus, node: str, stack: str
) -> None:
    with Bus(endpoint, node, stack=stack) as other, Bus(endpoint, "guard", stack=STACK) as guard:
        say(other, t.MOTION_LIMITS)
        while not robot.refused:
            robot.take(0.1)
        say(guard, t.MOTION_LIMITS)
        assert heard(robot, t.MOTION_LIMITS)
        assert robot.refused == 1


def test_a_forged_heartbeat_hides_no_process_that_hangs(endpoint: str) -> None:
    health, beat = Health(simulated=True), msg.Heartbeat(process="planner", state="ready")
    with (
        Bus(endpoint, "supervisor", stack=STACK) as supervisor,
        Bus(endpoint, "planner") as forger,
        Bus(endpoint, "planner", stack=STACK) as planner,
    ):
        supervisor.subscribe([t.HEARTBEAT])
        for bus, taken in ((forger, set()), (planner, {"planner"})):
            say(bus, t.HEARTBEAT)  # of a process without a name
            bus.publish(t.HEARTBEAT, beat, 2)
            end = time.monotonic() + LIMIT
            while supervisor.refused < 2 or health.beats.keys() != taken:
                assert time.monotonic() < end
                for received in supervisor.take(0.05):
                    health.take(received.topic, received.decode())
        assert supervisor.refused == 2


def test_an_owner_that_was_started_anew_is_taken_at_once_and_is_another_sender(
    endpoint: str, robot: Bus
) -> None:
    senders = []
    for _ in range(2):
        with Bus(endpoint, "guard", stack=STACK) as guard:
            say(guard, t.MOTION_LIMITS)
            senders += heard(robot, t.MOTION_LIMITS)
    assert len(set(senders)) == 2
    assert robot.refused == 0


def test_what_a_stack_does_without_and_a_program_outside_of_it_take_from_everybody(endpoint: str) -> None:
    with (
        Bus(endpoint, "robot", stack=STACK, absent=("tracker",)) as robot,
        Bus(endpoint, "cli") as cli,
        Bus(endpoint, "own_controller") as other,
    ):
        for bus in (robot, cli):
            bus.subscribe([t.CMD_VEL])
        say(other, t.CMD_VEL)
        other.publish(t.CMD_VEL, msg.TwistStamped(), 2)
        assert heard(robot, t.CMD_VEL)
        assert heard(cli, t.CMD_VEL)


def test_the_operator_reads_who_it_is_once(endpoint: str, robot: Bus) -> None:
    heart, said = Heart(robot, "robot"), list[str]()
    events, health = Events(said.append), Health(simulated=True)
    with Bus(endpoint, "supervisor", stack=STACK) as supervisor, Bus(endpoint, "mischief") as stranger:
        supervisor.subscribe([t.HEARTBEAT])
        end = time.monotonic() + LIMIT
        for number in count():
            say(stranger, t.MOTION_LIMITS)
            heart.beat()
            for received in supervisor.take(0.05):
                events.take(received.topic, message := received.decode())
                health.take(received.topic, message)
            if number > 40 and said:
                break
            assert time.monotonic() < end
        session = stranger.session.zid()
    end = time.monotonic() + LIMIT
    while robot._strangers:
        assert time.monotonic() < end
        time.sleep(0.005)
    assert robot.intrusion() == said[0], "it has left, and is still to be found"
    assert said == [
        f"/guard/limits also comes from mischief (session {session}), which is refused: it belongs to guard"
    ]
    assert raised(said[0]) == [STRANGER]
    assert health.robot_row()["advice"] == {"stranger": STRANGER.remedy}


def test_without_the_monitor_the_stranger_is_believed(endpoint: str, robot: Bus) -> None:
    with taken_out("stranger"), Bus(endpoint, "somebody") as stranger:
        say(stranger, t.MOTION_LIMITS)
        assert heard(robot, t.MOTION_LIMITS)


def test_a_proof_stands_in_our_attachments_alone() -> None:
    proof = keys.proof(STACK, "guard")
    gid = keys.gid("token", "key", proof)
    assert len(gid) == 16
    assert keys.proof_of(keys.attachment(1, 2, gid)) == proof
    assert keys.proof_of(keys.attachment(1, 2, gid[:8] + bytes(8))) == b""
    assert keys.proof_of(b"") == b""
    assert keys.mark("key") == gid[8:]
