"""A watch on the robot's own computer: stops the robot when the commands from another computer cease.

    python -m hal.unitree.sentry eth0

The robot holds the last Move for a second. The guardian beside the driver shortens that when the driver dies, but it
dies with its computer and is cut off with its cable. This process runs on the robot's side of the cable, for example
on the onboard computer. It hears the same Moves that the robot hears; when they cease without a stop it sends
StopMove until the robot rests, and Damp where it rolls on (`hal.unitree.motion`). It asks nothing of the driver and
never moves the robot.

It is the one module of this library with a command line: the robot's computer needs nothing of the stack but this."""

from __future__ import annotations

import argparse
import json
import logging
import signal
import sys
import time
from collections.abc import Callable

from hal.contract import BackendError
from hal.unitree import api
from hal.unitree.api import Request, WireError
from hal.unitree.factory import check
from hal.unitree.guardian import LONGEST_SILENCE, Order, motion_topics
from hal.unitree.motion import GO2W_WHEELS, Wheels

log = logging.getLogger(__name__)

TOPICS = {service: f"rt/api/{service}/request" for service in (api.SPORT, api.OBSTACLES_AVOID)}
ENDS = (
    api.Sport.STOP_MOVE,
    api.Sport.DAMP,
    api.Sport.STAND_UP,
    api.Sport.STAND_DOWN,
    api.Sport.RECOVERY_STAND,
)
"""Calls that end a Move. The rest may come from programs that set something else, or ask: one StopMove too many does
no harm."""
POLL_PERIOD = 0.01
"""[s]"""


def velocity(service: str, request: Request) -> float | None:
    """Largest component of a Move [m/s or rad/s]; None for other requests. Raises WireError."""
    move = api.Sport.MOVE if service == api.SPORT else api.ObstaclesAvoid.MOVE
    if request.api != move:
        return None
    try:
        values = json.loads(request.parameter)
        return max(abs(float(values.get(name, 0.0))) for name in ("x", "y", "z", "yaw"))
    except (ValueError, TypeError, AttributeError, OverflowError, RecursionError) as error:
        raise WireError(f"Move with parameter {request.parameter[:40]!r}") from error


class Sentry:
    """`step` with what was heard; insists on StopMove when Moves cease."""

    def __init__(self, order: Order) -> None:
        self._order = order
        self._heard: float | None = None
        """When the last Move with a velocity came [s]; None when the robot was told to rest since."""

    def step(self, now: float, heard: list[tuple[str, Request]]) -> None:
        """`now` [s, monotonic]; `heard`: service and request, in order."""
        for service, request in heard:
            try:
                speed = velocity(service, request)
            except WireError as error:
                log.warning("%s", error)
                continue
            if speed is not None:
                self._heard = None if speed == 0.0 else now
                self._order.avoid = service == api.OBSTACLES_AVOID
                if speed != 0.0:
                    self._order.halt.end()
            elif service == api.SPORT and request.api in ENDS and not self._order.sent(request):
                self._heard = None
                self._order.halt.end()
        if self._heard is not None and now - self._heard > LONGEST_SILENCE:
            log.warning("Moves ceased for %.2f s without a stop: stopping the robot", now - self._heard)
            self._heard = None
            self._order.give(api.Sport.STOP_MOVE, now)
        self._order.pump(now)


def main(
    interface: str, domain: int, stopping: Callable[[], bool], wheels: Wheels | None = GO2W_WHEELS
) -> None:
    """Watch until told to end. Raises BackendError."""
    from hal.unitree import idl
    from hal.unitree.link import DdsLink

    topics = [*((name, idl.RequestMessage, 64) for name in TOPICS.values()), *motion_topics()]
    link = DdsLink(interface, domain, topics, TOPICS)
    sentry = Sentry(Order(link, avoid=False, wheels=wheels))
    log.info("watching %s, domain %d", interface, domain)
    while not stopping():
        heard = []
        for service, topic in TOPICS.items():
            for data in link.take(topic):
                try:
                    heard.append((service, Request.unpack(data)))
                except WireError as error:
                    log.warning("%s: %s", topic, error)
        sentry.step(time.monotonic(), heard)
        time.sleep(POLL_PERIOD)
    link.close()


def run() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(
        prog="python -m hal.unitree.sentry",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("interface", help="network interface of the robot's network")
    parser.add_argument("--domain", type=int, help="DDS domain; default 0, on lo 1")
    parser.add_argument("--feet", action="store_true", help="the robot stands on feet, as a Go2 does")
    options = parser.parse_args()
    domain = options.domain if options.domain is not None else int(options.interface == "lo")
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(levelname)s %(message)s")
    ended: list[int] = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda got, _frame: ended.append(got))
    try:
        check(options.interface)
        main(options.interface, domain, lambda: bool(ended), None if options.feet else GO2W_WHEELS)
    except BackendError as error:
        print(f"sentry: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(run())
