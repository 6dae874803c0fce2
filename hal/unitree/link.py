"""The DDS side: one participant on one network interface, readers and writers that move bytes, nothing else."""

from __future__ import annotations

import logging
import socket
from collections.abc import Iterable
from ctypes import c_size_t
from typing import Any, Protocol

import psutil

from hal.contract import BackendError
from hal.unitree import api
from hal.unitree.api import Request, Response

LOW_STATE = "rt/lowstate"
SPORT_STATE = "rt/sportmodestate"
L1_IMU = "rt/utlidar/imu"
L1_CLOUD = "rt/utlidar/cloud"
CUSTOM = " CustomMsg"
"""Behind the name of a topic that is read as livox_ros_driver2's type: a Mid-360 speaks there in this one or as
PointCloud2."""
CLOUD_TYPES = ("PointCloud2", "CustomMsg")
DRY_RUN = "dry run, nothing is sent"
"""The cause of every phase then begins with it."""
RECEIVE_BUFFER = 4 * 1024 * 1024
"""[bytes] asked for each DDS socket: an XT16 sweep is 0.8 MB in one burst, best effort.

The kernel grants `net.core.rmem_max` at most (usually 0.2 MB), which `rbtrg-robot doctor` checks.
"""

log = logging.getLogger(__name__)


class Link(Protocol):
    """The network as the backend needs it. Nothing blocks."""

    def send(self, service: str, request: Request) -> None:
        """Write a request."""

    def responses(self, service: str) -> list[Response]:
        """Responses since the last call."""

    def publish(self, topic: str, message: bytes) -> None:
        """Write a CDR message."""

    def publishers(self, topic: str) -> int:
        """How many write this topic, on the whole network."""

    def take(self, topic: str) -> list[bytes]:
        """CDR messages since the last call, oldest first."""

    def speakers(self, topic: str) -> list[int]:
        """Who sent the messages of the last `take` of this topic, in their order: a number for each publisher."""

    def reachable(self, service: str) -> bool:
        """Whether a server of this service has been discovered."""

    def clouds(self) -> dict[str, str]:
        """Topics of the network on which somebody sends clouds, and their types, of CLOUD_TYPES."""

    def close(self) -> None:
        """Release everything. Idempotent."""


def check_interface(name: str) -> None:
    """Raise BackendError unless the interface exists, is up and has an IPv4 address."""
    addresses = psutil.net_if_addrs()
    choices = f"choose one of {', '.join(sorted(addresses))} (--interface)"
    if not name:
        raise BackendError(f"which network interface leads to the robot? {choices}", retry=False)
    if name not in addresses:
        raise BackendError(f"network interface {name!r} does not exist; {choices}", retry=False)
    stats = psutil.net_if_stats().get(name)
    if stats is None or not stats.isup:
        raise BackendError(
            f"network interface {name!r} is down; plug the cable in or run: ip link set {name} up"
        )
    if not any(a.family == socket.AF_INET for a in addresses[name]):
        raise BackendError(
            f"network interface {name!r} has no IPv4 address; the robot's network is 192.168.123.0/24, "
            f"for example: ip addr add 192.168.123.99/24 dev {name}"
        )


def domain_config(interface: str) -> str:
    """Cyclone DDS configuration that binds to this interface alone.

    Loopback has no multicast on many machines and versions: there, peers are given by address.
    """
    discovery = ""
    multicast = "default"
    if interface == "lo":
        multicast = "false"
        discovery = (
            "<Discovery><ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>30</MaxAutoParticipantIndex>"
            '<Peers><Peer address="127.0.0.1"/></Peers></Discovery>'
        )
    return (
        '<CycloneDDS><Domain Id="any"><General><Interfaces>'
        f'<NetworkInterface name="{interface}"/></Interfaces>'
        f"<AllowMulticast>{multicast}</AllowMulticast></General>{discovery}"
        # `max` alone takes what the kernel grants; with `min` DDS would not start on a machine that grants less.
        f'<Internal><SocketReceiveBufferSize max="{RECEIVE_BUFFER}B"/></Internal></Domain></CycloneDDS>'
    )


