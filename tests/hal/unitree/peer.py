"""A Go2-W or Go2 to talk to without one: the robot's side of the Unitree topics on DDS.

By hand, with the simulated robot behind it, and the stack in a second terminal:

    python -m tests.hal.unitree.peer --body mujoco --scene yard
    rbtrg-robot up --backend unitree --interface lo

Faults are given as `--fault deaf=6 --fault busy=8` and changed while it runs by lines on standard input:
`fault low_silent=1`, `release`, `quit`. With `--report` it prints one JSON line 50 times a second.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import select
import signal
import sys
import time
from dataclasses import fields
from typing import Any

from hal.lidar.config import only
from hal.robots import describe
from hal.scenes import load_scene
from hal.types import NS
from hal.unitree import api, idl
from hal.unitree.api import Request, WireError
from hal.unitree.link import L1_CLOUD, L1_IMU, LOW_STATE, SPORT_STATE, check_interface, domain_config
from hal.unitree.low.wire import LOW_CMD
from tests.hal.unitree.low.robot import MotorBody, MotorSide
from tests.hal.unitree.robot import LOW_STATE_PERIOD, Faults, KinematicBody, MujocoBody, RobotSide

CLOUDS = {"l1": L1_CLOUD, "xt16": "rt/lidar_points"}
MOST_BEHIND = NS // 20
"""[ns] that are made up for after a busy moment."""
TYPES: dict[str, Any] = {LOW_STATE: idl.LowState, SPORT_STATE: idl.SportModeState, L1_IMU: idl.Imu}


def set_fault(faults: Faults, text: str) -> None:
    """`name=value` with the type the field has."""
    name, _, value = text.partition("=")
    known = {f.name: getattr(faults, f.name) for f in fields(faults) if f.name != "refuse"}
    if name not in known:
        raise ValueError(f"unknown fault {name!r}; known: {', '.join(known)}")
    kind = type(known[name])
    setattr(faults, name, value not in ("", "0", "false") if kind is bool else kind(float(value)))


def join(interface: str, domain: int) -> Any:
    """A participant on this interface. Raises BackendError."""
    from cyclonedds.domain import Domain, DomainParticipant

    check_interface(interface)
    configured: Any = Domain(domain, domain_config(interface))
    participant: Any = DomainParticipant(domain)
    participant.configured = configured  # lives as long
    return participant


class Peer:
    """The robot's DDS endpoints."""

    def __init__(self, participant: Any, robot: RobotSide, topic: str) -> None:
        """participant: of the robot's domain; topic: of its LiDAR's clouds."""
        from cyclonedds.core import Policy, Qos
        from cyclonedds.pub import DataWriter
        from cyclonedds.sub import DataReader
        from cyclonedds.topic import Topic
        from cyclonedds.util import duration

        self.robot = robot
        self.now = 0
        """Up to where the robot has lived [ns]."""
        sensor = Qos(Policy.Reliability.BestEffort, Policy.History.KeepLast(64))
        server = Qos(Policy.Reliability.Reliable(duration(milliseconds=5)), Policy.History.KeepAll)
        client = Qos(Policy.Reliability.Reliable(duration(milliseconds=5)), Policy.History.KeepLast(50))
        self._types = {**TYPES, topic: idl.PointCloud2}
        self._writers: dict[str, Any] = {
            name: DataWriter(participant, Topic(participant, name, kind), sensor)
            for name, kind in self._types.items()
        }
        self._response: Any = idl.ResponseMessage
        self._requests: dict[str, Any] = {}
        self._answers: dict[str, Any] = {}
        for service in api.SERVICES:
            request: Any = Topic(participant, f"rt/api/{service}/request", idl.RequestMessage)
            response: Any = Topic(participant, f"rt/api/{service}/response", idl.ResponseMessage)
            self._requests[service] = DataReader(participant, request, server)
            self._answers[service] = DataWriter(participant, response, client)
        self._low_cmd: Any = None
        if isinstance(robot, MotorSide):
            newest = Qos(Policy.Reliability.BestEffort, Policy.History.KeepLast(4))
            self._low_cmd = DataReader(participant, Topic(participant, LOW_CMD, idl.LowCmd), newest)

    def step(self, wall: int) -> None:
        """Requests in, physics on, responses and telemetry out, up to `wall` [ns] since the start.

        In steps of LowState, so that none is missed after a busy moment. What a machine that cannot keep up has no time
        to say stays unsaid: the robot's clock goes on.
        """
        self.now = max(self.now, wall - MOST_BEHIND)
        while self.now + LOW_STATE_PERIOD <= wall:
            self.now += LOW_STATE_PERIOD
            self.advance(self.now)

    def advance(self, now: int) -> None:
        """One step, to `now` [ns]."""
        for service, reader in self._requests.items():
            for sample in reader.take(N=64):
                if hasattr(sample, "cdr"):
                    with contextlib.suppress(WireError):
                        self.robot.handle(service, Request.unpack(sample.cdr), now)
        if isinstance(self.robot, MotorSide):
            for sample in self._low_cmd.take(N=8):
                if hasattr(sample, "cdr"):
                    self.robot.low_cmd(sample.cdr)
        self.robot.step(now)
        for service, response in self.robot.responses(now):
            self._answers[service].write(self._response.of(response.pack()))
        for topic, messages in self.robot.outbox().items():
            for data in messages:
                self._writers[topic].write(self._types[topic].of(data))


