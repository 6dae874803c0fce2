"""The Foxglove door, seen by a client of the protocol."""

from __future__ import annotations

import errno
import json
import math
import socket
import struct
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from typing import Any

import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from websockets.exceptions import InvalidStatus
from websockets.sync.client import ClientConnection, connect

from hal.robots import describe, urdf
from hal.types import NS
from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.bridge.foxglove import BACK, BridgeError, Foxglove
from rbtrg_robot.bridge.foxglove import Client as Waiting
from rbtrg_robot.latch import number
from rbtrg_robot.topics import Topic
from rbtrg_robot.wire.bus import Bus
from rbtrg_robot.wire.convert import odometry_msg
from rbtrg_robot.wire.messages import array, decode, encode, header
from tests.rbtrg_robot.strangers import ended, until
from tools.bench.ports import free_endpoint

LIMIT = 20.0


class Door:
    """A bus with the server on it."""

    def __init__(self, commands: bool) -> None:
        endpoint = free_endpoint()
        self.said: list[str] = []
        self.spoke = threading.Event()
        self._entered = ExitStack()
        self.bus = Bus(endpoint, "stack", router=True)
        self._own = Bus(endpoint, "foxglove")
        self.server = Foxglove(self._own, port=0, commands=commands, origins=["http://mine:1"], say=self._say)
        self._done = threading.Event()
        self.failed: list[BridgeError] = []
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        try:
            self.server.run(self._done.is_set)
        except BridgeError as error:
            self.failed.append(error)

    def _say(self, line: str) -> None:
        self.said.append(line)
        self.spoke.set()

    def close(self) -> None:
        self._done.set()
        self._thread.join()
        self._entered.close()
        self._own.close()
        self.bus.close()

    def enter(self, origin: str | None = None) -> Client:
        uri = f"ws://127.0.0.1:{self.server.port}"
        settings: Any = {"subprotocols": ["foxglove.sdk.v1"], "origin": origin}
        return Client(self._entered.enter_context(connect(uri, **settings)))

    def knock(self, says: bytes) -> socket.socket:
        """Somebody who never asks to come in."""
        stranger = self._entered.enter_context(
            socket.create_connection(("127.0.0.1", self.server.port), LIMIT)
        )
        stranger.sendall(says)
        stranger.setblocking(False)
        return stranger

    def listen(self, *wanted: Topic) -> None:
        """Subscribe, and wait until the server's session knows of it: Zenoh sends nothing for which it knows no
        listener."""
        self.bus.subscribe(wanted)
        for topic in wanted:
            if topic in BACK:
                until(lambda topic=topic: self._own.publishers[topic].wanted)  # type: ignore[misc]

    def heard(self, topic: Topic) -> Any:
        end = time.monotonic() + LIMIT
        while time.monotonic() < end:
            for received in self.bus.take(0.05):
                if received.topic is topic:
                    return self.bus.open(received)
        raise AssertionError(f"nothing on {topic}")


class Client:
    """Speaks the protocol."""

    def __init__(self, connection: ClientConnection) -> None:
        self.connection = connection
        self.info = self.control("serverInfo")
        self.channels = {c["topic"]: c for c in self.control("advertise")["channels"]}

    def send(self, **request: Any) -> None:
        self.connection.send(json.dumps(request))

    def control(self, op: str) -> Any:
        end = time.monotonic() + LIMIT
        while time.monotonic() < end:
            data = self.connection.recv(timeout=LIMIT)
            if isinstance(data, str) and json.loads(data)["op"] == op:
                return json.loads(data)
        raise AssertionError(op)

    def subscribe(self, number: int, topic: Topic) -> None:
        channel = self.channels[topic.name]["id"]
        self.send(op="subscribe", subscriptions=[{"id": number, "channelId": channel}])

    def data(self, number: int, timeout: float = LIMIT) -> tuple[int, bytes]:
        """Stamp [ns] and payload of the next message of a subscription."""
        end = time.monotonic() + timeout
        while time.monotonic() < end:
            frame = self.connection.recv(timeout=timeout)
            if isinstance(frame, bytes) and frame[0] == 1:
                _, got, stamp = struct.unpack_from("<BIQ", frame)
                if got == number:
                    return stamp, frame[13:]
        raise TimeoutError

    def publish(self, number: int, topic: Topic, message: Any, **other: str) -> None:
        channel = {"id": number, "topic": topic.name, "encoding": "cdr", "schemaName": topic.type} | other
        self.send(op="advertise", channels=[channel])
        self.connection.send(struct.pack("<BI", 1, number) + encode(message))


