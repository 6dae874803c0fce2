"""A server of the Foxglove WebSocket protocol: the bytes of the bus to the app, goals and the emergency stop back.

Written on `websockets`, not on foxglove-sdk. That server (0.30.3) takes every Origin, so any web page open in a
browser on this computer could send goals. It also cannot tell the app that this is ROS (`ROS_DISTRO`), without which
the app publishes no poses. Protocol: https://github.com/foxglove/ws-protocol/blob/main/docs/spec.md"""

from __future__ import annotations

import json
import queue
import struct
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable
from typing import Any

from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response
from websockets.sync.server import ServerConnection, serve

from hal.errors import OperatorError
from hal.types import NS
from rbtrg_robot import topics as t
from rbtrg_robot.bridge.legs import Legs
from rbtrg_robot.crowd import CrowdedSocket
from rbtrg_robot.orders.order import send
from rbtrg_robot.orders.robot import Stop
from rbtrg_robot.topics import Qos, Topic
from rbtrg_robot.wire import messages
from rbtrg_robot.wire.bus import Bus, Received

PROTOCOLS = ("foxglove.sdk.v1", "foxglove.websocket.v1")
ORIGINS = (None, "https://app.foxglove.dev", "file://")
"""The app: in a browser, on the desktop, and programs that are no browser and say nothing."""
STOP: tuple[Topic, ...] = (t.ROBOT_STOP,)
BACK: tuple[Topic, ...] = tuple(t.BY_NAME[n] for n in ("/goal_pose", "/initialpose") if n in t.BY_NAME)
"""What clients may publish beside the stop."""
MESSAGE_DATA, TIME = 1, 2
"""Opcodes of binary frames from the server; MESSAGE_DATA is that of a client's, too."""
LEGS_PERIOD = NS // 20
"""Between two frames of the legs [ns]."""
CLOCK = -1
"""In the place of a subscription's number."""
WARNING, ERROR = 1, 2
LARGEST_MESSAGE = 1 << 20
"""Bytes of a client's message."""
MOST_STRANGERS, MOST_CLIENTS = 64, 32
"""Connections before and after their first request was read. Each holds up to four threads."""
CHANNELS = dict(enumerate(t.TOPICS, 1))


class BridgeError(OperatorError):
    """The server cannot be started; the message tells what to do."""


MAX_SUBSCRIPTIONS = 1000
"""Of one client; the app has one for each topic of each panel."""
NOT_UNDERSTOOD = (
    ValueError,
    KeyError,
    TypeError,
    AttributeError,
    OverflowError,
    RecursionError,
    struct.error,
)
"""What a message of a client that is none raises."""


class Client:
    """One connection: what it subscribed, what waits for it, what it publishes."""

    def __init__(self, connection: ServerConnection) -> None:
        self.connection = connection
        self.subscribed: dict[int, Topic] = {}
        self.published: dict[int, Topic] = {}
        self._waiting: dict[int, deque[bytes]] = {}
        self._more = threading.Condition()
        self._closed = False

    def put(self, subscription: int, frame: bytes, depth: int) -> None:
        """Send a frame when the client keeps up; of each subscription only the newest `depth` wait."""
        with self._more:
            self._waiting.setdefault(subscription, deque(maxlen=depth)).append(frame)
            self._more.notify()

    def close(self) -> None:
        """Nothing more is sent."""
        with self._more:
            self._closed = True
            self._more.notify()

    def send_all(self) -> None:
        """In a thread of its own, until the connection ends: a client that hangs holds up nobody else."""
        try:
            while True:
                with self._more:
                    self._more.wait_for(lambda: self._closed or any(self._waiting.values()))
                    if self._closed:
                        return
                    frames = [frame for waiting in self._waiting.values() for frame in waiting]
                    self._waiting.clear()
                for frame in frames:
                    self.connection.send(frame)
        except ConnectionClosed:
            return


