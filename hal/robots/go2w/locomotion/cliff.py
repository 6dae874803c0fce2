"""Stopping at an edge, felt by the wheels while the robot creeps.

A wheel that rolls over an edge stands on it with its flank: the ground pushes it forward as well as up. The lean of
that force tells how far the wheel is over the edge, long before it hangs. Once it hangs, on an edge met head-on,
nothing holds the robot any more. So the leading wheels are drawn back under the trunk at once, which the legs do much
faster than the robot brakes, and the robot backs off.

An edge of 2 cm and one of 2 m feel the same until then. So this happens only while the commanded speed is no more
than `creep`. Driving away or a faster command ends it; with the latter the robot drives down blind."""

from __future__ import annotations

import math

from numba import njit

from hal.robots.go2w.facts import HIP_X, HIP_Y, JOINT_DAMPING, JOINT_FRICTION, SIGN_X, SIGN_Y, WHEEL_RADIUS
from hal.robots.go2w.locomotion.contact import clip
from hal.robots.go2w.locomotion.params import VmcParams
from hal.types import Array

CREEP_TIME = 0.4
"""The command must have been slow for this long [s]: starting to drive and coming to rest is not creeping."""
LEAVE_TIME = 1.0
"""Longer by this [s] after driving away: that way it came, and its wheels are still in motion."""
LEAN_TIME = 0.015
"""Time constant of the lean [s]."""
STRETCHED_LEG = 0.38
"""Axle below hip [m] from which a leg without load hangs..."""
HANG_TIME = 0.03
"""... when it lasts this long [s]."""
BACK_OFF = 0.12
"""How far it drives back from the edge [m], as long as it is commanded towards it..."""
BACK_SPEED = 0.15
"""... at this speed [m/s]."""
TUCK_LENGTH = 0.09
"""How far the leading wheels are drawn back under the trunk [m], until it has backed off..."""
TUCK_RATE = 2.0
"""... at this speed [m/s]."""


@njit(cache=True)
def feel_edges(
    m, tau: Array, dq: Array, centres: Array, rot: Array, command_vx: float, dt: float, p: VmcParams
) -> float:
    """Watch for edges; returns the speed [m/s] to drive at instead of `command_vx`. Call it while no wheel is being
    lifted.

    `tau`, `dq` (16,) measured; `centres` (4, 3) wheel centres, H; `rot` (3, 3) H <- base_link. Sets `cliff`, +1 or -1.
    """
    stretched = False
    worst = 0.0
    creeping = 0.0 < abs(command_vx) <= p.creep and command_vx * m.vx >= 0.0
    m.creep = m.creep + dt if creeping else 0.0
    way = m.cliff if m.cliff != 0.0 else (1.0 if command_vx > 0.0 else -1.0)
    for leg in range(4):
        # Angle of the contact force in the rolling plane, less the share that the motor's torque makes along the tread.
        f = m.force[leg]
        size = math.sqrt(f[0] * f[0] + f[2] * f[2])
        rate = dq[12 + leg]
        torque = tau[12 + leg] - JOINT_FRICTION * clip(rate / 0.5, -1.0, 1.0) - JOINT_DAMPING * rate
        lean = 0.0
        if size > p.contact_on:
            lean = math.atan2(f[0], f[2]) - math.asin(clip(torque / (WHEEL_RADIUS * size), -0.6, 0.6))
        m.lean[leg] += dt / (dt + LEAN_TIME) * (clip(lean, -1.6, 1.6) - m.lean[leg])
        length = rot[2, 0] * HIP_X * SIGN_X[leg] + rot[2, 1] * HIP_Y * SIGN_Y[leg] - centres[leg, 2]
        hanging = m.contact[leg] == 0 and length > STRETCHED_LEG
        m.hang[leg] = m.hang[leg] + dt if hanging else 0.0
        if way * SIGN_X[leg] > 0.0:
            worst = max(worst, way * (m.lean[leg] + math.atan(m.grade[0])))
            stretched = stretched or m.hang[leg] > HANG_TIME
    if m.cliff == 0.0:
        if m.creep > CREEP_TIME and (worst > p.edge_lean or stretched):
            m.cliff = way
            m.back_off = BACK_OFF
    elif command_vx * way < 0.0 or abs(command_vx) > p.creep:
        m.cliff = 0.0
        m.creep = -LEAVE_TIME
    if m.cliff == 0.0:
        return command_vx
    if command_vx == 0.0 or m.back_off <= 0.0:
        return 0.0
    m.back_off -= max(-way * m.speed, 0.0) * dt
    return -way * BACK_SPEED
