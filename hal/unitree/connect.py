"""Finding the robot: the topics its backend listens to, and the wait for its first words."""

from __future__ import annotations

import logging
from collections.abc import Callable

from hal.contract import BackendError
from hal.safety.monitors import TWO_ROBOTS
from hal.types import NS
from hal.unitree.config import UnitreeConfig
from hal.unitree.link import CUSTOM, L1_IMU, LOW_STATE, SPORT_STATE, DdsLink, Link
from hal.unitree.telemetry import Telemetry

log = logging.getLogger(__name__)


def open_link(interface: str, domain: int, options: UnitreeConfig) -> Link:
    """DDS on this interface, with the readers these options need."""
    from hal.unitree import idl

    topics: list[tuple[str, object, int]] = [
        (LOW_STATE, idl.LowState, 256),
        (SPORT_STATE, idl.SportModeState, 64),
    ]
    if options.carries_l1:
        topics.append((L1_IMU, idl.Imu, 128))
    topics += [(options.topic(lidar), idl.PointCloud2, 4) for lidar in options.lidars]
    topics += [(options.topic(x) + CUSTOM, idl.CustomMsg, 4) for x in options.lidars if x.model == "mid360"]
    return DdsLink(interface, domain, topics)


LISTEN_TIME = 0.1
"""[s] at the start, before and after the first requests: long enough for another robot's LowState (500 Hz) and
answer."""


def listen_alone(
    several: Callable[[], str],
    tick: Callable[[], None],
    clock: Callable[[], int],
    sleep: Callable[[float], None],
) -> None:
    """Nobody is commanded before it is sure who hears it. `tick` hears the robot, `several` names more than one. Raises
    BackendError."""
    until = clock() + round(LISTEN_TIME * NS)
    while clock() < until:
        tick()
        if found := several():
            raise BackendError(f"{found}; {TWO_ROBOTS.remedy}", retry=False)
        sleep(0.005)


def wait_for_robot(
    telemetry: Telemetry,
    options: UnitreeConfig,
    where: str,
    clock: Callable[[], int],
    sleep: Callable[[float], None],
) -> None:
    """Until LowState and sportmodestate arrive; without the latter it goes on, without the former BackendError.

    `where` names the network in the message.
    """
    where = f"{where}, within {options.connect_timeout:.0f} s"
    deadline = clock() + round(options.connect_timeout * NS)
    while True:
        now = clock()
        telemetry.read(now)
        if telemetry.low_age(now) < options.state_timeout and telemetry.sport is not None:
            return
        if now > deadline:
            break
        sleep(0.01)
    if telemetry.low is None and telemetry.low_unread:
        raise BackendError(
            f"LowState from the robot {where}, but it cannot be read: {telemetry.low_unread}; is this a Go2-W? "
            "unitree.check_crc=false takes it unchecked",
            retry=False,
        )
    if telemetry.low is None:
        raise BackendError(
            f"no LowState from the robot {where}: is it switched on, is the cable in, is this the robot's network "
            "(192.168.123.0/24), and is the domain right (0 on the robot)?"
        )
    if telemetry.sport is not None:
        raise BackendError(f"LowState stopped arriving {where}: check cable and robot")
    # A robot whose motion service was released sends no sportmodestate; taking control selects it again.
    log.warning("no sportmodestate %s: trying to select the motion service", where)
