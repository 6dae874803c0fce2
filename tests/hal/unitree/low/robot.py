"""The robot's side at its motors: MuJoCo behind LowCmd and LowState, and one clock for robot, motor loop and host."""

from __future__ import annotations

import time
from typing import Any

import mujoco
import numpy as np

from hal.lidar.config import only
from hal.lowlevel import LowCommand, LowState
from hal.postures.modes import Modes
from hal.postures.motion import damped
from hal.robots.go2w.locomotion.controllers import controller_of
from hal.scenes import Scene
from hal.types import NS, Phase, VelocityCommand
from hal.unitree.api import Request, Response, WireError
from hal.unitree.config import UnitreeConfig
from hal.unitree.layout import LOW_CMD_CDR, low_cmd_checksum, view
from hal.unitree.link import LOW_STATE
from hal.unitree.low.backend import LowLevelBackend
from hal.unitree.low.handle import Motors
from hal.unitree.low.loop import MotorLoop, Order, Report
from hal.unitree.low.wire import LOW_CMD
from tests.hal.unitree.robot import Faults, MujocoBody, RobotSide

LOW = UnitreeConfig(level="low", tried=("vmc", "hybrid", "policy"), lidars=only("xt16"))


def walled_floor() -> Scene:
    """12 x 12 m of flat ground between low walls."""
    height = np.zeros((241, 241), np.float32)
    height[:6] = height[-6:] = height[:, :6] = height[:, -6:] = 0.8
    return Scene("floor", height, 0.05, (-6.0, -6.0), (-2.0, 0.0, 0.0), {})


class Switch:
    """In place of the simulator's own postures: the motors follow those, or LowCmd once the motion service is
    released."""

    def __init__(self, modes: Modes) -> None:
        self.modes = modes
        self.command: LowCommand | None = None
        self.stuck = False

    def __getattr__(self, name: str) -> Any:
        return getattr(self.modes, name)

    def step(self, low: LowState) -> LowCommand:
        return self.modes.step(low) if self.command is None else self.command


class MotorBody(MujocoBody):
    """The simulated Go2-W, its motors open to LowCmd."""

    def __init__(self, scene: Any = None, standing: bool = False, **options: Any) -> None:
        options = {"lidars": only("xt16"), "lidar_step": 20, "controller": "vmc"} | options
        super().__init__(scene or walled_floor(), standing, timestep=0.002, **options)
        self.switch = self._backend._modes = Switch(self._backend._modes)  # type: ignore[assignment]
        self._backend._control_steps = 1

    @property
    def simulation(self) -> Any:
        return self._backend.simulation

    def advance(self, now: int) -> None:
        super().advance(now)
        low = self._backend._low
        self.q, self.dq, self.tau = low.q, low.dq, low.tau
        self.gyro, self.accel, self.quaternion = low.gyro, low.accel, low.quaternion

    @property
    def stiff(self) -> bool:
        """Whether a LowCmd holds the joints."""
        return self.switch.command is not None and bool(self.switch.command.kp.any())

    def throw_over(self) -> None:
        """Onto its side."""
        data = self.simulation.data
        data.qpos[2] += 0.25
        data.qpos[3:7] = [np.sqrt(0.5), np.sqrt(0.5), 0.0, 0.0]
        data.qvel[:] = 0.0
        mujoco.mj_forward(self.simulation.model, data)
        self._backend.placed()


class MotorSide(RobotSide):
    """Services, LowState and LowCmd of one robot. A motor without a new command follows its last one."""

    body: MotorBody

    def __init__(
        self,
        body: MotorBody,
        faults: Faults | None = None,
        lidar: str = "xt16",
        topic: str = "rt/lidar_points",
    ) -> None:
        super().__init__(body, faults, lidar, topic)
        self.commands = self.fought = self.broken = 0
        """LowCmd that were followed, that came while the motion service had the motors, and with a wrong head or
        checksum."""
        self.stuck = False
        """The motors hold what they were last told."""
        self.soft_at = 0.0
        """When a LowCmd made the motors soft [s, monotonic]."""
        self._owned = True

    def low_cmd(self, data: bytes) -> None:
        """A LowCmd message."""
        try:
            command = view(data, LOW_CMD_CDR)
        except WireError:
            self.broken += 1
            return
        if (
            command["crc"] != low_cmd_checksum(data)
            or tuple(command["head"]) != (0xFE, 0xEF)
            or command["level_flag"] != 0xFF
        ):
            self.broken += 1
        elif self.motion:
            self.fought += 1
        elif not self.stuck:
            self.commands += 1
            stiff = self.body.stiff
            motors = command["motor_cmd"]
            values = (motors[name][:16].astype(np.float64) for name in ("q", "dq", "tau", "kp", "kd"))
            self.body.switch.command = LowCommand(*values)
            if stiff and not self.body.stiff:
                self.soft_at = time.monotonic()

    def step(self, now: int) -> None:
        if self._owned and not self.motion:
            self.body.switch.command = damped(0.0)  # torque drops at once
        elif self.motion and not self._owned:
            self.body.switch.command = None
            self.body.switch.modes.begin(self.body._backend._low, seated=True)
        self._owned = bool(self.motion)
        super().step(now)

    def _quaternion(self) -> tuple[float, float, float, float]:
        w, x, y, z = (float(v) for v in getattr(self.body, "quaternion", (1.0, 0.0, 0.0, 0.0)))
        return w, x, y, z