@pytest.fixture
def door() -> Iterator[Door]:
    made = Door(commands=True)
    try:
        yield made
    finally:
        made.close()


def test_a_client_gets_the_bytes_of_the_bus_and_can_read_their_types(door: Door) -> None:
    client = door.enter()
    assert client.info["metadata"]["ROS_DISTRO"]
    assert set(client.channels) == set(t.BY_NAME)
    for name, channel in client.channels.items():
        assert (channel["encoding"], channel["schemaEncoding"]) == ("cdr", "ros2msg")
        assert channel["schemaName"] == t.BY_NAME[name].type
        # An independent reader of the schema knows the type.
        first, *others = channel["schema"].split("=" * 80 + "\n")
        kinds = get_types_from_msg(first, channel["schemaName"])
        for other in others:
            title, body = other.split("\n", 1)
            kinds |= get_types_from_msg(body, title.removeprefix("MSG: ").replace("/", "/msg/", 1))
        store = get_typestore(Stores.EMPTY)
        store.register(kinds)
        assert channel["schemaName"] in store.types
    client.subscribe(7, t.ODOM)
    odom = odometry_msg(123_000_000_456, (1.0, 2.0, 0.0), (0.0, 0.0, 0.0, 1.0), (0.0,) * 3, (0.0,) * 3)
    done = threading.Event()

    def drive() -> None:
        while not done.wait(0.02):
            door.bus.publish(t.ODOM, odom, 123_000_000_456)

    thread = threading.Thread(target=drive)
    thread.start()
    try:
        assert client.data(7) == (123_000_000_456, encode(odom))
        client.send(op="unsubscribe", subscriptionIds=[7])
    finally:
        done.set()
        thread.join()


def test_the_app_sees_the_legs_move(door: Door) -> None:
    client = door.enter()
    client.subscribe(1, t.TF)
    door.bus.publish(t.DESCRIPTION, msg.String(data=urdf(describe())), 1)
    state = msg.JointState(header=header(NS, "base_link"), name=["FL_hip"], position=array([0.4], "float64"))
    door.bus.publish(t.TF, msg.TFMessage(), 1)
    end = time.monotonic() + LIMIT
    payload = b""
    while b"FL_hip" not in payload:
        assert time.monotonic() < end
        door.bus.publish(t.JOINTS, state, NS)
        with suppress(TimeoutError):
            _, payload = client.data(1, 0.2)
    frames = {x.child_frame_id: x for x in decode(payload, msg.TFMessage).transforms}
    assert frames["FL_hip"].transform.rotation.x == pytest.approx(math.sin(0.2))
    assert frames["FL_hip"].header.frame_id == "base_link"


def test_who_comes_late_gets_what_is_told_once(door: Door) -> None:
    door.bus.publish(t.GOAL_STATUS, msg.GoalStatus(header=header(5, "map"), state="idle"), 5)
    for _ in range(2):
        client = door.enter()
        client.subscribe(1, t.GOAL_STATUS)
        assert client.data(1)[0] == 5


def test_a_goal_goes_back_and_what_drives_does_not(door: Door) -> None:
    door.listen(t.GOAL_POSE, t.CMD_VEL)
    client = door.enter()
    pose = msg.PoseStamped(header=header(9, "map"))
    pose.pose.position.x = 3.5
    client.publish(1, t.CMD_VEL, msg.TwistStamped())
    assert "/cmd_vel is not taken" in client.control("status")["message"]
    assert "not advertised" in client.control("status")["message"]
    client.publish(2, t.GOAL_POSE, pose, schemaName="nav_msgs/msg/Path")
    assert "geometry_msgs/msg/PoseStamped" in client.control("status")["message"]
    client.connection.send(b"\x01")
    client.connection.send("{")
    client.publish(3, t.GOAL_POSE, pose)
    assert door.heard(t.GOAL_POSE).pose.position.x == 3.5
    client.connection.send(struct.pack("<BI", 1, 3) + b"\0\1\0\0no pose")
    for _ in range(4):
        status = client.control("status")
    assert "not a geometry_msgs/msg/PoseStamped" in status["message"]


