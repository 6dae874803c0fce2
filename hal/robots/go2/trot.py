"""A trot (`hal.lowlevel.Locomotion`): diagonal pairs of feet stand and swing in turn.

Feet that stand push: their forces give the trunk the height, attitude and velocity that are wanted (virtual model
control). Feet that swing follow a path to where the trunk can be caught (Raibert: half of the way of a stance at the
velocity that is, and further out by what is too much of it). Velocity comes from the feet that stand and the IMU's
specific force, attitude from the IMU's filter. It knows no terrain.

Frame H: base_link turned so that z is up, x as far ahead as the trunk points.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from hal.limbs import MOTORS, SIGN_X, SIGN_Y, Limbs, wheel_centres, wheel_jacobians
from hal.lowlevel import LowCommand, LowState
from hal.rotation import up_of
from hal.types import GRAVITY, Array, PostureCommand, VelocityCommand

STRIDE_TIME = 0.40
"""[s] of one cycle: each pair stands for half of it."""
LIFT_HEIGHT = 0.07
"""[m] by which a foot swings above the ground."""
DROP_DEPTH = 0.01
"""[m] below the ground to which a foot reaches that lands."""
SPEED_SLEW, BRAKE_SLEW, TURN_SLEW = 1.0, 2.0, 2.5
"""Of the commanded speed when it rises and falls [m/s^2], and of the yaw rate [rad/s^2]."""
HEAVE_GAINS = 1200.0, 120.0
"""[N/m], [N s/m]"""
HEAVE_I, LIFT_MOST = 400.0, (-15.0, 50.0)
"""[N/m/s] by which the weight of a payload is learnt, and its limits [N]."""
TILT_GAINS = np.array([250.0, 300.0]), np.array([12.0, 16.0])
"""Roll and pitch: [Nm/rad], [Nm s/rad]."""
PUSH_GAIN = 5.0
"""[1/s] at which the velocity along the ground is corrected while it stands on a foot..."""
HOLD_GAINS = 40.0, 10.0
"""... and [1/s^2], [1/s] of a trunk over four feet."""
TURN_GAIN = 12.0
"""[Nm s/rad]"""
TURN_I = 20.0
"""[Nm/rad] of the yaw that is missing."""
GRIP_SHARE = 0.5
"""Share of its load that a foot may push along the ground."""
CATCH_TIME = 0.14
"""[s] A velocity of 1 m/s too much puts the feet so many metres further out."""
FOOT_REACH = 0.14
"""[m] Furthest from its default place that a foot lands."""
LEG_TIME = 0.04
"""[s] in which the velocity by the feet corrects that of the IMU."""
SWING_KP, SWING_KD, STANCE_KD = 80.0, 2.0, 1.0
"""[Nm/rad], [Nm s/rad]"""
PLANE_TIME = 0.15
"""[s] of the ground's plane under the feet."""
STEEPEST_PLANE = 0.5
"""Rise of a plane that is believed [m/m]."""
FASTEST_JOINT = 15.0
"""[rad/s] of a joint's wanted speed."""
REST_SPEED = 0.08
"""Speed [m/s] from which a robot that is told to stand may put down all feet."""
STOP_SPEED = 0.02
"""[m/s], [rad/s] below which it stands on all four."""
TRIM_GAIN, TRIM_MOST = 0.8, 0.25
"""[1/s] by which the wanted velocity is raised as long as it is missed, and at most [m/s]."""


def leg_angles(limbs: Limbs, centres: Array) -> Array:
    """Inverse of `wheel_centres`: joint angles that put the centres there, knees backward.

    `centres`: (4, 3) [m] in base_link. Returns (16,) [rad], wheels 0. Out of reach: the nearest angles.
    """
    out = np.zeros(len(MOTORS))
    side = limbs.thigh_y + limbs.tread_y
    for leg in range(4):
        x = centres[leg, 0] - limbs.hip_x * SIGN_X[leg]
        y = centres[leg, 1] - limbs.hip_y * SIGN_Y[leg]
        z = centres[leg, 2] - limbs.hip_z
        down = math.sqrt(max(y * y + z * z - side * side, 1e-6))
        hip = math.atan2(z, y) - math.atan2(-down, side * SIGN_Y[leg])
        hip = math.remainder(hip, 2.0 * math.pi)
        cosine = (x * x + down * down - limbs.thigh**2 - limbs.calf**2) / (2.0 * limbs.thigh * limbs.calf)
        calf = -math.acos(min(max(cosine, -1.0), 1.0))
        thigh = math.atan2(-x, down) - math.atan2(
            limbs.calf * math.sin(calf), limbs.thigh + limbs.calf * math.cos(calf)
        )
        out[3 * leg : 3 * leg + 3] = hip, thigh, calf
    return out