class LoopHere:
    """`Motors` whose loop runs on the world's clock."""

    def __init__(self, world: LowWorld, settings: dict[str, Any]) -> None:
        self._world = world
        for name in ("interface", "domain"):
            settings.pop(name)
        controller = controller_of(settings.pop("controller"), settings.pop("policy"))
        self.loop = MotorLoop(controller, **settings)
        self.died = ""
        self._ticked = False

    def tick(self) -> None:
        """One period."""
        if self.died or self.loop.finished:
            return
        now = self._world.elapsed / NS
        message = self.loop.tick(now)
        if message is not None:
            self._world.robot.low_cmd(message)
        self._ticked = True

    def tell(self, order: Order) -> None:
        if not self.died:
            self.loop.order(Order.unpack(order.pack()), self._world.elapsed / NS)

    def report(self) -> Report | None:
        return self.loop.report() if self._ticked else None

    def lost(self) -> str:
        return self.died

    def close(self) -> None:
        until = self._world.elapsed + 12 * NS
        while not (self.died or self.loop.finished):
            assert self._world.elapsed < until, "the loop does not end"
            self.loop.leave(self._world.elapsed / NS)
            self._world.advance(0.002)


class LowWorld:
    """One robot, one motor loop, one host, one clock. It is the host's `Link`."""

    def __init__(
        self, faults: Faults | None = None, options: UnitreeConfig = LOW, controller: Any = "vmc", **body: Any
    ) -> None:
        self.body = MotorBody(**body)
        self.robot = MotorSide(self.body, faults)
        self.faults = self.robot.faults
        self.elapsed = 0
        self.cut = False
        """Nothing comes from the robot any more."""
        self.others = 0
        """Other programs that send LowCmd."""
        self.loops: list[LoopHere] = []
        self.requests: list[tuple[str, int]] = []
        self._come: dict[str, list] = {}
        self.backend = LowLevelBackend(
            "lo",
            options=options,
            controller=controller,
            link=self,
            clock=lambda: self.elapsed,
            sleep=self.advance,
            motors=self._start,
        )

    def _start(self, settings: dict[str, Any]) -> Motors:
        self.loops.append(LoopHere(self, settings))
        return self.loops[-1]

    @property
    def loop(self) -> LoopHere:
        return self.loops[-1]

    # -- link ----------------------------------------------------------------------------------------------------
    def send(self, service: str, request: Request) -> None:
        self.requests.append((service, request.api))
        self.robot.handle(service, Request.unpack(request.pack()), self.elapsed)

    def responses(self, service: str) -> list[Response]:
        return self._come.pop(service, [])

    def publish(self, topic: str, message: bytes) -> None:
        raise AssertionError("the host itself never speaks to the motors")

    def publishers(self, topic: str) -> int:
        assert topic == LOW_CMD
        return self.others

    def take(self, topic: str) -> list[bytes]:
        messages = self._come.pop(topic, [])
        self._spoke = len(messages)
        return messages

    def speakers(self, topic: str) -> list[int]:
        return [0] * self._spoke

    def reachable(self, service: str) -> bool:
        return True

    def clouds(self) -> dict[str, str]:
        return {}

    def close(self) -> None:
        pass

    # -- time ----------------------------------------------------------------------------------------------------
    def advance(self, seconds: float) -> None:
        end = self.elapsed + round(seconds * NS)
        while self.elapsed < end:
            self.elapsed = min(end, self.elapsed + 2_000_000)
            self.robot.step(self.elapsed)
            for service, response in self.robot.responses(self.elapsed):
                self._come.setdefault(service, []).append(response)
            for topic, messages in self.robot.outbox().items():
                for message in () if self.cut else messages:
                    self._come.setdefault(topic, []).append(message)
                    if topic == LOW_STATE and self.loops:
                        self.loop.loop.hear(message, self.elapsed / NS)
            if self.loops:
                self.loop.tick()

    def run(self, seconds: float, vx: float = 0.0, wz: float = 0.0) -> list:
        """The host's 100 Hz loop."""
        samples: list = []
        for _ in range(round(seconds / 0.01)):
            self.advance(0.01)
            samples += self.backend.read(self.elapsed)
            self.backend.drive(VelocityCommand(self.elapsed, vx=vx, wz=wz))
        return samples

    @property
    def phase(self) -> Phase:
        return self.backend.state().phase

    @property
    def cause(self) -> str:
        return self.backend.state().cause

    def until(self, phase: Phase, seconds: float = 15.0) -> Any:
        for _ in range(round(seconds / 0.05)):
            if self.backend.state().phase is phase:
                return self.backend.state()
            self.run(0.05)
        raise AssertionError(f"no {phase} within {seconds} s: {self.backend.state()}")
