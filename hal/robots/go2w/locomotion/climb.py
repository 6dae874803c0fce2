"""Lifting one blocked wheel onto what blocks it: detection and the sequence shift, lift, reach, lower.

A wheel counts as blocked when it has been pushed back, against the other three wheels, for long enough. Then the
robot stands still, moves its centre of mass over the other three wheels, lifts the wheel as far as the leg folds,
reaches forward and puts it down on whatever is there."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from hal.robots.go2w.facts import HIP_X, HIP_Y, SIGN_X, SIGN_Y, THIGH_Y, TREAD_Y
from hal.robots.go2w.locomotion.params import VmcParams
from hal.types import Array

DRIVE, SHIFT, LIFT, REACH, LOWER = range(5)
"""Values of the memory field `mode`."""
PACE_FILTER = 0.3
"""Time constant [s] of the speed that tells whether a robot is stuck: the wheels' own estimate chatters while an edge
holds them."""

BACK_TIME = 0.6
"""A climb that finds no footing drives back for this long [s], so that the wheels come under the trunk again..."""
BACK_SPEED = 0.15
"""... at this speed [m/s]."""
STRAIN_SHARE = 0.3
"""Share of a wheel's push that the wheel behind or before it feels as well when the robot turns."""
TIPPING_RATIO = 1.4
"""A trunk that tilts by so many times the tilt that forbids lifting tips: the lifted wheel is put down again."""


@njit(cache=True)
def back_off(m, wanted: float, dt: float) -> float:
    """Speed [m/s] to drive at instead of `wanted` after a climb without footing. Call it while no wheel is being
    lifted."""
    m.retreat = max(m.retreat - dt, 0.0) if wanted * m.way > 0.0 else 0.0
    return -m.way * BACK_SPEED if m.retreat > 0.0 else wanted


@njit(cache=True)
def detect_blocked(m, centres: Array, way: float, dt: float, p: VmcParams) -> int:
    """The leg that has been blocked long enough, or -1. `way`: +1 driving forward, -1 backward, 0 not driving.

    Blocked: the wheel is pushed back, much harder than the other three, or has fallen behind its place under the trunk.
    """
    found = -1
    worst = p.blocked_time
    flat = abs(m.grade[0]) < 0.08 and abs(m.grade[1]) < 0.08
    share = dt / (dt + PACE_FILTER)
    m.turned += share * (abs(m.wz) - m.turned)
    turning = max(abs(m.wz), m.turned)
    straight = turning < min(0.15, 0.2 * abs(m.vx))
    m.pace += share * (way * m.speed - m.pace)
    m.asked += share * (way * m.vx - m.asked)
    stuck = m.asked > 0.1 and m.pace < 0.4 * m.asked
    caution = 1.0
    if not stuck:
        # A turn pushes wheels back as well: the faster it turns, the more it takes.
        caution += 6.0 * max(0.0, turning - 0.1)
        # Braking downhill does so too, and lifting a wheel on a slope is delicate; what must be climbed lies level or
        # uphill.
        caution *= 1.0 + 12.0 * max(0.0, -way * m.grade[0] - 0.08) + 6.0 * max(0.0, abs(m.grade[1]) - 0.12)
    total = m.force[0, 0] + m.force[1, 0] + m.force[2, 0] + m.force[3, 0]
    weight = m.force[0, 2] + m.force[1, 2] + m.force[2, 2] + m.force[3, 2]
    for leg in range(4):
        back = -way * m.force[leg, 0]
        others = way * (total - m.force[leg, 0]) / 3.0
        behind = way * (HIP_X * SIGN_X[leg] + m.place[leg, 0] + m.shift[0] - centres[leg, 0])
        pushed = back > 0.4 * p.blocked_force * caution and back + others > p.blocked_force * caution
        lags = behind > p.blocked_lag * caution and back > 5.0 * caution
        # Wheels that turn the trunk strain against each other, also a while after: both of one side are pushed back.
        # No edge does that to a robot that drives on.
        strained = not stuck and -way * m.force[(leg + 2) % 4, 0] > STRAIN_SHARE * back > 0.0
        # The hill itself pushes every wheel back, and one that slips cannot resist: only what is left counts for the
        # slow signs.
        back -= way * m.grade[0] * m.force[leg, 2]
        others += way * m.grade[0] * (weight - m.force[leg, 2]) / 3.0
        if way != 0.0 and not strained and (pushed or lags):
            m.blocked[leg] += dt
        elif (
            ((flat and straight) or stuck)
            and way != 0.0
            and not strained
            and back > 5.0
            and back + others > 0.5 * p.blocked_force
        ):
            # Pushed back weakly but for long: on slippery ground the others cannot push harder.
            m.blocked[leg] += 0.15 * dt
        else:
            m.blocked[leg] = max(0.0, m.blocked[leg] - (0.15 if stuck else 2.0) * dt)
        if m.blocked[leg] > worst:
            worst = m.blocked[leg]
            found = leg
    return found