def test_a_goal_that_nobody_takes_is_told(door: Door) -> None:
    client = door.enter()
    client.publish(1, t.GOAL_POSE, msg.PoseStamped())
    assert "nobody takes /goal_pose" in client.control("status")["message"]


def test_a_stop_is_sent_until_the_robot_confirms_it(door: Door) -> None:
    door.bus.subscribe([t.ROBOT_STOP])
    client = door.enter()
    client.publish(1, t.ROBOT_STOP, msg.RobotCommand(mode="stop", cause="Foxglove"))
    for _ in range(3):
        stop = door.heard(t.ROBOT_STOP)
        assert stop.cause == "Foxglove"
    end = time.monotonic() + LIMIT
    latch = number(10**18, stop.latch)
    while not door.spoke.wait(0.05):
        door.bus.publish(t.ROBOT_STATE, msg.RobotState(estop=True, estop_cause="Foxglove", latch=latch), 1)
        assert time.monotonic() < end
    assert door.said == ["stopped: Foxglove"]


def test_no_other_web_page_gets_in(door: Door) -> None:
    with pytest.raises(InvalidStatus):
        door.enter("http://evil.example")
    assert door.said == [
        "refused a web page of http://evil.example; if it is yours: --origin http://evil.example"
    ]
    for origin in ("https://app.foxglove.dev", "http://mine:1"):
        assert door.enter(origin).channels


def test_who_only_looks_may_stop_and_nothing_else() -> None:
    door = Door(commands=False)
    try:
        door.bus.subscribe([t.ROBOT_STOP])
        client = door.enter()
        client.publish(1, t.GOAL_POSE, msg.PoseStamped())
        assert "/goal_pose is not taken" in client.control("status")["message"]
        client.publish(2, t.ROBOT_STOP, msg.RobotCommand(mode="stop"))
        assert door.heard(t.ROBOT_STOP).mode == "stop"
    finally:
        door.close()


def test_a_client_that_hangs_holds_up_nobody(door: Door) -> None:
    hanging, client = door.enter(), door.enter()
    for each in (hanging, client):
        each.subscribe(1, t.POINTS)
    cloud = msg.PointCloud2(data=msg._zeros("uint8", 400_000))
    for stamp in range(1, 60):  # 24 MB: more than the buffers of a connection hold
        end, got = time.monotonic() + LIMIT, 0
        while got < stamp:
            door.bus.publish(t.POINTS, cloud, stamp)
            with suppress(TimeoutError):
                got = client.data(1, timeout=0.5)[0]
            assert time.monotonic() < end
    hanging.connection.socket.close()


def test_for_a_slow_client_the_newest_messages_wait_and_no_others() -> None:
    class Slow:
        def __init__(self) -> None:
            self.got: list[bytes] = []

        def send(self, frame: bytes) -> None:
            self.got.append(frame)
            client.close()  # it takes one look

    slow = Slow()
    client = Waiting(slow)  # type: ignore[arg-type]
    for k in range(100):
        client.put(1, b"cloud %d" % k, 1)
    client.send_all()
    assert slow.got == [b"cloud 99"]