class Foxglove:
    """The server between a bus and its clients. `run` belongs to one thread, which alone touches the bus."""

    def __init__(
        self,
        bus: Bus,
        host: str = "127.0.0.1",
        port: int = 8765,
        *,
        commands: bool = True,
        origins: Iterable[str] = (),
        say: Callable[[str], None] = print,
    ) -> None:
        """`commands`: clients may send goals; the stop they may always send. `origins`: web pages that may connect
        beside the app.

        Raises BridgeError if the port is taken."""
        self._bus, self._say = bus, say
        self._back = {topic.name: topic for topic in (*STOP, *(BACK if commands else ()))}
        for topic in self._back.values():
            bus.advertise(topic)
        # The stamps of the state are the clock of the clients, the description tells the frames of the limbs.
        self._subscribed: set[Topic] = {t.ROBOT_STATE, t.DESCRIPTION}
        bus.subscribe(sorted(self._subscribed, key=lambda topic: topic.name))
        self._wanted: queue.SimpleQueue[Topic] = queue.SimpleQueue()
        self._outbox: queue.SimpleQueue[tuple[Topic, Any]] = queue.SimpleQueue()
        self._newest: dict[Topic, Received[Any]] = {}
        self._clients: list[Client] = []
        self._legs: Legs | None = None
        self._legs_due = 0
        self._lock = threading.Lock()
        self._stop: Stop | None = None
        """A stop that the robot has not confirmed."""
        allowed: list[Any] = [*ORIGINS, *origins]
        try:
            self.listener = CrowdedSocket(host, port, strangers=MOST_STRANGERS, guests=MOST_CLIENTS)
        except OSError as error:
            raise BridgeError(
                f"cannot listen on {host}:{port}: {error.strerror}; choose another --port"
            ) from error
        self.port = int(self.listener.getsockname()[1])
        self._server = serve(
            self._serve,
            sock=self.listener,
            origins=allowed,
            subprotocols=[*PROTOCOLS],  # type: ignore[list-item]
            compression=None,
            max_size=LARGEST_MESSAGE,
            process_response=self._let_in,
        )
        self._thread = threading.Thread(target=self._server.serve_forever, name="foxglove", daemon=True)
        self._thread.start()

    def run(self, stopping: Callable[[], bool]) -> None:
        """Carry messages until `stopping()`. Raises BridgeError where nobody can come in any more."""
        try:
            while not stopping():
                if not self._thread.is_alive():
                    raise BridgeError(
                        "the server takes no connections any more (too many open files?): start it again"
                    )
                self._turn()
        finally:
            self.close()

    def close(self) -> None:
        """End the server and every connection."""
        self._server.shutdown()
        with self._lock:
            clients = list(self._clients)
        for client in clients:
            client.close()
            client.connection.close()
        self._thread.join()

    def _turn(self) -> None:
        received = self._bus.take(0.1)
        while not self._outbox.empty():
            topic, message = self._outbox.get()
            if topic in STOP:
                self._stop = self._stop or Stop(message.cause or "Foxglove")
            else:
                self._bus.publish(topic, message, time.time_ns())
        if self._stop is not None:
            send(self._bus, self._stop)
        while not self._wanted.empty():
            topic = self._wanted.get()
            if topic not in self._subscribed:
                self._subscribed.add(topic)
                self._bus.subscribe([topic])
        with self._lock:
            for each in received:
                self._carry(each)
        if self._stop is not None and self._stop.outcome is not None:
            self._say(self._stop.outcome.words)
            self._stop = None

    def _carry(self, received: Received[Any]) -> None:
        """One message to all clients. Called with the lock held."""
        if received.topic.qos is Qos.LATCHED:
            self._newest[received.topic] = received
        for client in self._clients:
            _give(client, received)
        if received.topic is t.DESCRIPTION and (description := self._bus.open(received)) is not None:
            self._legs = Legs(description.data)
        if received.topic is t.JOINTS and self._legs is not None:
            self._show_legs(self._legs, received)
        if received.topic is t.ROBOT_STATE:
            for client in self._clients:
                client.put(CLOCK, struct.pack("<BQ", TIME, max(received.stamp, 0)), 1)
            if self._stop is not None:
                state = self._bus.open(received)
                if state is not None:
                    self._stop.take(received.topic, state)

    def _show_legs(self, legs: Legs, joints: Received[Any]) -> None:
        """The app has no `robot_state_publisher`: its clients get the frames of the links here. The bus does not."""
        state = self._bus.open(joints)
        if state is None or 0 <= joints.stamp - self._legs_due < LEGS_PERIOD:
            return
        self._legs_due = joints.stamp
        frames = Received(t.TF, messages.encode(legs.frames(state)), joints.stamp, 0)
        for client in self._clients:
            _give(client, frames)

    # --- a connection, in its own thread ----------------------------------------------------------------------

    def _let_in(self, connection: ServerConnection, request: Request, response: Response) -> Response | None:
        if response.status_code == 403:
            origin = request.headers.get("Origin", "?")
            self._say(f"refused a web page of {origin}; if it is yours: --origin {origin}")
        elif response.status_code == 101 and not self.listener.admit(connection.remote_address[:2]):
            self._say(f"refused a client: {self.listener.guests} are connected")
            return connection.respond(503, "Too many clients are connected: close some.\n")
        return None

    def _serve(self, connection: ServerConnection) -> None:
        client = Client(connection)
        try:
            connection.send(json.dumps(_server_info()))
            connection.send(json.dumps({"op": "advertise", "channels": _channels()}))
        except ConnectionClosed:
            return  # it left at once
        sender = threading.Thread(target=client.send_all, name="foxglove sender", daemon=True)
        sender.start()
        with self._lock:
            self._clients.append(client)
        try:
            for data in connection:
                try:
                    if isinstance(data, str):
                        self._control(client, json.loads(data))
                    else:
                        self._publish(client, data)
                except NOT_UNDERSTOOD as error:
                    _status(client, ERROR, f"not understood: {error}")
        except ConnectionClosed:
            pass
        finally:
            with self._lock:
                self._clients.remove(client)
            client.close()
            sender.join()

    def _control(self, client: Client, request: dict[str, Any]) -> None:
        op = request["op"]
        if op == "subscribe":
            for each in request["subscriptions"]:
                self._subscribe(client, _number(each["id"]), CHANNELS[_number(each["channelId"])])
        elif op == "unsubscribe":
            with self._lock:
                for number in request["subscriptionIds"]:
                    client.subscribed.pop(_number(number), None)
        elif op == "advertise":
            for each in request["channels"]:
                topic = self._back.get(each["topic"])
                if topic is None:
                    _status(client, WARNING, f"{each['topic']} is not taken from here")
                elif each["encoding"] != "cdr" or each["schemaName"] != topic.type:
                    _status(client, WARNING, f"{topic.name} is {topic.type} in cdr")
                else:
                    client.published[_number(each["id"])] = topic
        elif op == "unadvertise":
            for number in request["channelIds"]:
                client.published.pop(_number(number), None)
        else:
            _status(client, WARNING, f"{str(op)[:40]!r} is not served here")

    def _subscribe(self, client: Client, number: int, topic: Topic) -> None:
        with self._lock:
            if len(client.subscribed) >= MAX_SUBSCRIPTIONS and number not in client.subscribed:
                raise ValueError(f"more than {MAX_SUBSCRIPTIONS} subscriptions")
            client.subscribed[number] = topic
            if topic in self._newest:  # a later client asks for what the bus tells once
                _give(client, self._newest[topic], number)
        self._wanted.put(topic)
        if topic is t.TF:
            self._wanted.put(t.JOINTS)
        self._bus.wake()

    def _publish(self, client: Client, data: bytes) -> None:
        opcode, number = struct.unpack_from("<BI", data)
        topic = client.published.get(number) if opcode == MESSAGE_DATA else None
        if topic is None:
            return _status(client, WARNING, "a message on a channel that was not advertised")
        message = messages.decode(data[5:], topic.kind)
        if topic not in STOP and not self._bus.publishers[topic].wanted:
            return _status(client, ERROR, f"nobody takes {topic.name} now: see `rbtrg-robot status`")
        self._outbox.put((topic, message))
        return self._bus.wake()


