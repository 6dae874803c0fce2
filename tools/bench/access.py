"""Access over TLS: each identity tries each verb on each topic at a real router on loopback.

What is expected stands here once more, in names of topics: the rules under test are made from the table.
"""

from __future__ import annotations

import argparse
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import zenoh
from zenoh.handlers import Callback

from rbtrg_robot import topics as t
from rbtrg_robot.access import certificates
from rbtrg_robot.access.identity import CA, client_tls
from rbtrg_robot.access.serve import security
from rbtrg_robot.config import load
from rbtrg_robot.scope import ROBOT, Scope
from rbtrg_robot.topics import Role, Topic
from rbtrg_robot.wire import keys as wire
from rbtrg_robot.wire.bus import Bus, BusError
from rbtrg_robot.wire.session import Security
from tools.bench.ports import free_port
from tools.bench.report import Report

OBSERVER_MAY = {"/robot/stop"}
OPERATOR_MAY = OBSERVER_MAY | {
    "/areas/request",
    "/camera/front/photo/request",
    "/robot/command",
    "/goal/request",
    "/goal_pose",
    "/dock/pose",
    "/elevation_map/request",
    "/teleop/cmd_vel",
    "/teleop/trunk",
    "/mission/request",
    "/operator/presence",
    "/initialpose",
    "/elevation_map/prior",
    "/plan/question",
}
"""Topics that each may publish; whatever else the table has or will have, nobody from outside may."""
NOBODY = "nobody"
MAY_PUBLISH = {"operator": OPERATOR_MAY, "observer": OBSERVER_MAY, "removed": set(), "foreign": set()}
MAY_PUBLISH |= {"robot": set(), NOBODY: set()}
MAY_ENTER = {"operator", "observer", "removed"}
MAY_SEE = {"operator", "observer"}
LONGEST_WAIT = 20.0
"""Longest wait [s] for what must arrive."""
QUIET_WAIT = 1.0
"""Wait [s] for what must not arrive, after what was sent later has."""


class Site:
    """A router that serves TLS, a process of its stack, and one certificate of each sort."""

    def __init__(self, folder: Path, robot: str = ROBOT) -> None:
        base = folder / "keys"
        certificates.make_authority(base, 2)
        for name, role in (
            ("operator", Role.OPERATOR),
            ("observer", Role.OBSERVER),
            ("removed", Role.OPERATOR),
        ):
            certificates.add(base, name, role, 2)
        certificates.remove(base, "removed")
        other = folder / "other"
        certificates.make_authority(other, 2)
        self.folders = {name: base / name for name in ("operator", "observer", "removed", "robot")}
        # Signed by another authority, but its name is on the list, and it knows who the robot is.
        self.folders["foreign"] = certificates.add(other, "mallory", Role.OPERATOR, 2)
        with (base / "robot" / certificates.ACCESS).open("a") as file:
            file.writelines(f"{name}\n" for name in certificates.listed(other / "robot"))
        (other / "mallory" / CA).write_bytes((base / "robot" / CA).read_bytes())
        self.endpoint = f"tls/127.0.0.1:{free_port()}"
        network = {"listen": [self.endpoint], "keys": str(base / "robot")}
        config = load(port=free_port(), network=network, robot=robot)
        self._router = Bus(
            config.endpoint, "supervisor", config.scope, router=True, security=security(config)
        )
        self._router.serve("status", lambda reply: reply(b'"well"'))
        self._router.serve("map", lambda reply: reply(b"not for outsiders"))
        self.local = config.endpoint
        self.inside = Bus(config.endpoint, "robot", config.scope)
        self._turn = threading.Condition()
        self._heard: set[tuple[str, bytes]] = set()
        self.inside.session.declare_subscriber("**", Callback(self._take, indirect=False))
        self.inside.publish(t.ROBOT_STATE, t.ROBOT_STATE.kind(estop_cause="latched before"), 1)

    def close(self) -> None:
        """End both."""
        self.inside.close()
        self._router.close()

    def _take(self, sample: zenoh.Sample) -> None:
        with self._turn:
            self._heard.add((str(sample.key_expr), sample.payload.to_bytes()))
            self._turn.notify_all()

    def enter(self, who: str) -> Bus:
        """A session of this identity. Raises BusError where it is refused."""
        tls = client_tls(self.folders.get(who, self.folders["operator"]))
        if who == NOBODY:
            tls = {key: tls[key] for key in ("root_ca_certificate", "verify_name_on_connect")}
        return Bus(self.endpoint, "cli", security=Security(tls))

    def arrived(self, session: zenoh.Session, names: list[str], mark: bytes) -> set[str]:
        """Which of these keys a put of the payload `mark` from outside reaches, at a process of the stack.

        They are sent again until a stop that is sent after them arrives, where that may; all in one order, at one
        priority.
        """
        last = (wire.key(t.ROBOT_STOP, Scope()), mark + b", the last")
        until = time.monotonic() + QUIET_WAIT
        while True:
            for name in names:
                session.put(name, mark)
            session.put(*last)
            with self._turn:
                if self._turn.wait_for(lambda: last in self._heard, 0.2) or time.monotonic() > until:
                    return {name for name, payload in self._heard if payload == mark}

    def seen(self, bus: Bus, topics: list[Topic]) -> set[str]:
        """Names of the topics of which messages from the stack reach the outside."""
        bus.subscribe(topics)
        seen: set[str] = set()
        until = time.monotonic() + QUIET_WAIT
        longest = time.monotonic() + LONGEST_WAIT
        while len(seen) < len(topics) and time.monotonic() < (longest if seen else until):
            for topic in topics:
                self.inside.publish(topic, topic.kind(), 1)
            seen |= {received.topic.name for received in bus.take(0.2)}
        return seen

    def deceived(self, bus: Bus) -> bool:
        """Whether the stack hears an answer or a token from outside."""
        name = wire.node_token(Scope(), str(bus.session.zid()), "tracker")
        bus.session.liveliness().declare_token(name)
        bus.serve("invented", lambda reply: reply(b"false"))
        return self.inside.ask("invented", timeout=QUIET_WAIT) is not None or bool(
            {"tracker", "cli"} & self.inside.processes()
        )


