"""The bare robot in MuJoCo behind the joint-level interface: no sensors' errors, no modes, no clock of its own."""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from hal.limbs import LEGS, MOTORS, WHEEL_JOINTS, wheel_centres
from hal.lowlevel import LowCommand, LowState
from hal.mujoco.contacts import ContactReader, Contacts
from hal.mujoco.model import HIDDEN_PLACE, build
from hal.mujoco.robot import Simulated
from hal.robots import describe
from hal.types import Array

log = logging.getLogger(__name__)

STAND_KP = 70.0
STAND_KD = 5.0
"""Gains of the vendor's stand-up example [Nm/rad, Nms/rad]."""
SETTLE_KP = 300.0
"""Stiff, so that the robot stands where it is put."""
LONGEST_LEG, SHORTEST_LEG = 0.38, 0.12
"""Reach of the wheel centre below base_link [m] that leaves room to move."""

_BAD = [
    int(mujoco.mjtWarning.mjWARN_BADQPOS),
    int(mujoco.mjtWarning.mjWARN_BADQVEL),
    int(mujoco.mjtWarning.mjWARN_BADQACC),
]


def stand_command(q: Array, kp: float = STAND_KP) -> LowCommand:
    """Hold the leg pose `q` (16,) [rad] with braked wheels and stiffness `kp` [Nm/rad]."""
    stiffness = np.full(16, kp)
    stiffness[WHEEL_JOINTS] = 0.0
    return LowCommand(
        q=np.array(q),
        dq=np.zeros(16),
        tau=np.zeros(16),
        kp=stiffness,
        kd=np.full(16, STAND_KD),
    )