def _give(client: Client, received: Received[Any], only: int | None = None) -> None:
    """One message to those of a client's subscriptions that want it. Called with the lock held."""
    for number, topic in client.subscribed.items():
        if topic is received.topic and only in (None, number):
            head = struct.pack("<BIQ", MESSAGE_DATA, number, max(received.stamp, 0))
            client.put(number, head + received.payload, max(topic.depth, 1))


def _number(value: object) -> int:
    """An id as the protocol has it: 32 bits without a sign. Raises ValueError."""
    if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value < 2**32:
        raise ValueError(f"{str(value)[:40]} is no id: it takes a whole number from 0 to 4294967295")
    return value


def _server_info() -> dict[str, Any]:
    return {
        "op": "serverInfo",
        "name": "rbtrg-robot",
        "capabilities": ["time", "clientPublish"],
        "supportedEncodings": ["cdr"],
        "metadata": {"ROS_DISTRO": "jazzy"},
    }


def _channels() -> list[dict[str, Any]]:
    return [
        {
            "id": number,
            "topic": topic.name,
            "encoding": "cdr",
            "schemaName": topic.type,
            "schemaEncoding": "ros2msg",
            "schema": messages.definition(topic.type),
        }
        for number, topic in CHANNELS.items()
    ]


def _status(client: Client, level: int, text: str) -> None:
    client.connection.send(json.dumps({"op": "status", "level": level, "message": text}))