def _robot(options: argparse.Namespace, faults: Faults, topic: str) -> RobotSide:
    """The robot that the command line asks for."""
    robot = describe(options.robot)
    if options.body == "kinematic":
        body = KinematicBody(not options.lying, wheeled=robot.wheeled)
        return RobotSide(body, faults, options.lidar, topic, robot)
    start = tuple(options.start) if options.start else None
    how = {
        "robot": robot,
        "controller": "vmc" if robot.wheeled else robot.usual,
        "seed": options.seed,
        "lidars": only(options.lidar),
        "lidar_step": options.lidar_step,
        "start": start,
    }
    if options.body == "motors":
        return MotorSide(
            MotorBody(load_scene(options.scene), not options.lying, **how), faults, options.lidar, topic
        )
    return RobotSide(MujocoBody(options.scene, not options.lying, **how), faults, options.lidar, topic, robot)


def main() -> int:
    """Run until `quit`, end of standard input (with --report), SIGTERM or Ctrl-C."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--interface", default="lo")
    parser.add_argument("--domain", type=int, default=1)
    parser.add_argument("--robot", choices=("go2w", "go2"), default="go2w")
    parser.add_argument("--body", choices=("kinematic", "mujoco", "motors"), default="kinematic")
    parser.add_argument("--scene", default="flat", help="scene of the simulated robot")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--lidar", choices=tuple(CLOUDS), default="xt16")
    parser.add_argument(
        "--lidar-step", type=int, default=2, help="keep every n-th firing of the simulated LiDAR"
    )
    parser.add_argument(
        "--start",
        type=float,
        nargs=3,
        metavar=("X", "Y", "YAW"),
        help="where the simulated robot stands [m, rad]",
    )
    parser.add_argument("--lying", action="store_true", help="start lying instead of in balance stand")
    names = ", ".join(f.name for f in fields(Faults) if f.name != "refuse")
    parser.add_argument("--fault", action="append", default=[], metavar="NAME=VALUE", help=f"one of: {names}")
    parser.add_argument("--report", action="store_true", help="print the true state as JSON lines")
    options = parser.parse_args()
    faults = Faults()
    for text in options.fault:
        set_fault(faults, text)
    topic = CLOUDS[options.lidar]
    robot = _robot(options, faults, topic)
    body = robot.body
    peer = Peer(join(options.interface, options.domain), robot, topic)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
    start = time.monotonic_ns()
    due = 0
    inputs: list[int] = [0]
    print(
        f"robot on {options.interface}, domain {options.domain}: {options.body}, {body.phase.value}",
        flush=True,
    )
    while True:
        now = time.monotonic_ns() - start
        peer.step(now)
        if options.report and now >= due:
            due = now + NS // 50
            state = {
                "t": time.monotonic(), "v": body.v, "wz": body.wz, "x": body.x, "y": body.y,
                "yaw": body.yaw, "mode": peer.robot.mode, "command": peer.robot.command, "phase": body.phase.value,
                "ended": peer.robot.ended,
                "commands": getattr(robot, "commands", 0), "stiff": getattr(body, "stiff", False),
                "soft_at": getattr(robot, "soft_at", 0.0),
                "moves": [round(at / NS, 4) for at in peer.robot.moves],
            }  # fmt: skip
            peer.robot.moves.clear()
            try:
                print(json.dumps(state), flush=True)
            except BrokenPipeError:
                return 0
        if select.select(inputs, [], [], 0.001)[0]:
            data = os.read(0, 4096).decode()
            if not data:
                if options.report:
                    return 0
                inputs = []  # started in the background: run on
            for line in data.splitlines():
                word, _, rest = line.strip().partition(" ")
                if word == "quit":
                    return 0
                if word == "release":
                    peer.robot.release(peer.now)
                elif word == "fault":
                    set_fault(faults, rest)


if __name__ == "__main__":
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit(0)
