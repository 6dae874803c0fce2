"""The bus: one Zenoh session, publishers and one inbox. Nothing here knows what the messages mean.

Choices that a measured failure stands behind:
- sessions close through `with`, and callbacks run `indirect=False`: a Python callback thread keeps a crashed
  process, and its liveliness token, alive for ever;
- the callback only appends to a bounded deque: a slow consumer loses old messages instead of queueing without bound;
- congestion control is DROP everywhere: BLOCK lets one hung consumer freeze its producer for 5 s;
- a message that comes under the key of another topic is refused: Zenoh mixes the keys up for up to 1.5 s after sessions
  have come back to a router that hung (`keys.astray`);
- a topic with an owner is taken from that process of this stack alone, or from any of its processes: another program on
  this computer published the
  guard's limits, and the robot drove by them. It is told apart by the stack's id, which is no secret: this is for
  accidents; malice is kept out by the session (`session.py`);
- loopback, no multicast, one known endpoint.
"""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass, replace
from types import TracebackType
from typing import Any, Generic, Self

import zenoh
from zenoh import ext
from zenoh.handlers import Callback

from hal.errors import OperatorError
from hal.safety.monitors import STRANGER
from rbtrg_robot.processes import BY_NAME, SUPERVISOR
from rbtrg_robot.scope import Scope
from rbtrg_robot.topics import STACK, M, Qos, Topic
from rbtrg_robot.wire import keys as wire
from rbtrg_robot.wire import messages
from rbtrg_robot.wire.clock import SourceClock
from rbtrg_robot.wire.front import Front
from rbtrg_robot.wire.session import Security, open_router, session_config

log = logging.getLogger(__name__)


class BusError(OperatorError):
    """The bus cannot be reached; the message tells what to do."""


Reply = Callable[[bytes], None]
"""Answers one query."""


@dataclass(frozen=True, slots=True)
class Received(Generic[M]):
    """One message as it came: wire bytes and what the attachment says."""

    topic: Topic[M]
    payload: bytes
    stamp: int
    """Publisher's source clock [ns]."""
    sequence: int
    sender: str = ""
    """The publisher, by the name of its endpoint."""

    def decode(self) -> M:
        """The message. Raises MessageError."""
        return messages.decode(self.payload, self.topic.kind)


INTRUSION_TIME = 5.0
"""[s] for which a stranger is told after the last message that was refused."""
MOST_NAMED, LONGEST_NAME = 3, 40
"""Most strangers that are named, and most letters of a name: anybody chooses these."""


class Refusals:
    """What is dropped because it cannot be used: counted, and now and then logged."""

    def __init__(self) -> None:
        self.refused = 0
        self._counting = threading.Lock()

    def open(self, received: Received[M]) -> M | None:
        """The message in what came. None where it is none; that is counted and now and then logged."""
        try:
            return received.decode()
        except messages.MessageError as error:
            self.refuse(received.topic, error)
            return None

    def intrusion(self) -> str:
        """Who publishes what belongs to a process of this stack, in the operator's words; empty where nobody does."""
        return ""

    def refuse(self, topic: Topic, why: object) -> None:
        """Count a message that is dropped, and log it now and then."""
        with self._counting:
            self.refused += 1
            number = self.refused
        if number in (1, 10, 100, 1000):
            log.warning("%s: message refused (%d so far): %s", topic.name, number, why)


