"""A robot in MuJoCo behind the contract of `hal.contract`: sensors, modes, commands, faults. Same seed, same bytes."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from hal.contract import BackendError
from hal.lidar.caster import OrientedBox, TerrainCaster
from hal.lidar.config import LidarConfig
from hal.lidar.simulator import LidarSimulator
from hal.lowlevel import Ground, Locomotion, Sighted
from hal.mujoco.config import Obstacle, Push, SimConfig
from hal.mujoco.obstacles import box_at, present
from hal.mujoco.people import PERSON_SIZE, People
from hal.mujoco.sensors import DelayLine, Sensors, imu_sample, joint_sample
from hal.mujoco.sim import Simulation
from hal.postures.modes import Modes
from hal.robots import Robot, describe
from hal.rotation import up_of
from hal.scenes import Scene
from hal.types import (
    NS,
    GroundTruth,
    ModeRequest,
    Phase,
    PostureCommand,
    RobotState,
    Sample,
    VelocityCommand,
)
from hal.wheel_force import CONTACT_FORCE, wheel_loads

CONTROL_PERIOD = 0.005
"""Of the model-based controller [s], or the multiple of the time step nearest to it."""
IMU_PERIOD = NS // 200
JOINT_PERIOD = NS // 50
TRUTH_PERIOD = NS // 50
STATE_PERIOD = NS // 10
LIDAR_SLICE = NS // 100
"""Rays are cast this often, from where the sensor is then."""
MOST_BACKLOG = 2 * NS
"""`read` refuses to advance further in one call: the host's clock jumped."""