@njit(cache=True)
def begin(m, leg: int, way: float, centres: Array, com: Array, p: VmcParams) -> None:
    """Start the sequence for `leg`: the centre of mass moves over the triangle of the other three wheels.

    The goal lies at the share `triangle` of the way from the middle of the two neighbours, on whose line the triangle
    ends, to the third wheel."""
    if m.mode == DRIVE:
        # The legs that pushed are bent like springs: take them as they are, or they throw the trunk back.
        for i in range(4):
            m.place[i, 0] = centres[i, 0] - HIP_X * SIGN_X[i] - m.shift[0]
            m.place[i, 1] = centres[i, 1] - (HIP_Y + THIGH_Y + TREAD_Y) * SIGN_Y[i] - m.shift[1]
    m.mode = SHIFT
    m.leg = leg
    m.way = way
    m.timer = 0.0
    beside = leg + 1 if leg % 2 == 0 else leg - 1
    along = (leg + 2) % 4
    across = (beside + 2) % 4
    shifted = np.zeros(2)
    for i in range(4):
        shifted[0] += 0.25 * (centres[i, 0] - HIP_X * SIGN_X[i] - m.place[i, 0])
        shifted[1] += 0.25 * (centres[i, 1] - (HIP_Y + THIGH_Y + TREAD_Y) * SIGN_Y[i] - m.place[i, 1])
    for axis in range(2):
        middle = 0.5 * (centres[beside, axis] + centres[along, axis])
        goal = middle + p.triangle * (centres[across, axis] - middle)
        m.shift_goal[axis] = min(max(shifted[axis] + com[axis] - goal, -0.10), 0.10)


@njit(cache=True)
def triangle_margin(leg: int, centres: Array, com: Array) -> float:
    """How far [m] the centre of mass is inside the edge that the triangle of the other three wheels turns to `leg`."""
    beside = leg + 1 if leg % 2 == 0 else leg - 1
    along = (leg + 2) % 4
    ex = centres[along, 0] - centres[beside, 0]
    ey = centres[along, 1] - centres[beside, 1]
    length = math.sqrt(ex * ex + ey * ey)
    side = ex * (com[1] - centres[beside, 1]) - ey * (com[0] - centres[beside, 0])
    outside = ex * (centres[leg, 1] - centres[beside, 1]) - ey * (centres[leg, 0] - centres[beside, 0])
    return -side / length if outside > 0.0 else side / length


@njit(cache=True)
def finish(m) -> None:
    """Back to driving."""
    m.mode = DRIVE
    m.queued = -1
    m.timer = 0.0
    m.pace = m.asked = 0.0
    for axis in range(2):
        m.shift_goal[axis] = 0.0
    for i in range(4):
        m.blocked[i] = 0.0