class Bus(Refusals):
    """One process's access to the topics."""

    def __init__(
        self,
        endpoint: str,
        node: str,
        scope: Scope = Scope(),
        *,
        router: bool = False,
        clock: SourceClock | None = None,
        stack: str = "",
        absent: Collection[str] = (),
        security: Security | None = None,
    ) -> None:
        """Open a session. Raises BusError when the endpoint is taken (router) or nobody answers (client).

        `clock`: that of the stack; None where stamps serve logs only. `stack`: id of the stack whose process this is.
        `absent`: processes that this stack does without, so that others may publish their topics.
        `security`: for sessions between computers; None on loopback.
        """
        super().__init__()
        self.clock = clock or SourceClock()
        self.node = node
        self.scope = scope
        zenoh.init_log_from_env_or("off")
        self._stack = stack
        self._absent = frozenset(absent)
        self._intruded: dict[Topic, float] = {}
        """When a stranger's message on a topic was refused last [s, monotonic]."""
        self._named: dict[Topic, str] = {}
        """Who it was that was told of last; one that has left is still to be found."""
        self._strangers: dict[str, tuple[str, str]] | None = None
        """Node and topic of every publisher of others, by its token; None before there was a reason to ask."""
        self._front: Front | None = None
        outside = (*security.listen, *security.neighbours) if security is not None else ()
        try:
            if router and security is not None and security.listen:
                (inside, *_) = (*security.neighbours, endpoint)
                self._front = Front(security.listen, int(inside.rpartition(":")[2]))
                security = replace(security, listen=self._front.doors)
            config = session_config(endpoint, router=router, stack=stack, security=security)
            self.session = open_router(config) if router else zenoh.open(config)
        except (zenoh.ZError, OSError) as error:
            if self._front is not None:
                self._front.close()
            if "shm" in str(error):
                what = (
                    "no shared memory for Zenoh: is /dev/shm full, or `mlock` forbidden (`ulimit -l`, a "
                    "container's filter)?"
                )
            elif router:
                where = " or ".join((endpoint, *outside))
                what = f"cannot listen on {where}: is another program using the port? Choose one with --port"
            elif security is not None:
                what = (
                    f"{endpoint} does not let us in: is the stack up, and is the certificate one of its keys?"
                )
            else:
                what = f"nothing answers on {endpoint}: is the stack up? Start it with `rbtrg-robot up`"
            raise BusError(what, retry=not router) from error
        if self._front is not None:
            self._front.open()
        self._zid = str(self.session.zid())
        self._held: list[Any] = [
            self.session.liveliness().declare_token(wire.node_token(scope, self._zid, node))
        ]
        self._entities = 1
        self._watches = False
        self._signal = threading.Event()
        self._lock = threading.Lock()
        self._queues: dict[Topic, deque[tuple[int, Received[Any]]]] = {}
        self._arrived = 0
        self.dropped = 0
        self.publishers: dict[Topic, Publisher] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Leave the bus; tokens go at once."""
        if self._front is not None:
            self._front.close()
        if not self.session.is_closed():
            self.session.close()

    def publish(self, topic: Topic[M], message: M, stamp: int) -> None:
        """Send one message; `stamp` is the source clock [ns]."""
        publisher = self.publishers.get(topic)
        if publisher is None:
            publisher = self.advertise(topic)
        publisher.put(messages.encode(message), stamp)

    def advertise(self, topic: Topic) -> Publisher:
        """Declare a publisher and its token now rather than at the first message."""
        if topic not in self.publishers:
            self._entities += 1
            token = wire.endpoint_token(self.scope, self._zid, self.node, topic, self._entities, "MP")
            self._held.append(self.session.liveliness().declare_token(token))
            self.publishers[topic] = Publisher(
                self.session, topic, self.scope, token, wire.proof(self._stack, self.node)
            )
        return self.publishers[topic]

    def subscribe(self, wanted: Iterable[Topic]) -> None:
        """Messages of these topics collect in the inbox, `Topic.depth` of each at most."""
        for topic in wanted:
            if topic in self._queues:
                continue
            self._queues[topic] = deque()
            self._entities += 1
            token = wire.endpoint_token(self.scope, self._zid, self.node, topic, self._entities, "MS")
            self._held.append(self.session.liveliness().declare_token(token))
            name = wire.key(topic, self.scope)
            handler = Callback(self._receiver(topic, wire.mark(name)), indirect=False)
            if topic.qos is Qos.LATCHED:
                history = ext.HistoryConfig(detect_late_publishers=True, max_samples=1)
                self._held.append(
                    ext.declare_advanced_subscriber(self.session, name, handler, history=history)
                )
            else:
                self._held.append(self.session.declare_subscriber(name, handler))

    def _receiver(self, topic: Topic, mark: bytes) -> Callable[[zenoh.Sample], None]:
        queue = self._queues[topic]
        owned = bool(self._stack and topic.owner) and topic.owner not in self._absent
        owners = (*BY_NAME, SUPERVISOR) if topic.owner == STACK else (topic.owner,)
        proofs = {wire.proof(self._stack, owner) for owner in owners}

        def receive(sample: zenoh.Sample) -> None:
            data = sample.attachment.to_bytes() if sample.attachment is not None else b""
            if wire.astray(data, mark):
                self.refuse(topic, "a message of another topic")
                return
            if owned and STRANGER.active and wire.proof_of(data) not in proofs:
                if not topic.shared:
                    self._intruded[topic] = time.monotonic()
                    self.refuse(topic, "a stranger's message")
                return
            sequence, stamp = wire.parse_attachment(data)
            received = Received(topic, sample.payload.to_bytes(), stamp, sequence, wire.sender_of(data))
            with self._lock:
                self._arrived += 1
                if len(queue) >= topic.depth:
                    queue.popleft()
                    # Where latest wins by design, overtaken messages are no loss.
                    self.dropped += topic.depth > 1
                queue.append((self._arrived, received))
            self._signal.set()

        return receive

    def intrusion(self) -> str:
        """Who publishes what belongs to a process of this stack, in the operator's words; empty where nobody does.

        Asked again and again: who it is comes from liveliness tokens, which nobody looks at before there is a reason
        to.
        """
        since = time.monotonic() - INTRUSION_TIME
        topics = [topic for topic, newest in self._intruded.copy().items() if newest > since]
        if not topics:
            return ""
        if self._strangers is None:
            self._strangers = {}
            self._held.append(
                self.session.liveliness().declare_subscriber(
                    wire.publishers(self.scope), Callback(self._hear_publisher, indirect=False), history=True
                )
            )
            return ""
        told = []
        known = list(self._strangers.copy().items())
        for topic in topics:
            name = self.scope.topic(topic.name)
            who = sorted(
                {
                    f"{node[:LONGEST_NAME]} (session {wire.session_of(k)[:LONGEST_NAME]})"
                    for k, (node, on) in known
                    if on == name
                }
            )
            if who:
                self._named[topic] = ", ".join(who[:MOST_NAMED])
            named = self._named.get(topic, "a program that has left or tells no name")
            told.append(STRANGER.tell(topic=name, who=named, owner=topic.owner))
        return "; ".join(told)

    def _hear_publisher(self, sample: zenoh.Sample) -> None:
        token = str(sample.key_expr)
        if self._strangers is None or wire.session_of(token).startswith(self._stack):
            return
        if sample.kind == zenoh.SampleKind.PUT:
            self._strangers[token] = wire.publisher_of(token)
        else:
            self._strangers.pop(token, None)

    def take(self, timeout: float) -> list[Received[Any]]:
        """Everything in the inbox in order of arrival; waits up to `timeout` [s] for the first."""
        if self._signal.wait(timeout):
            self._signal.clear()
        with self._lock:
            taken = [entry for queue in self._queues.values() for entry in queue]
            for queue in self._queues.values():
                queue.clear()
        taken.sort(key=lambda entry: entry[0])
        return [received for _, received in taken]

    @property
    def waiting(self) -> bool:
        """Something is in the inbox."""
        return self._signal.is_set()

    def wake(self) -> None:
        """Make a waiting `take` return."""
        self._signal.set()

    def watch_processes(self, changed: Callable[[str, bool], None]) -> None:
        """`changed(process, alive)` for every process of this stack, now and at each change. Runs in Zenoh's thread.

        A process is known by the id of its session: anybody may call a node `tracker` and end it again.
        """
        self._watches = True
        sessions: dict[str, set[str]] = {}

        def receive(sample: zenoh.Sample) -> None:
            token = str(sample.key_expr)
            process, session = wire.process_of(token), wire.session_of(token)
            if not session.startswith(self._stack):
                return
            alive = sessions.setdefault(process, set())
            if sample.kind == zenoh.SampleKind.PUT:
                alive.add(session)
            else:
                alive.discard(session)
                changed(process, False)
            if alive:
                changed(process, True)

        pattern = wire.node_token(self.scope, "*", "*")
        subscriber = self.session.liveliness().declare_subscriber(
            pattern, Callback(receive, indirect=False), history=True
        )
        self._held.append(subscriber)

    def processes(self, timeout: float = 2.0) -> set[str]:
        """Names of the processes on the bus now. Raises BusError when the router does not answer in time [s].

        Not beside `watch_processes`: a session that has subscribed to the tokens is sometimes answered with none
        (Zenoh 1.10: 53 of 602 times).
        """
        return {wire.process_of(token) for token in self._tokens("*", timeout)}

    def second(self, node: str, timeout: float = 2.0) -> bool:
        """Whether somebody else is on the bus as this node of this robot. Raises BusError like `processes`."""
        return any(not wire.session_of(x).startswith(self._stack) for x in self._tokens(node, timeout))

    def _tokens(self, node: str, timeout: float) -> list[str]:
        if self._watches:
            raise RuntimeError("a bus that watches the processes knows them already")
        found = []
        for reply in self.session.liveliness().get(wire.node_token(self.scope, "*", node), timeout=timeout):
            if reply.ok is None:
                raise BusError("the stack does not say who is on its bus; ask again in a second", retry=True)
            found.append(str(reply.ok.key_expr))
        return found

    def serve(self, name: str, asked: Callable[[Reply], None]) -> None:
        """Hear queries on a name of the supervisor's own. `asked(reply)` runs in Zenoh's thread and must be quick;
        `reply` may be called later, from any thread."""
        full = wire.service(name, self.scope)

        def receive(query: zenoh.Query) -> None:
            asked(lambda answer: query.reply(full, answer))

        self._held.append(self.session.declare_queryable(full, Callback(receive, indirect=False)))

    def ask(self, name: str, timeout: float = 2.0) -> bytes | None:
        """The first answer to a query, or None when nobody answers in time [s]."""
        full = wire.service(name, self.scope)
        for reply in self.session.get(full, timeout=timeout):
            if reply.ok is not None:
                return reply.ok.payload.to_bytes()
        return None


class Publisher:
    """One topic's outgoing side."""

    def __init__(self, session: zenoh.Session, topic: Topic, scope: Scope, token: str, proof: bytes) -> None:
        name = wire.key(topic, scope)
        self._gid = wire.gid(token, name, proof)
        self.count = 0
        self.newest = 0
        qos: dict[str, Any] = {"congestion_control": zenoh.CongestionControl.DROP}
        if topic.qos is Qos.COMMAND:
            qos |= {"priority": zenoh.Priority.REAL_TIME, "express": True}
        self._publisher: Any
        if topic.qos is Qos.LATCHED:
            self._publisher = ext.declare_advanced_publisher(
                session, name, cache=ext.CacheConfig(max_samples=1), publisher_detection=True, **qos
            )
        else:
            self._publisher = session.declare_publisher(name, **qos)

    @property
    def wanted(self) -> bool:
        """This session knows of somebody who listens. While it knows of nobody, it sends nothing."""
        return bool(self._publisher.matching_status.matching)

    def put(self, payload: bytes, stamp: int) -> None:
        """Send wire bytes."""
        self.count += 1
        self.newest = stamp
        self._publisher.put(payload, attachment=wire.attachment(self.count, stamp, self._gid))