@pytest.mark.parametrize("says", [b"", b"GET / HTTP/1.1\r\nHost: x"], ids=["silent", "half a request"])
def test_a_flood_of_strangers_keeps_no_client_out(
    door: Door, says: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(door.server.listener, "strangers", 6)
    here = door.enter()
    strangers = [door.knock(says) for _ in range(20)]
    until(lambda: sum(not ended(stranger) for stranger in strangers) <= 6)
    door.bus.subscribe([t.ROBOT_STOP])
    for client in (door.enter(), here):
        client.publish(1, t.ROBOT_STOP, msg.RobotCommand(mode="stop", cause="Foxglove"))
        assert door.heard(t.ROBOT_STOP).cause == "Foxglove"


def test_too_many_clients_are_refused_in_words_and_who_is_in_stays(
    door: Door, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(door.server.listener, "guests", 2)
    first, second = door.enter(), door.enter()
    with pytest.raises(InvalidStatus) as refused:
        door.enter()
    assert refused.value.response.status_code == 503
    assert b"close some" in refused.value.response.body
    assert door.said == ["refused a client: 2 are connected"]
    door.bus.publish(t.GOAL_STATUS, msg.GoalStatus(header=header(5, "map"), state="idle"), 5)
    first.subscribe(1, t.GOAL_STATUS)
    assert first.data(1)[0] == 5
    second.connection.close()
    until(lambda: door.server.listener.connected == 1)
    assert door.enter().channels


def test_a_client_that_leaves_at_once_is_no_fault(
    door: Door, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    left = threading.Event()

    def late() -> list[Any]:
        assert left.wait(LIMIT)
        return []

    monkeypatch.setattr("rbtrg_robot.bridge.foxglove._channels", late)
    with connect(f"ws://127.0.0.1:{door.server.port}", subprotocols=["foxglove.sdk.v1"]):  # type: ignore[list-item]
        pass
    left.set()
    until(lambda: door.server.listener.connected == 0)
    door.close()
    assert "failed" not in caplog.text


def test_a_door_that_can_let_in_nobody_any_more_ends_and_says_so(
    door: Door, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The server of `websockets` ends at the first error of `accept`."""

    def full() -> None:
        raise OSError(errno.EMFILE, "too many open files")

    monkeypatch.setattr(door.server.listener, "accept", full)
    door.knock(b"")
    until(lambda: bool(door.failed))
    assert "start it again" in str(door.failed[0])


def test_a_taken_port_is_one_line(door: Door) -> None:
    with pytest.raises(BridgeError, match="choose another --port"):
        Foxglove(door.bus, port=door.server.port)


WRONG: list[Any] = [
    *({"op": "subscribe", "subscriptions": [{"id": n, "channelId": 1}]}
    for n in (-1, 2**32, 10**30, 1.5, "1", None, True, [])),
    *({"op": "subscribe", "subscriptions": [{"id": 1, "channelId": n}]} for n in (-1, 10**30, math.inf, "x", {})),
    *({"op": "unsubscribe", "subscriptionIds": [n]} for n in (-1, math.nan, "x", {})),
    *({"op": "advertise", "channels": [{"id": n, "topic": "/goal_pose", "encoding": "cdr",
    "schemaName": "geometry_msgs/msg/PoseStamped"}]} for n in (-1, 2**32)),
    *({"op": name, key: 5} for name,
    key in (("subscribe", "subscriptions"), ("unsubscribe", "subscriptionIds"), ("advertise", "channels"))),
    *([], 5, "text", None, {"op": []}, {}),
]  # fmt: skip


def test_a_client_that_says_what_makes_no_sense_is_told_and_nobody_else_notices(door: Door) -> None:
    """A subscription with the number -1 ended the bridge, and with it everybody's stop."""
    good, bad = door.enter(), door.enter()
    good.send(op="subscribe", subscriptions=[{"id": 7, "channelId": good.channels["/odom"]["id"]}])
    for wrong in WRONG:
        bad.connection.send(json.dumps(wrong))
        assert json.loads(bad.connection.recv(LIMIT))["op"] == "status"
    bad.connection.send("[" * 100_000)
    bad.connection.send(b"")
    bad.connection.send(b"\x01\xff\xff\xff\xff")
    for _ in range(3):
        assert json.loads(bad.connection.recv(LIMIT))["op"] == "status"
    until(lambda: t.ODOM in door.server._subscribed)
    door.bus.advertise(t.ODOM)
    until(lambda: door.bus.publishers[t.ODOM].wanted)
    door.bus.publish(t.ODOM, t.ODOM.kind(header=header(5, "odom")), 5)
    assert struct.unpack_from("<BI", good.connection.recv(LIMIT)) == (1, 7)
    assert not door.failed


def test_what_comes_back_moves_nothing_by_itself() -> None:
    assert {topic.name for topic in BACK} <= {"/goal_pose", "/initialpose"}
    assert t.GOAL_POSE in BACK
