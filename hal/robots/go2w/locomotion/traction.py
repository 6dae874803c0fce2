"""Friction limits: how much each wheel may push along the ground, and which wheel takes over the rest.

The vertical distribution decides the load of every wheel. Here the feed-forward torques of the wheels (hill,
acceleration, speed integral) are held inside the friction cone of the load that each wheel feels. The speed loop in
the motors stays free. What one wheel gives up goes to the other wheel of its side, which keeps the turning moment.
The friction of every wheel is learnt from its slip: a wheel that runs ahead of the others uses all the friction there
is."""

from __future__ import annotations

import math

from numba import njit

from hal.robots.go2w.facts import HIP_Y, THIGH_Y, TREAD_Y, WHEEL_RADIUS
from hal.robots.go2w.locomotion.contact import clip
from hal.types import Array

FRICTION_MAX = 1.0
"""Friction of a wheel that has not slipped lately: the best there is."""
FRICTION_MIN = 0.1
LEARN_TIME = 0.05
"""Time constant [s] at which friction is learnt while a wheel slips..."""
FORGET_RATE = 1.0
"""... and the rate [1/s] at which it is trusted again afterwards."""
SLIP_SPEED = 0.05
"""A wheel slips when it runs ahead of the slowest one by this [m/s]..."""
SLIP_SHARE = 0.2
"""... and this share of the speed."""
SKID_RATIO = 3.0
"""Most of the yaw rate's own size that the yaw loop adds to it."""
HALF_TRACK = HIP_Y + THIGH_Y + TREAD_Y


@njit(cache=True)
def learn_friction(m, tau: Array, axles: Array, rolled: Array, weight: Array, dt: float) -> float:
    """Set `slips`, `friction` and `grip`, (4,) each; returns the speed of the trunk [m/s] by the wheels that do not
    slip.

    `tau` (16,) measured; `axles` (4, 3), H; `rolled` (4,): speed of the trunk [m/s] if that wheel alone were right;
    `weight` (4,): its share in the mean. The slowest wheel in the direction of the drive is taken for one that does
    not slip."""
    way = 1.0 if tau[12] + tau[13] + tau[14] + tau[15] >= 0.0 else -1.0
    slowest = 1e9
    for leg in range(4):
        if m.contact[leg] == 1:
            slowest = min(slowest, way * rolled[leg])
    # To turn, the wheels of one side are meant to run ahead; how far is up to the yaw loop, but only while a turn is
    # asked for.
    margin = SLIP_SPEED + SLIP_SHARE * abs(m.vx) + HALF_TRACK * min(abs(m.skid), SKID_RATIO * abs(m.wz))
    speed = 0.0
    total = 0.0
    for leg in range(4):
        push = tau[12 + leg] / WHEEL_RADIUS
        f = m.force[leg]
        side = axles[leg, 0] * f[0] + axles[leg, 1] * f[1] + axles[leg, 2] * f[2]
        load = math.sqrt(max(f[0] * f[0] + f[1] * f[1] + f[2] * f[2] - side * side - push * push, 0.0))
        slips = m.contact[leg] == 1 and way * rolled[leg] - slowest > margin and way * push > 0.0
        m.slips[leg] = 1 if slips else 0
        if slips:
            used = clip(math.hypot(push, side) / max(load, 1.0), FRICTION_MIN, FRICTION_MAX)
            m.friction[leg] += dt / (dt + LEARN_TIME) * min(used - m.friction[leg], 0.0)
        else:
            m.friction[leg] = min(m.friction[leg] + FORGET_RATE * dt, FRICTION_MAX)
            speed += weight[leg] * rolled[leg]
            total += weight[leg]
        # What holds the robot sideways comes first; at least a third is left for driving.
        cone = m.friction[leg] * load
        m.grip[leg] = math.sqrt(max(cone * cone - side * side, 0.11 * cone * cone)) * WHEEL_RADIUS
    return speed / total


@njit(cache=True)
def limit_traction(torque: Array, grip: Array) -> None:
    """Limit wheel torques (4,) [Nm] to +-`grip` (4,), in place; the rest goes to the other wheel of the side as far
    as it has room.

    Legs in the order FR, FL, RR, RL."""
    for side in range(2):
        front = side
        rear = side + 2
        wanted = torque[front] + torque[rear]
        torque[front] = clip(torque[front], -grip[front], grip[front])
        torque[rear] = clip(torque[rear], -grip[rear], grip[rear])
        torque[front] = clip(torque[front] + wanted - torque[front] - torque[rear], -grip[front], grip[front])
        torque[rear] = clip(torque[rear] + wanted - torque[front] - torque[rear], -grip[rear], grip[rear])
