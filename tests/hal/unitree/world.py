"""The Unitree backend and the robot's side in one process and on one clock: nothing waits, everything repeats."""

from __future__ import annotations

from typing import Any

from hal.lidar.config import only
from hal.types import NS, Phase, RobotState, VelocityCommand
from hal.unitree.api import SERVICES, Request, Response
from hal.unitree.backend import UnitreeBackend
from hal.unitree.config import UnitreeConfig
from tests.hal.unitree.robot import Faults, KinematicBody, RobotSide

HOST_EPOCH = 1_750_000_000 * NS
EVERYTHING = "all topics"
RATE = 125
"""[Hz] of LowState, a quarter of the real robot's: most of a test's time would go into reading them."""
L1 = UnitreeConfig(lidars=only("l1"))


class World:
    """One clock, one robot, and the link between the two; the link can be cut."""

    def __init__(
        self,
        faults: Faults | None = None,
        standing: bool = True,
        options: UnitreeConfig = L1,
        body: Any = None,
        epoch: int = HOST_EPOCH,
        rate: int = RATE,
        **kwargs: Any,
    ) -> None:
        """rate: of LowState [Hz]."""
        self.epoch, self._step = epoch, NS // rate
        self.body: Any = body or KinematicBody(standing, wheeled=options.robot.wheeled)
        lidar = options.lidars[0] if options.lidars else None
        topic = options.topic(lidar) if lidar else ""
        self.robot = RobotSide(
            self.body, faults, lidar=lidar.model if lidar else "", topic=topic, robot=options.robot, rate=rate
        )
        self.faults = self.robot.faults
        self.elapsed = 0
        self.cut = False
        self.sent: list[tuple[int, str, Request]] = []
        self.late: dict[str, float] = {}
        """[s] that messages of a topic take, and answers of a service; `EVERYTHING` for all topics."""
        self._way: dict[str, list[tuple[int, Any]]] = {}
        """What is under way, by topic and service: when it comes [ns], and what."""
        self.backend = UnitreeBackend(
            "lo", options=options, link=self, clock=lambda: self.now, sleep=self.advance, **kwargs
        )
        self.other: RobotSide | None = None
        """Another robot on the same network."""
        self._spoke: list[int] = []
        self.states: list[RobotState] = []
        self.samples: list = []

    @property
    def now(self) -> int:
        return self.epoch + self.elapsed

    # -- link ----------------------------------------------------------------------------------------------------
    def send(self, service: str, request: Request) -> None:
        self.sent.append((self.elapsed, service, request))
        if not self.cut:
            for robot in self._robots:
                robot.handle(service, Request.unpack(request.pack()), self.elapsed)

    def responses(self, service: str) -> list[Response]:
        return self._come(service)

    def take(self, topic: str) -> list[bytes]:
        return self._come(topic)

    def _leave(self, name: str, what: Any, late: float, speaker: int) -> None:
        """Onto the way, which keeps the order."""
        way = self._way.setdefault(name, [])
        due = self.elapsed + round(late * NS)
        way.append((max(due, way[-1][0]) if way else due, what, speaker))

    def _come(self, name: str) -> list:
        way = self._way.get(name, [])
        here = [(what, speaker) for due, what, speaker in way if due <= self.elapsed]
        self._way[name] = way[len(here) :]
        self._spoke = [speaker for _, speaker in here]
        return [what for what, _ in here]

    def speakers(self, topic: str) -> list[int]:
        return self._spoke

    def reachable(self, service: str) -> bool:
        return service in SERVICES

    def clouds(self) -> dict[str, str]:
        return {}

    def close(self) -> None:
        pass

    def begin(self) -> None:
        """From now on the host's clock counts from 0: whoever drives it began with that while this one was
        connecting."""
        self.epoch = -self.elapsed

    # -- time ----------------------------------------------------------------------------------------------------
    def advance(self, seconds: float) -> None:
        end = self.elapsed + round(seconds * NS)
        while self.elapsed < end:
            self.elapsed = min(end, self.elapsed + self._step)
            for number, robot in enumerate(self._robots):
                robot.step(self.elapsed)
                for service, response in robot.responses(self.elapsed):
                    if not self.cut:
                        self._leave(service, response, self.late.get(service, 0.0), number)
                for topic, messages in robot.outbox().items():
                    late = self.late.get(topic, self.late.get(EVERYTHING, 0.0))
                    for message in () if self.cut else messages:
                        self._leave(topic, message, late, number)

    @property
    def _robots(self) -> list[RobotSide]:
        return [self.robot] if self.other is None else [self.robot, self.other]

    def run(self, seconds: float, vx: float = 0.0, wz: float = 0.0) -> list:
        """The host's 50 Hz loop."""
        samples: list = []
        for _ in range(round(seconds / 0.02)):
            self.advance(0.02)
            samples += self.backend.read(self.now)
            self.backend.drive(VelocityCommand(self.now, vx=vx, wz=wz))
            self.states.append(self.backend.state())
        self.samples += samples
        return samples

    def until(self, phase: Phase, seconds: float, vx: float = 0.0) -> RobotState:
        for _ in range(round(seconds / 0.02)):
            if self.backend.state().phase is phase:
                return self.backend.state()
            self.run(0.02, vx)
        raise AssertionError(f"no {phase} within {seconds} s: {self.backend.state()}")

    def apis(self, service: str = "sport") -> list[int]:
        return [r.api for _, s, r in self.sent if s == service]

    @property
    def phase(self) -> Phase:
        return self.backend.state().phase

    @property
    def cause(self) -> str:
        return self.backend.state().cause