@contextmanager
def site() -> Iterator[Site]:
    """One in a folder of its own."""
    with tempfile.TemporaryDirectory() as folder:
        made = Site(Path(folder))
        try:
            yield made
        finally:
            made.close()


def run(args: list[str]) -> Report:
    """Run this bench with the arguments of its command line; returns its rows."""
    argparse.ArgumentParser(prog="python -m tools.bench access", description=__doc__).parse_args(args)
    report = Report("access")
    with site() as place:
        for who in MAY_PUBLISH:
            for verb, trial in VERBS.items():
                cells = trial(place, who)
                wrong = sum(got != expected for got, expected in cells.values())
                allowed = sum(got for got, _ in cells.values())
                wanted = sum(expected for _, expected in cells.values())
                report.add(f"access.{who}.{verb}.allowed", allowed, f"of {len(cells)}", baseline=wanted)
                report.add(f"access.{who}.{verb}.wrong", wrong, f"of {len(cells)}", 0.0)
    return report


Cells = dict[str, tuple[bool, bool]]
"""What was tried, whether it was allowed, and whether it should be."""


def enter(place: Site, who: str) -> Cells:
    """A session over TLS."""
    return {"session": (_inside(place, who, lambda _: True, False), who in MAY_ENTER)}


def publish(place: Site, who: str) -> Cells:
    """Each topic of the table, and key expressions that would match many."""
    names = {wire.key(topic, Scope()): topic.name for topic in t.TOPICS}
    names |= {
        name: name for name in ("0/**", "**", "0/cmd_vel/**", "0/new/topic", "0/rbtrg/status", "1/cmd_vel")
    }
    got: set[str] = _inside(
        place, who, lambda bus: place.arrived(bus.session, list(names), f"put by {who}".encode()), set()
    )
    return {name: (key in got, name in MAY_PUBLISH[who]) for key, name in names.items()}


def subscribe(place: Site, who: str) -> Cells:
    """Each topic of the table; the latched one was published before."""
    got: set[str] = _inside(place, who, lambda bus: place.seen(bus, list(t.TOPICS)), set())
    return {topic.name: (topic.name in got, who in MAY_SEE) for topic in t.TOPICS}


def look(place: Site, who: str) -> Cells:
    """What only a late joiner's query, a liveliness query and a question bring."""

    def looks(bus: Bus) -> dict[str, bool]:
        bus.subscribe([t.ROBOT_STATE])
        until = time.monotonic() + (LONGEST_WAIT if who in MAY_SEE else QUIET_WAIT)
        latched = False
        while not latched and time.monotonic() < until:
            latched = bool(bus.take(0.1))
        return {
            "latched": latched,
            "tokens": "robot" in bus.processes(),
            "status": bus.ask("status") == b'"well"',
            "other question": bus.ask("map", timeout=QUIET_WAIT) is not None,
        }

    names = ("latched", "tokens", "status", "other question")
    got: dict[str, bool] = _inside(place, who, looks, dict.fromkeys(names, False))
    return {name: (got[name], who in MAY_SEE and name != "other question") for name in names}


def deceive(place: Site, who: str) -> Cells:
    """Tokens and answers that pass for a process's."""
    return {"token or answer": (_inside(place, who, place.deceived, False), False)}


VERBS: dict[str, Callable[[Site, str], Cells]] = {
    "enter": enter,
    "publish": publish,
    "subscribe": subscribe,
    "look": look,
    "deceive": deceive,
}


def _inside(place: Site, who: str, act: Callable[[Bus], Any], refused: Any) -> Any:
    try:
        with place.enter(who) as bus:
            return act(bus)
    except BusError:
        return refused