class DdsLink:
    """`Link` on Cyclone DDS."""

    def __init__(
        self,
        interface: str,
        domain: int,
        topics: Iterable[tuple[str, Any, int]],
        services: Iterable[str] = api.SERVICES,
        commands: Iterable[tuple[str, Any]] = (),
    ) -> None:
        """Raises BackendError.

        topics: name, IDL type, depth of the queue between two `take` calls; CUSTOM may stand behind a name; commands:
        name and IDL type of what `publish` writes.
        """
        from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsPublication
        from cyclonedds.core import (
            DDSException,
            InstanceState,
            Policy,
            Qos,
            ReadCondition,
            SampleState,
            ViewState,
        )
        from cyclonedds.domain import Domain, DomainParticipant
        from cyclonedds.pub import DataWriter
        from cyclonedds.sub import DataReader
        from cyclonedds.topic import Topic
        from cyclonedds.util import duration

        from hal.unitree import idl

        check_interface(interface)
        self._request: Any = idl.RequestMessage
        self._bad = 0
        self._speakers: dict[str, list[int]] = {}
        try:
            self._domain: Any = Domain(domain, domain_config(interface))
            self._participant: Any = DomainParticipant(domain)
            self._readers: dict[str, Any] = {}
            self._writers: dict[str, Any] = {}

            def qos(depth: int, reliable: bool) -> Qos:
                # A write to a robot that does not answer must not stall the control loop.
                kind = (
                    Policy.Reliability.Reliable(duration(milliseconds=5))
                    if reliable
                    else Policy.Reliability.BestEffort
                )
                return Qos(kind, Policy.History.KeepLast(depth))

            for name, kind, depth in topics:
                topic: Any = Topic(self._participant, name.removesuffix(CUSTOM), kind)
                self._readers[name] = DataReader(self._participant, topic, qos(depth, reliable=False))
            self._kinds: dict[str, Any] = dict(commands)
            for name, kind in self._kinds.items():
                topic = Topic(self._participant, name, kind)
                self._writers[name] = DataWriter(self._participant, topic, qos(1, reliable=True))
            self._senders: Any = BuiltinDataReader(self._participant, BuiltinTopicDcpsPublication)
            alive = ViewState.Any | SampleState.Any | InstanceState.Alive
            self._alive: Any = ReadCondition(self._senders, alive)
            for service in services:
                name = f"rt/api/{service}/response"
                topic = Topic(self._participant, name, idl.ResponseMessage)
                self._readers[name] = DataReader(self._participant, topic, qos(50, reliable=True))
                topic = Topic(self._participant, f"rt/api/{service}/request", idl.RequestMessage)
                self._writers[service] = DataWriter(self._participant, topic, qos(20, reliable=True))
        except DDSException as error:
            raise BackendError(
                f"DDS does not start on {interface!r}, domain {domain}: {error}; "
                "one process can hold a domain once, and a firewall must let UDP 7400-7500 through"
            ) from error

    def send(self, service: str, request: Request) -> None:
        """Write a request; a full queue drops it, the caller's timeout notices."""
        from cyclonedds.core import DDSException

        try:
            self._writers[service].write(self._request.of(request.pack()))
        except DDSException as error:
            log.warning("request %d to %s was not sent: %s", request.api, service, error)

    def publish(self, topic: str, message: bytes) -> None:
        """Write a CDR message; a full queue drops it, the next one comes."""
        from cyclonedds.core import DDSException

        try:
            self._writers[topic].write(self._kinds[topic].of(message))
        except DDSException as error:
            log.warning("a message on %s was not sent: %s", topic, error)

    def publishers(self, topic: str) -> int:
        """How many write this topic, on the whole network, ours included."""
        found = self._senders.read(N=1000, condition=self._alive)
        return sum(sample.topic_name == topic for sample in found)

    def responses(self, service: str) -> list[Response]:
        """Responses since the last call; those that cannot be read are counted and logged."""
        out = []
        for data in self.take(f"rt/api/{service}/response"):
            try:
                out.append(Response.unpack(data))
            except api.WireError as error:
                self._bad += 1
                log.warning("unreadable response from %s: %s", service, error)
        return out

    def take(self, topic: str) -> list[bytes]:
        """CDR messages since the last call, oldest first."""
        samples = [sample for sample in self._readers[topic].take(N=256) if hasattr(sample, "cdr")]
        self._speakers[topic] = [sample.sample_info.publication_handle for sample in samples]
        return [sample.cdr for sample in samples]

    def speakers(self, topic: str) -> list[int]:
        """Who sent the messages of the last `take` of this topic, in their order."""
        return self._speakers.get(topic, [])

    def reachable(self, service: str) -> bool:
        """Whether a server of this service has been discovered."""
        writer = self._writers[service]
        if hasattr(writer, "get_matched_subscriptions"):
            return bool(writer.get_matched_subscriptions())
        # cyclonedds 0.10 (aarch64) does not wrap this function of its C library.
        count: int = writer._dll_handle.dds_get_matched_subscriptions(writer._ref, None, c_size_t(0))
        return count > 0

    def clouds(self) -> dict[str, str]:
        """Topics of the network on which somebody sends clouds, and their types, of CLOUD_TYPES."""
        found = {}
        for sample in self._senders.read(N=1000, condition=self._alive):
            kind = sample.type_name.rpartition("::")[2].removesuffix("_")
            if kind in CLOUD_TYPES:
                found[sample.topic_name] = kind
        return found

    def close(self) -> None:
        """Release everything. Idempotent."""
        # Cyclone deletes an entity when its Python object goes; children first.
        self._alive = self._senders = None
        self._readers.clear()
        self._writers.clear()
        self._participant = None
        self._domain = None


class DryRunLink:
    """Listens for real, writes nothing: requests are logged, and answered as if the robot had said yes."""

    def __init__(self, link: Link) -> None:
        self._link = link
        self._answers: dict[str, list[Response]] = {}
        self._last: dict[tuple[str, int], str] = {}
        self._skipped = 0

    def send(self, service: str, request: Request) -> None:
        """Log the request where it differs from the last of its kind; of a stream of Moves one in 25."""
        key = (service, request.api)
        if self._last.get(key) != request.parameter:
            self._skipped = (self._skipped + 1) % 25 if request.no_reply and key in self._last else 0
            self._last[key] = request.parameter
            if self._skipped == 0:
                log.info("dry run, not sent: %s %d %s", service, request.api, request.parameter)
        if not request.no_reply:
            self._answers.setdefault(service, []).append(Response(request.id, request.api, 0, ""))

    def responses(self, service: str) -> list[Response]:
        """The made-up answers."""
        return self._answers.pop(service, [])

    def publish(self, topic: str, message: bytes) -> None:
        """Nothing is sent."""

    def publishers(self, topic: str) -> int:
        """Of the real network."""
        return self._link.publishers(topic)

    def take(self, topic: str) -> list[bytes]:
        """Real telemetry."""
        return self._link.take(topic)

    def speakers(self, topic: str) -> list[int]:
        """Of the real telemetry."""
        return self._link.speakers(topic)

    def reachable(self, service: str) -> bool:
        """Real discovery."""
        return self._link.reachable(service)

    def clouds(self) -> dict[str, str]:
        """Of the real network."""
        return self._link.clouds()

    def close(self) -> None:
        """Release the real link."""
        self._link.close()