class Simulation:
    """A robot on a heightfield.

    Motors follow hal.lowlevel's torque law with the damping integrated implicitly; torque is cut at the speed limit.
    `command_delay` [s] holds every LowCommand back before it reaches the motors (a multiple of `timestep`).
    """

    def __init__(
        self,
        height: NDArray[np.float32],
        resolution: float,
        origin: tuple[float, float],
        friction: float = 0.8,
        timestep: float = 0.005,
        payload: float = 0.0,
        command_delay: float = 0.0,
        boxes: Sequence[tuple[float, float, float]] = (),
        housings: bool = True,
        robot: Simulated | None = None,
    ) -> None:
        """robot: None takes the default one."""
        # By default MuJoCo writes its warnings, of all simulations of a process, to a file in the working directory.
        mujoco.set_mju_user_warning(log.warning)
        self.robot: Simulated = robot or describe().model()
        self._limbs = self.robot.limbs
        self.height = np.ascontiguousarray(height, np.float32)
        self.resolution = float(resolution)
        self.origin = (float(origin[0]), float(origin[1]))
        self.timestep = float(timestep)
        self.model = build(
            self.height,
            self.resolution,
            self.origin,
            self.robot,
            friction=friction,
            timestep=timestep,
            payload=payload,
            boxes=boxes,
            housings=housings,
        )
        self.data = mujoco.MjData(self.model)
        self._delay = round(command_delay / timestep)
        self._pending: deque[tuple[int, LowCommand]] = deque()
        self._steps = 0
        actuators = [self.model.actuator(k).name for k in range(self.model.nu)]
        joint = [self.model.joint(name) for name in actuators]
        self._has = (
            slice(None) if tuple(actuators) == MOTORS else np.array([MOTORS.index(a) for a in actuators])
        )
        """Which of the joints of `MOTORS` it has, in the order of the model's actuators."""
        self._qadr = np.array([j.qposadr[0] for j in joint])
        self._vadr = np.array([j.dofadr[0] for j in joint])
        self._fastest = self.robot.speed_limit[self._has]
        self._strongest = self.robot.torque_limit[self._has]
        self._base = self.model.body("base_link").id
        self._wheel_geoms = np.array([self.model.geom(f"{leg}_wheel").id for leg in LEGS])
        self._contacts = ContactReader(self.model, self.data, self._base)
        # Views into MuJoCo's own memory: fetching them through the bindings costs more than using them.
        self._qpos, self._qvel = self.data.qpos, self.data.qvel
        self._ctrl = self.data.ctrl
        bias = self.model.actuator_biasprm
        self._stiffness, self._damping = bias[:, 1], bias[:, 2]
        self._force = self.data.actuator_force
        self._range = self.model.actuator_forcerange
        self._accel = self.data.sensordata[:3]
        self._warned = self.data.warning.number
        self._limited = False
        self._push_until = -1
        mujoco.mj_forward(self.model, self.data)

    # --- state -----------------------------------------------------------------------------------------------------
    @property
    def time(self) -> float:
        """[s] since the last reset."""
        return float(self.data.time)

    @property
    def position(self) -> Array:
        """(3,) base_link in the world [m]; a copy."""
        return np.array(self._qpos[:3])

    @property
    def quaternion(self) -> Array:
        """(4,) w, x, y, z, world <- base_link; a copy."""
        return np.array(self._qpos[3:7])

    @property
    def rotation(self) -> Array:
        """(3, 3) world <- base_link."""
        out = np.empty(9)
        mujoco.mju_quat2Mat(out, self._qpos[3:7])
        return out.reshape(3, 3)

    @property
    def linear_velocity(self) -> Array:
        """(3,) of base_link, expressed in base_link [m/s]."""
        return self.rotation.T @ self._qvel[:3]

    @property
    def angular_velocity(self) -> Array:
        """(3,) expressed in base_link [rad/s]."""
        return np.array(self._qvel[3:6])

    @property
    def yaw(self) -> float:
        """[rad]."""
        w, x, y, z = self._qpos[3:7]
        return float(np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)))

    def low_state(self) -> LowState:
        """Exact state; `accel` and `tau` are those of the last physics step."""
        return LowState(
            time=float(self.data.time),
            q=self._all(self._qpos.take(self._qadr)),
            dq=self._all(self._qvel.take(self._vadr)),
            tau=self._all(self._force.copy()),
            quaternion=self._qpos[3:7].copy(),
            gyro=self._qvel[3:6].copy(),
            accel=self._accel.copy(),
        )

    def _all(self, values: Array) -> Array:
        """(16,) with those (n,) of the joints that the robot has; the others are zero."""
        if len(values) == len(MOTORS):
            return values
        out = np.zeros(len(MOTORS))
        out[self._has] = values
        return out

    def contacts(self) -> Contacts:
        """Everything that touches the robot."""
        return self._contacts.all()

    def part_forces(self) -> Array:
        """(4,) sum of the normal forces [N] on each of `hal.mujoco.contacts.PARTS`."""
        return self._contacts.part_forces()

    def ground(self, x: float, y: float) -> float:
        """Terrain height [m] at x, y [m], bilinear; the edge value outside."""
        rows, cols = self.height.shape
        c = min(max((x - self.origin[0]) / self.resolution, 0.0), cols - 1.001)
        r = min(max((y - self.origin[1]) / self.resolution, 0.0), rows - 1.001)
        i, j = int(r), int(c)
        v, u = r - i, c - j
        h = self.height[i : i + 2, j : j + 2]
        return float((1 - v) * ((1 - u) * h[0, 0] + u * h[0, 1]) + v * ((1 - u) * h[1, 0] + u * h[1, 1]))

    @property
    def diverged(self) -> bool:
        """MuJoCo met NaN or huge values since the last reset and has put the robot back to the origin."""
        warned = self._warned.tolist()
        return any(warned[k] > 0 for k in _BAD)

    # --- doing -----------------------------------------------------------------------------------------------------
    def reset(
        self, x: float = 0.0, y: float = 0.0, yaw: float = 0.0, q: Array | None = None, settle: float = 0.6
    ) -> None:
        """Put the robot on its wheels at x, y [m], yaw [rad].

        Default pose: level trunk, each leg as long as the ground below it asks. With `q` (16,) [rad] those angles, the
        trunk parallel to the ground. Then `settle` [s] of joint hold let the contacts come to rest; the clock starts at
        zero afterwards.
        """
        mujoco.mj_resetData(self.model, self.data)
        self._pending.clear()
        self._steps = 0
        self._push_until = -1
        legs = self.robot.legs
        feet = wheel_centres(self._limbs, self.robot.stand if q is None else np.asarray(q, np.float64))
        c, s = np.cos(yaw), np.sin(yaw)
        turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        # Height of each tread centre when its wheel just touches the ground below.
        spots = feet @ turn.T + np.array([x, y, 0.0])
        axle = np.array([self._touching(px, py, c, s) for px, py, _ in spots])
        quat = np.array([np.cos(yaw / 2), 0.0, 0.0, np.sin(yaw / 2)])
        if q is None and legs is not None:
            # The mean leg stays as long as in the default stand, unless one would have to be longer than it can.
            trunk = min(axle.mean() - feet[:, 2].mean(), axle.min() + LONGEST_LEG)
            pose = legs.angles(np.column_stack([feet[:, :2], np.minimum(axle - trunk, -SHORTEST_LEG)]))
        else:
            pose = np.array(self.robot.stand if q is None else q, np.float64)
            slope = np.linalg.lstsq(np.column_stack([feet[:, :2], np.ones(4)]), axle, rcond=None)[0]
            tilt = np.array([yaw, -np.arctan(slope[0]), np.arctan(slope[1] / np.hypot(1.0, slope[0]))])
            mujoco.mju_euler2Quat(quat, tilt, "zyx")
            trunk = 0.0
        self._qpos[:3] = x, y, trunk
        self._qpos[3:7] = quat
        self._qpos[self._qadr] = pose[self._has]
        centres = wheel_centres(self._limbs, pose) @ self.rotation.T + np.array([x, y, trunk])
        self._qpos[2] += max(self._touching(px, py, c, s) - pz for px, py, pz in centres) + 0.003
        self._set_now(stand_command(pose, kp=SETTLE_KP))
        mujoco.mj_forward(self.model, self.data)
        self.step(round(settle / self.timestep))
        self.data.time = 0.0
        self._steps = 0

    def lift_clear(self, step: float = 0.01, most: float = 0.8) -> float:
        """Raise the robot in steps [m] until nothing but wheels touches, at most by `most`; returns how far it was
        raised [m]."""
        z = float(self._qpos[2])
        for k in range(round(most / step) + 1):
            self._qpos[2] = z + k * step
            mujoco.mj_forward(self.model, self.data)
            if self._contacts.only_wheels():
                break
        return float(self._qpos[2]) - z

    def set_friction(self, friction: float) -> None:
        """Sliding friction of the wheels from now on."""
        self.model.geom_friction[self._wheel_geoms, 0] = friction

    def _touching(self, x: float, y: float, c: float, s: float) -> float:
        """Height [m] of the centre of a wheel at x, y with heading (c, s) that rests on the ground."""
        radius = self._limbs.radius
        along = np.linspace(-radius, radius, 9)
        arc = np.sqrt(radius**2 - along**2)
        return max(
            self.ground(x + c * d, y + s * d) + r for d, r in zip(along.tolist(), arc.tolist(), strict=True)
        )

    def apply(self, command: LowCommand) -> None:
        """Take effect `command_delay` after this call and hold until the next command takes effect."""
        if self._delay == 0:
            self._set_now(command)
        else:
            copy = LowCommand(*(np.array(getattr(command, name)) for name in ("q", "dq", "tau", "kp", "kd")))
            self._pending.append((self._steps + self._delay, copy))

    def push(self, force: tuple[float, float, float], duration: float) -> None:
        """Push the trunk with `force` [N], world axes, for `duration` [s] from now."""
        self.data.xfrc_applied[self._base, :3] = force
        self._push_until = self._steps + round(duration / self.timestep)

    def place_box(self, index: int, centre: tuple[float, float, float] | None, yaw: float = 0.0) -> None:
        """Put box `index` there [m], world; None takes it away."""
        self.data.mocap_pos[index] = HIDDEN_PLACE if centre is None else centre
        self.data.mocap_quat[index] = np.cos(yaw / 2), 0.0, 0.0, np.sin(yaw / 2)

    def step(self, steps: int = 1) -> None:
        """Advance `steps` physics steps."""
        for _ in range(steps):
            if self._pending and self._pending[0][0] <= self._steps:
                self._set_now(self._pending.popleft()[1])
            self._cut_at_speed_limit()
            if self._push_until >= 0 and self._steps >= self._push_until:
                self.data.xfrc_applied[self._base, :3] = 0.0
                self._push_until = -1
            mujoco.mj_step(self.model, self.data)
            self._steps += 1

    def _set_now(self, command: LowCommand) -> None:
        has = self._has
        np.add((command.tau + command.kp * command.q)[has], (command.kd * command.dq)[has], out=self._ctrl)
        np.negative(command.kp[has], out=self._stiffness)
        np.negative(command.kd[has], out=self._damping)

    def _cut_at_speed_limit(self) -> None:
        """A motor at its top speed can still brake, but not push further."""
        dq = self._qvel.take(self._vadr)
        fast = np.abs(dq) >= self._fastest
        limit = self._strongest
        if np.count_nonzero(fast):
            self._range[:, 0] = np.where(fast & (dq < 0), 0.0, -limit)
            self._range[:, 1] = np.where(fast & (dq > 0), 0.0, limit)
            self._limited = True
        elif self._limited:
            self._range[:, 0] = -limit
            self._range[:, 1] = limit
            self._limited = False