class Trot:
    """Velocity and yaw rate in, joint commands out. Posture and `climb` are not followed."""

    def __init__(self, limbs: Limbs, stand: Array, mass: float, period: float = 0.005) -> None:
        """`stand`: (16,) [rad]; `mass`: whole robot [kg]; `period`: control period [s]."""
        self.period = period
        self._limbs, self._mass = limbs, mass
        self._feet = wheel_centres(limbs, stand)
        self._out = LowCommand(*(np.zeros(len(MOTORS)) for _ in range(5)))
        self.reset()

    def reset(self) -> None:
        """Forget all state."""
        self._phase = 0.0
        self._walks = False
        self._calm = 0
        """Strides since it was told to stand and did."""
        self._last = np.zeros(16)
        self._wanted = np.zeros(3)
        self._velocity = np.zeros(3)
        """Of base_link [m/s], H."""
        self._yaw_miss = 0.0
        self._lift_i = 0.0
        self._trim = np.zeros(2)
        self._from = self._feet.copy()
        """Where each foot lifted off, H."""
        self._spots = self._feet.copy()
        """Where each foot touches the ground, or did, H."""
        self._slope = np.zeros(2)
        """Rise of the ground ahead and to the left [m/m], H."""
        self._stood = np.ones(4, bool)

    def warning(self) -> str:
        """It does what it is told."""
        return ""

    def step(self, state: LowState, velocity: VelocityCommand, posture: PostureCommand) -> LowCommand:
        """One control tick."""
        del posture
        dt = self.period
        target = np.array([velocity.vx, velocity.vy, velocity.wz])
        slew = np.where(np.abs(target) < np.abs(self._wanted), BRAKE_SLEW, SPEED_SLEW) * dt
        slew[2] = TURN_SLEW * dt
        self._wanted += np.clip(target - self._wanted, -slew, slew)
        up = np.array(up_of(state.quaternion))
        ahead = np.array([1.0, 0.0, 0.0]) - up[0] * up
        ahead /= max(float(np.linalg.norm(ahead)), 1e-3)
        rot = np.array([ahead, np.cross(up, ahead), up])
        centres, jacobians = wheel_centres(self._limbs, state.q), wheel_jacobians(self._limbs, state.q)
        feet, omega = centres @ rot.T, rot @ state.gyro
        legs = state.dq[:12].reshape(4, 3)
        moving = (np.einsum("kij,kj->ki", jacobians, legs) + np.cross(state.gyro, centres)) @ rot.T
        swing = self._gait(dt)
        stands = swing <= 0.0
        self._velocity += dt * (rot @ state.accel - np.array([0.0, 0.0, GRAVITY]))
        self._velocity -= dt / LEG_TIME * (moving[stands].mean(axis=0) + self._velocity)
        height = self._ground(feet, stands, omega)
        hips = (self._feet * (1.0, 1.0, 0.0)) @ rot.T
        force, moment = self._wrench(rot, (feet - hips)[:, :2].mean(axis=0), height, omega)
        forces = self._distribute(feet, stands, force, moment)
        lifted = self._stood & ~stands
        self._from[lifted] = feet[lifted]
        self._stood = stands
        s = swing[:, None]
        smooth = s * s * (3.0 - 2.0 * s)
        path = (1.0 - smooth) * self._from + smooth * self._landing(hips, height)
        path[:, 2] += LIFT_HEIGHT * np.sin(math.pi * swing) - DROP_DEPTH * swing**4
        q = leg_angles(self._limbs, np.where(stands[:, None], feet, path) @ rot)
        out = self._out
        for leg in range(4):
            part = slice(3 * leg, 3 * leg + 3)
            if stands[leg]:
                out.q[part], out.dq[part] = state.q[part], 0.0
                out.kp[part], out.kd[part] = 0.0, STANCE_KD
                out.tau[part] = -jacobians[leg].T @ (rot.T @ forces[leg])
            else:
                speed = (q[part] - self._last[part]) / dt if not lifted[leg] else np.zeros(3)
                out.q[part], out.dq[part] = q[part], np.clip(speed, -FASTEST_JOINT, FASTEST_JOINT)
                out.kp[part], out.kd[part], out.tau[part] = SWING_KP, SWING_KD, 0.0
        self._last = q
        return out

    def _ground(self, feet: Array, stands: NDArray[np.bool_], omega: Array) -> float:
        """Height [m] of base_link above the plane on which the feet stand or stood last; sets its slope."""
        dt = self.period
        self._spots -= dt * (self._velocity + np.cross([0.0, 0.0, omega[2]], self._spots))
        self._spots[stands] = feet[stands]
        flat = np.column_stack([np.ones(4), self._spots[:, :2]])
        level, *rise = np.linalg.lstsq(flat, self._spots[:, 2])[0]
        self._slope += dt / PLANE_TIME * (np.clip(rise, -STEEPEST_PLANE, STEEPEST_PLANE) - self._slope)
        return -float(level)

    def _wrench(self, rot: Array, offset: Array, height: float, omega: Array) -> tuple[Array, Array]:
        """Force [N] and moment [Nm] on the trunk, H. `offset` (2,): from below the hips to the feet [m]."""
        dt, v = self.period, self._velocity
        error = float(np.clip(-self._feet[:, 2].mean() - height, -0.05, 0.05))
        self._lift_i = float(np.clip(self._lift_i + HEAVE_I * error * dt, *LIFT_MOST))
        force, moment = np.zeros(3), np.zeros(3)
        force[2] = self._mass * GRAVITY + self._lift_i + HEAVE_GAINS[0] * error - HEAVE_GAINS[1] * v[2]
        if self._walks:
            force[:2] = self._mass * PUSH_GAIN * (self._wanted[:2] + self._trim - v[:2])
            self._trim += TRIM_GAIN * dt * (self._wanted[:2] - v[:2])
            self._trim = np.clip(self._trim, -TRIM_MOST, TRIM_MOST)
        else:
            force[:2] = self._mass * (HOLD_GAINS[0] * offset - HOLD_GAINS[1] * v[:2])
            self._trim[:] = 0.0
        roll, pitch = math.atan2(rot[2, 1], rot[2, 2]), -math.asin(float(np.clip(rot[2, 0], -1.0, 1.0)))
        lean = np.arctan([self._slope[1], -self._slope[0]]) - (roll, pitch)
        moment[:2] = TILT_GAINS[0] * np.clip(lean, -0.3, 0.3) - TILT_GAINS[1] * omega[:2]
        miss = float(self._wanted[2] - omega[2])
        self._yaw_miss = float(np.clip(self._yaw_miss + miss * dt, -0.3, 0.3)) if self._walks else 0.0
        moment[2] = TURN_GAIN * miss + TURN_I * self._yaw_miss
        return force, moment

    def _gait(self, dt: float) -> Array:
        """(4,) how far each foot is in its swing, 0 to 1; zero and less where it stands."""
        moves = float(np.abs(self._wanted).max()) > STOP_SPEED
        far = float(np.abs(self._velocity[:2]).max()) > REST_SPEED
        if self._walks or moves:
            before, self._phase = self._phase % 1.0, self._phase + dt / STRIDE_TIME
            if not self._walks:
                self._phase, before = 0.0, 0.0
            self._calm = 0 if moves or far else self._calm + (self._phase % 1.0 < before)
            self._walks = moves or far or self._calm < 1
        if not self._walks:
            return np.zeros(4)
        share = (self._phase + np.where(SIGN_X * SIGN_Y > 0.0, 0.0, 0.5)) % 1.0
        return np.asarray(2.0 * share - 1.0)

    def _landing(self, hips: Array, height: float) -> Array:
        """(4, 3) where the feet are to land, H, by the capture point."""
        v, stance = self._velocity, 0.5 * STRIDE_TIME
        place = hips.copy()
        turn = 0.5 * stance * self._wanted[2]
        step = 0.5 * stance * v[:2] + CATCH_TIME * (v[:2] - self._wanted[:2] - self._trim)
        for leg in range(4):
            x, y = hips[leg, :2]
            place[leg, 0] += float(np.clip(step[0] - turn * y, -FOOT_REACH, FOOT_REACH))
            place[leg, 1] += float(np.clip(step[1] + turn * x, -0.7 * FOOT_REACH, 0.7 * FOOT_REACH))
        place[:, 2] = place[:, :2] @ self._slope - height
        return place

    def _distribute(self, feet: Array, stands: NDArray[np.bool_], force: Array, moment: Array) -> Array:
        """(4, 3) forces [N] of the ground on the feet, H: least squares of the wrench, inside friction."""
        which = np.flatnonzero(stands)
        n = len(which)
        out = np.zeros((4, 3))
        if n == 0:
            return out
        a = np.zeros((6, 3 * n))
        for k, leg in enumerate(which):
            x, y, z = feet[leg]
            z -= self._limbs.radius
            a[:3, 3 * k : 3 * k + 3] = np.eye(3)
            a[3:, 3 * k : 3 * k + 3] = [[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]
        weight = np.array([1.0, 1.0, 3.0, 20.0, 20.0, 5.0])
        wrench = np.concatenate([force, moment])
        aw = a * weight[:, None]
        f = np.linalg.solve(aw.T @ aw + 1e-2 * np.eye(3 * n), aw.T @ (weight * wrench)).reshape(n, 3)
        f[:, 2] = np.clip(f[:, 2], 5.0, 2.5 * self._mass * GRAVITY / n)
        most = GRIP_SHARE * f[:, 2]
        along = np.linalg.norm(f[:, :2], axis=1)
        f[:, :2] *= np.minimum(1.0, most / np.maximum(along, 1e-6))[:, None]
        out[which] = f
        return out