class MujocoBackend:
    """`hal.contract.Backend` on `scene`. Raises BackendError, PolicyError."""

    def __init__(
        self,
        scene: Scene,
        config: SimConfig | None = None,
        *,
        robot: Robot | None = None,
        controller: str = "vmc",
        policy_dir: str = "",
        lidars: tuple[LidarConfig, ...] | None = None,
        seed: int = 0,
        start: tuple[float, float, float] | None = None,
        start_time: int = 0,
        **changes: Any,
    ) -> None:
        """
        robot: what it is; None takes the default one
        controller: of those in its description
        policy_dir: folder of a policy in rl_sar's layout, or a file of `tools.train`; of the controllers that learnt
        lidars: empty for none (physics only, faster); None for those it is delivered with
        seed: of everything random here
        start: x, y [m], yaw [rad]; None for the scene's
        start_time: source clock at connect [ns]
        changes: fields of SimConfig that replace those of `config`; pydantic's ValidationError for a bad one
        """
        self.config = o = config or SimConfig()
        if changes:
            self.config = o = SimConfig.model_validate({**o.model_dump(), **changes})
        self.scene = scene
        robot = robot or describe()
        lidars = robot.mounted(robot.lidars if lidars is None else lidars)
        self.start_time = start_time
        self._start, self._seed = start, seed
        self._fitted = lidars
        self._dt = round(o.timestep * NS)
        self._imu_delay, self._joint_delay = round(o.imu_delay * NS), round(o.joint_delay * NS)
        self._lidar_delay = round(o.lidar_delay * NS)
        period = o.timestep * max(1, round(CONTROL_PERIOD / o.timestep))
        model = robot.model()
        self.capabilities = replace(
            robot.capabilities(controller),
            name=f"{robot.name}-mujoco-{controller}",
            lidars=tuple(lidar.mounted() for lidar in lidars),
        )
        self.controller: Locomotion = model.controller(controller, policy_dir, period)
        self.places = self.controller.places if isinstance(self.controller, Sighted) else np.empty((0, 2))
        """(m, 2), see `hal.lowlevel.Sighted`."""
        self._control_steps = max(1, round(self.controller.period * NS / self._dt))
        draw = np.random.default_rng(np.random.SeedSequence([seed, 0xF12]))
        self.friction = (
            scene.friction if o.friction is None else o.friction
        ) + o.friction_spread * draw.uniform(-1, 1)
        self.simulation = Simulation(
            scene.height,
            scene.resolution,
            scene.origin,
            friction=self.friction,
            timestep=o.timestep,
            payload=o.payload,
            command_delay=o.command_delay,
            robot=model,
            boxes=(*(box.size for box in o.obstacles), *[PERSON_SIZE] * o.people),
        )
        self._caster = scene.caster() if lidars else None
        self._modes = Modes(self.controller, model.legs)
        self._limbs = model.limbs
        self._connected = False
        self._state = RobotState(start_time, Phase.DISCONNECTED, self._modes.cause, o.battery)

    # --- contract --------------------------------------------------------------------------------------------------
    def connect(self) -> None:
        """Put the robot at its start and begin. The source clock starts at `start_time`."""
        o = self.config
        x, y, yaw = self._start or self.scene.start
        if not self.scene.contains(x, y):
            raise BackendError(
                f"start ({x:.2f}, {y:.2f}) lies outside scene {self.scene.name}: choose another start",
                retry=False,
            )
        legs = self.simulation.robot.legs
        self.simulation.reset(x, y, yaw, q=None if legs is None or not o.seated else legs.seat)
        self._steps = 0
        self._ran = 0
        self._sensors = Sensors(self._seed, o.noise)
        self._out = DelayLine()
        self._lidars = [
            self._simulated(lidar, self._caster) for lidar in self._fitted if self._caster is not None
        ]
        self._pushes = sorted(o.pushes, key=lambda push: push.time)
        self._shown: tuple[bool, ...] = (False,) * len(o.obstacles)
        self._people = People(o.people, self._seed)
        self._moving = o.people > 0 or any(box.velocity != (0.0, 0.0) for box in o.obstacles)
        self._low = self._sensors.measure(self.simulation.low_state())
        self._modes.begin(self._low, o.seated)
        self._connected = True
        self._contact = (True, True, True, True)
        self._state_due = 0
        self._place_obstacles(0)
        self._publish(0)

    def read(self, now: int) -> list[Sample]:
        """Advance the physics to `now` [ns] and return what its sensors delivered meanwhile, in order of delivery."""
        if not self._connected:
            return []
        target = (now - self.start_time) // self._dt
        if (target - self._steps) * self._dt > MOST_BACKLOG:
            raise BackendError(
                f"asked to simulate {(target - self._steps) * self._dt / NS:.1f} s at once: the clock jumped; "
                "read at least every 2 s"
            )
        while self._steps < target:
            self._advance()
        return self._out.take(max(now, self.start_time))

    def drive(self, command: VelocityCommand) -> None:
        """Velocity until the next call; takes effect at the next control tick."""
        if not all(map(math.isfinite, (command.vx, command.vy, command.wz))):
            raise BackendError("velocity must be finite: put the safety gate in front of the backend")
        self._modes.drive(command)

    def posture(self, command: PostureCommand) -> None:
        """Trunk height and attitude offsets until the next call."""
        self._check_connected()
        self._modes.posture(command)

    def request(self, mode: ModeRequest) -> None:
        """Start a transition; see `hal.postures.modes`."""
        self._check_connected()
        self._modes.request(mode)

    def see(self, ground: Ground) -> None:
        """The ground at `places`, for the controller."""
        if isinstance(self.controller, Sighted):
            self.controller.see(ground)

    def state(self) -> RobotState:
        """Newest summary state."""
        return self._state

    def diagnostics(self) -> dict[str, float]:
        """None: no clock and no wire lies between here and the simulated robot."""
        return {}

    def close(self, *, lie_down: bool = True) -> None:
        """Damp the motors and stop the clock: with its simulator the robot is gone, on its feet or not."""
        self._connected = False
        self._modes.disconnect()
        self._state = replace(self._state, phase=self._modes.phase, cause=self._modes.cause)

    def _simulated(self, lidar: LidarConfig, caster: TerrainCaster) -> LidarSimulator:
        o = self.config
        spec = lidar.spec.decimated(o.lidar_step) if lidar.name == "main" else lidar.spec
        return LidarSimulator(
            spec,
            lidar.mounted().mount,
            caster,
            self._seed,
            noise=o.noise,
            name=lidar.name,
            blocks=self.simulation.robot.blocks,
            plants=self.scene.plants,
            parts=[OrientedBox(part.centre, part.size) for part in o.parts],
        )

    def _check_connected(self) -> None:
        if not self._connected:
            raise BackendError("not connected: call connect() first")

    # --- for tests, benchmarks and trouble -------------------------------------------------------------------------
    def push(self, force: tuple[float, float, float], duration: float = 0.2) -> None:
        """Push the trunk with `force` [N], world axes, for `duration` [s] from now."""
        self.simulation.push(force, duration)

    def placed(self) -> None:
        """The simulation was given another attitude from outside, which no gyro felt: the attitude filter settles
        there."""
        self._sensors.placed()

    # --- one physics step ------------------------------------------------------------------------------------------
    def _advance(self) -> None:
        if self._steps % self._control_steps == 0:
            self.simulation.apply(self._modes.step(self._low))
        while self._pushes and self._pushes[0].time * NS <= self._steps * self._dt:
            push = self._pushes.pop(0)
            self.simulation.push(push.force, push.duration)
        self.simulation.step()
        self._steps += 1
        elapsed = self._steps * self._dt
        control = self._steps % self._control_steps == 0
        if control or elapsed % IMU_PERIOD < self._dt:
            self._low = self._sensors.measure(self.simulation.low_state())
        if self.config.obstacles or self.config.people:
            self._place_obstacles(elapsed)
        self._publish(elapsed)

    def _publish(self, elapsed: int) -> None:
        """Everything due after the step that ended `elapsed` [ns] after connect."""
        o, dt = self.config, self._dt
        stamp = self.start_time + elapsed
        if elapsed % IMU_PERIOD < dt:
            self._out.put(stamp + self._imu_delay, imu_sample(stamp, self._low))
        if elapsed % JOINT_PERIOD < dt:
            self._out.put(stamp + self._joint_delay, joint_sample(stamp, self._low))
            self._watch()
        if self._lidars and elapsed % LIDAR_SLICE < dt:
            position, quaternion = self.simulation.position, self.simulation.quaternion
            for lidar in self._lidars:
                scan = lidar.advance(stamp, position, quaternion)
                if scan is not None:
                    self._out.put(stamp + self._lidar_delay, scan)
        if elapsed % TRUTH_PERIOD < dt:
            self._out.put(stamp, self._truth(stamp))
        phase, cause = self._modes.phase, self._modes.cause
        if elapsed >= self._state_due or phase is not self._state.phase or cause != self._state.cause:
            self._state_due = elapsed - elapsed % STATE_PERIOD + STATE_PERIOD
            load = wheel_loads(self._limbs, self._low.q, self._low.tau, np.array(up_of(self._low.quaternion)))
            fr, fl, rr, rl = (load > CONTACT_FORCE).tolist()
            self._contact = fr, fl, rr, rl
            temperature = 30.0 + 10.0 * min(elapsed / NS / 1800.0, 1.0)
            battery = max(o.battery - elapsed / NS / o.battery_life, 0.0)
            self._state = RobotState(stamp, phase, cause, battery, temperature, self._contact)
            self._out.put(stamp, self._state)

    def _truth(self, stamp: int) -> GroundTruth:
        sim = self.simulation
        w, x, y, z = sim.quaternion
        return GroundTruth(
            stamp, sim.position, np.array([x, y, z, w]), sim.linear_velocity, sim.angular_velocity
        )

    def _watch(self) -> None:
        """A fault that only a simulation can have."""
        sim = self.simulation
        if self._modes.phase is Phase.FAULT:
            return
        if sim.diverged:
            self._modes.fault("the simulation diverged; restart it with a smaller timestep")
        elif not self.scene.contains(*sim.position[:2].tolist()):
            self._modes.fault(f"left the terrain of scene {self.scene.name}; restart the simulation")

    def _place_obstacles(self, elapsed: int) -> None:
        t = elapsed / NS
        shown = tuple(present(box, t) for box in self.config.obstacles)
        due = elapsed % LIDAR_SLICE < self._dt
        if shown == self._shown and not (self._moving and (any(shown) or self.config.people) and due):
            return
        self._shown = shown
        boxes: list[OrientedBox | None] = [
            box_at(box, t) if on else None for box, on in zip(self.config.obstacles, shown, strict=True)
        ]
        seen = [
            box
            for box, obstacle in zip(boxes, self.config.obstacles, strict=True)
            if box is not None and not obstacle.clear
        ]
        x, y, _ = self.simulation.position.tolist()
        people = self._people.at(t, (x, y))
        for index, box in enumerate([*boxes, *people]):
            self.simulation.place_box(
                index, None if box is None else box.centre, 0.0 if box is None else box.yaw
            )
        for lidar in self._lidars:
            lidar.set_boxes([*seen, *people])


__all__ = ["MujocoBackend", "Obstacle", "Push", "SimConfig"]