@njit(cache=True)
def climb_tick(
    m, centres: Array, com: Array, rot: Array, command_vx: float, omega: Array, dt: float, p: VmcParams
) -> None:
    """Advance the sequence. Sets `foot`, the wanted wheel centre of the lifted leg, H.

    `centres` (4, 3): wheel centres, H; `omega` (3,): turning rate of the trunk, H [rad/s].
    """
    m.timer += dt
    way = 0.0
    if abs(m.vx) > 0.1 and abs(command_vx) > 0.1 and m.cliff == 0.0 and m.retreat == 0.0:
        way = 1.0 if m.vx > 0.0 else -1.0
    if m.mode == DRIVE:
        leg = detect_blocked(m, centres, way, dt, p)
        if leg >= 0 and p.climb > 0.0:
            partner = leg + 1 if leg % 2 == 0 else leg - 1
            pushed = -way * m.force[partner, 0] > 0.4 * p.blocked_force
            m.queued = partner if pushed else -1
            begin(m, leg, way, centres, com, p)
        return
    leg = m.leg
    hip_z = rot[2, 0] * HIP_X * SIGN_X[leg] + rot[2, 1] * HIP_Y * SIGN_Y[leg]
    if m.mode == SHIFT:
        miss = abs(m.shift[0] - m.shift_goal[0]) + abs(m.shift[1] - m.shift_goal[1])
        steady = abs(m.speed + m.shift_rate[0]) < p.still and abs(omega[2]) < 0.3
        # A trunk that tips or swings cannot be held on three wheels, let alone on two.
        for axis in range(2):
            steady = steady and abs(m.tilt[axis]) < p.lift_tilt and abs(omega[axis]) < p.lift_swing
        for other in range(4):
            steady = steady and (other == leg or m.contact[other] == 1)
        margin = triangle_margin(leg, centres, com)
        if miss < p.shift_miss and m.timer > p.shift_time and margin > p.shift_margin and steady:
            m.mode = LIFT
            m.timer = 0.0
            for axis in range(3):
                m.foot[axis] = centres[leg, axis]
            m.lift_x = centres[leg, 0]
        elif m.timer > 1.0:
            finish(m)
            m.retreat = BACK_TIME
    elif (m.mode == LIFT or m.mode == REACH) and max(
        abs(m.tilt[0]), abs(m.tilt[1])
    ) > TIPPING_RATIO * p.lift_tilt:
        # The wheel is needed on the ground.
        m.mode = LOWER
        m.timer = 0.0
        m.foot[0] = centres[leg, 0]
        m.foot[2] = centres[leg, 2]
    elif m.mode == LIFT:
        top = hip_z - p.stroke_lift
        m.foot[2] = min(m.foot[2] + p.lift_rate * dt, top)
        back = m.lift_x - m.way * p.retreat
        m.foot[0] += min(max(back - m.foot[0], -0.3 * dt), 0.3 * dt)
        if m.foot[2] >= top - 1e-6 and centres[leg, 2] > top - 0.03:
            m.mode = REACH
            m.timer = 0.0
        elif m.timer > 0.8:
            m.mode = LOWER
            m.timer = 0.0
    elif m.mode == REACH:
        goal = m.lift_x + m.way * p.reach
        limit = HIP_X * SIGN_X[leg] + m.way * p.reach_max
        goal = min(goal, limit) if m.way > 0.0 else max(goal, limit)
        m.foot[2] = hip_z - p.stroke_lift
        m.foot[0] += min(max(goal - m.foot[0], -p.reach_rate * dt), p.reach_rate * dt)
        arrived = abs(m.foot[0] - goal) < 1e-6 and abs(centres[leg, 0] - goal) < 0.03
        if arrived or m.timer > 0.6:
            m.mode = LOWER
            m.timer = 0.0
            m.foot[0] = centres[leg, 0]
    elif m.mode == LOWER:
        m.foot[2] = max(m.foot[2] - p.lower_rate * dt, hip_z - p.stroke_max)
        landed = centres[leg, 2] - m.foot[2] > 0.025 or m.force[leg, 2] > p.contact_on + 6.0
        if (landed and m.timer > 0.06) or m.timer > 1.0:
            m.place[leg, 0] = centres[leg, 0] - HIP_X * SIGN_X[leg] - m.shift[0]
            m.load_cap[leg] = 10.0
            m.load[leg] = 0.0
            m.blocked[leg] = 0.0
            if m.queued >= 0:
                begin(m, m.queued, m.way, centres, com, p)
                m.queued = -1
            else:
                finish(m)
