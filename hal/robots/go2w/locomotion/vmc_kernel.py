"""One control tick of the virtual model controller, compiled. Frame H and leg order as in
`hal.robots.go2w.locomotion.geometry`."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from hal.robots.go2w.facts import (
    BASE_LINK,
    HIP_LINK,
    HIP_X,
    HIP_Y,
    JOINT_DAMPING,
    JOINT_FRICTION,
    ROBOT_MASS,
    SIGN_X,
    SIGN_Y,
    THIGH_LINK,
    THIGH_Y,
    TREAD_Y,
    WHEEL_RADIUS,
    wheel_centres,
    wheel_jacobians,
)
from hal.robots.go2w.locomotion.cliff import TUCK_LENGTH, TUCK_RATE, feel_edges
from hal.robots.go2w.locomotion.climb import DRIVE, SHIFT, back_off, climb_tick
from hal.robots.go2w.locomotion.contact import clip, estimate_contacts, turn_share
from hal.robots.go2w.locomotion.geometry import (
    contact_geometry,
    distribute,
    fit_plane,
    leg_weight,
    level_frame,
    rotate,
)
from hal.robots.go2w.locomotion.traction import FRICTION_MAX, learn_friction, limit_traction
from hal.types import GRAVITY, Array
from hal.wheel_force import inverse3

SPRUNG_MASS = BASE_LINK.mass + 4.0 * (HIP_LINK.mass + THIGH_LINK.mass)
"""What the legs carry and push [kg]; shank and wheel follow the ground."""

OUT_Q, OUT_DQ, OUT_TAU, OUT_KP, OUT_KD = range(5)
"""Rows of the (5, 16) command."""


@njit(cache=True)
def slew(x: float, target: float, step: float) -> float:
    """`x` moved towards `target` by at most `step`."""
    return x + min(max(target - x, -step), step)


@njit(cache=True)
def vmc_tick(
    q: Array,
    dq: Array,
    tau: Array,
    quaternion: Array,
    gyro: Array,
    command: Array,
    dt: float,
    params,
    memory,
    out: Array,
) -> None:
    """Compute one command.

    `q`, `dq`, `tau`: (16,) measured; `command`: (5,) vx, wz, height, roll, pitch; `params`: (1,) of `RECORD`;
    `memory`: (1,) of `MEMORY`; `out`: (5, 16)."""
    m, p = memory[0], params[0]
    rot = level_frame(quaternion)
    omega = rotate(rot, gyro.reshape(1, 3))[0]
    roll = math.atan2(rot[2, 1], rot[2, 2]) + p.lookahead * omega[0]
    pitch = -math.asin(clip(rot[2, 0], -1.0, 1.0)) + p.lookahead * omega[1]

    centres = rotate(rot, wheel_centres(q))
    jac_base = wheel_jacobians(q)
    jac = np.empty((4, 3, 3))
    for leg in range(4):
        turned = rotate(rot, jac_base[leg].T)
        for k in range(3):
            for joint in range(3):
                jac[leg, k, joint] = turned[joint, k]
    points, jac_c, forward, axles = contact_geometry(q, rot, centres, jac, m.slope_x, m.slope_y)
    weight_torque, com = leg_weight(q, rot)
    if m.ticks == 0:
        for leg in range(4):
            m.contact[leg] = 1
            m.load[leg] = 0.25 * ROBOT_MASS * GRAVITY
            m.load_cap[leg] = p.force_max
            m.friction[leg] = FRICTION_MAX
            m.force[leg, 2] = m.load[leg]
            m.place[leg, 0] = centres[leg, 0] - HIP_X * SIGN_X[leg]
            m.place[leg, 1] = centres[leg, 1] - (HIP_Y + THIGH_Y + TREAD_Y) * SIGN_Y[leg]
        m.queued = -1
    m.ticks += 1
    estimate_contacts(m, tau, weight_torque, jac, dt, p)
    wanted = command[0]
    if m.mode == DRIVE:
        wanted = back_off(m, feel_edges(m, tau, dq, centres, rot, wanted, dt, p), dt)
    climb_tick(m, centres, com, rot, command[0], omega, dt, p)
    lifted = m.leg if m.mode > SHIFT else -1

    # --- ground plane and height
    weight = np.empty(4)
    for leg in range(4):
        weight[leg] = 1.0 if m.contact[leg] == 1 else 0.05
        if leg == lifted:
            weight[leg] = 1e-3
    ground, slope_x, slope_y = fit_plane(points, weight)
    alpha = 1.0 if m.ticks == 1 else dt / (dt + p.slope_filter)
    m.slope_x += alpha * (clip(slope_x, -1.0, 1.0) - m.slope_x)
    m.slope_y += alpha * (clip(slope_y, -1.0, 1.0) - m.slope_y)
    m.grade[0] += dt / 1.0 * (m.slope_x - m.grade[0])
    m.grade[1] += dt / 1.0 * (m.slope_y - m.grade[1])
    m.height = -ground

    # --- wheel centres relative to base_link, velocity in H; ground speed from rolling
    velocity = np.empty((4, 3))
    spin = np.empty(4)
    rolled = np.empty(4)
    rise = 0.0
    sway = 0.0
    total = 0.0
    for leg in range(4):
        for axis in range(3):
            v = 0.0
            for joint in range(3):
                v += jac[leg, axis, joint] * dq[3 * leg + joint]
            velocity[leg, axis] = v
        velocity[leg, 0] += omega[1] * centres[leg, 2] - omega[2] * centres[leg, 1]
        velocity[leg, 1] += omega[2] * centres[leg, 0] - omega[0] * centres[leg, 2]
        velocity[leg, 2] += omega[0] * centres[leg, 1] - omega[1] * centres[leg, 0]
        pitch_rate = axles[leg, 0] * omega[0] + axles[leg, 1] * omega[1] + axles[leg, 2] * omega[2]
        spin[leg] = dq[3 * leg + 1] + dq[3 * leg + 2] + pitch_rate
        total += weight[leg]
        rise -= weight[leg] * velocity[leg, 2]
        sway -= weight[leg] * velocity[leg, 1]
        rolled[leg] = WHEEL_RADIUS * (dq[12 + leg] + spin[leg]) * forward[leg, 0] - velocity[leg, 0]
    rise /= total
    sway /= total
    speed = learn_friction(m, tau, axles, rolled, weight, dt)
    m.speed += dt / (dt + 0.03) * (speed - m.speed)

    # --- commands
    climbing = m.mode != DRIVE
    spot = clip((0.2 - abs(command[0])) / 0.1, 0.0, 1.0)
    share = 1.0 - spot * (1.0 - turn_share(m, dt, p))
    push = np.zeros(2)  # wanted horizontal acceleration of the trunk
    w = p.shift_bandwidth if climbing else p.shift_back
    for axis in range(2):
        a = w * w * (m.shift_goal[axis] - m.shift[axis]) - 2.0 * w * m.shift_rate[axis]
        a = clip(a, -p.shift_accel, p.shift_accel)
        m.shift_rate[axis] += a * dt
        m.shift[axis] += m.shift_rate[axis] * dt
        push[axis] -= a
    before_vx = m.vx
    halt = abs(wanted) < 1e-3 and abs(command[1]) < 1e-3
    if climbing:
        m.vx = slew(m.vx, 0.0, p.brake * dt)
        m.wz = slew(m.wz, 0.0, 2.0 * p.alpha * dt)
    else:
        # Braking may be harder than driving off: nobody waits for a start.
        slower = abs(wanted) < abs(m.vx) or wanted * m.vx < 0.0
        m.vx = slew(m.vx, wanted, (p.decel if slower else p.accel) * dt)
        m.wz = slew(m.wz, share * command[1], (1.5 if halt else 1.0) * p.alpha * dt)
        push[0] += (m.vx - before_vx) / dt
    if halt:
        push[1] -= p.halt_sway * sway
    height = command[2]
    ground_pitch = -math.atan(m.slope_x)
    ground_roll = math.atan(m.slope_y)
    pitch_wanted = command[4] + ground_pitch - clip(ground_pitch, -p.level_pitch, p.level_pitch)
    roll_wanted = command[3] + ground_roll - clip(ground_roll, -p.level_roll, p.level_roll)

    m.tilt[0] = roll - roll_wanted
    m.tilt[1] = pitch - pitch_wanted

    # --- trunk wrench and its distribution on the wheels
    error = clip(height - m.height, -0.08, 0.08)
    m.lift_i = clip(m.lift_i + p.trim * p.heave_k * error * dt, -60.0, 60.0)
    wrench = np.empty(3)
    wrench[0] = ROBOT_MASS * GRAVITY + m.lift_i + p.heave_k * error - p.heave_d * rise
    wrench[1] = p.roll_k * clip(roll_wanted - roll, -0.25, 0.25) - p.roll_d * omega[0]
    wrench[2] = p.pitch_k * clip(pitch_wanted - pitch, -0.25, 0.25) - p.pitch_d * omega[1]
    # The ground pushes the trunk sideways far below its centre of mass; the vertical forces must undo that moment.
    arm = com[2] + m.height
    wrench[1] -= arm * SPRUNG_MASS * push[1]
    wrench[2] += arm * SPRUNG_MASS * push[0]
    lower = np.zeros(4)
    upper = np.full(4, p.force_max)
    for leg in range(4):
        # The soft stops of the leg bound its force: a stretched leg cannot push, a folded one must.
        hip_z = rot[2, 0] * HIP_X * SIGN_X[leg] + rot[2, 1] * HIP_Y * SIGN_Y[leg]
        stroke = hip_z - centres[leg, 2]
        upper[leg] = clip(p.force_max * (p.stroke_max - stroke) / 0.02, 3.0, p.force_max)
        lower[leg] = clip(80.0 * (p.stroke_min - stroke) / 0.02, 0.0, 120.0)
        m.load_cap[leg] = min(m.load_cap[leg] + p.load_rate * dt, p.force_max)
        if leg == lifted:
            upper[leg] = 0.0
        upper[leg] = min(upper[leg], m.load_cap[leg])
        lower[leg] = min(lower[leg] + 3.0, upper[leg])
    distribute(points, com, wrench, lower, upper, m.load, 20)

    # --- drive
    yaw_error = m.wz - omega[2]
    stopped = (climbing and m.vx == 0.0) or (halt and m.vx == 0.0 and m.wz == 0.0)
    if stopped:
        m.yaw_i = 0.0
    else:
        # A held robot does not turn: the integral must not take the drive from the wheels of one side meanwhile.
        held = m.slips[0] + m.slips[1] + m.slips[2] + m.slips[3] > 0 and abs(m.speed) < 0.5 * abs(m.vx)
        if not held or yaw_error * m.yaw_i < 0.0:
            m.yaw_i += p.yaw_ki * yaw_error * dt
        m.yaw_i = clip(m.yaw_i, -3.0 * share, 3.0 * share)
    turn = m.wz + (0.0 if stopped else p.yaw_kp * yaw_error + m.yaw_i)
    m.skid = turn - omega[2]
    limit = p.wheel_torque
    nose_up = pitch_wanted - pitch if m.vx >= 0.0 else pitch - pitch_wanted
    if nose_up > 0.5 * p.nose_up:
        limit *= clip(2.0 - 2.0 * nose_up / p.nose_up, 0.0, 1.0)
    # Sliding back down a hill: wheels that grip again must not throw the trunk round.
    slides = m.speed * m.vx < -0.05 * abs(m.vx)
    if stopped or slides:
        m.speed_i *= 1.0 - dt / (0.5 if stopped else 0.1)
    elif abs(m.vx - m.speed) < 0.3:
        m.speed_i = clip(m.speed_i + p.speed_ki * (m.vx - m.speed) * dt, -2.5, 2.5)
    still = (abs(omega[2]) < 0.05 and abs(m.speed) < 0.03) or (climbing and abs(m.speed) < 0.25)
    if stopped and m.hold == 0 and still:
        m.hold = 1
        for leg in range(4):
            m.latch[leg] = q[12 + leg] + q[3 * leg + 1] + q[3 * leg + 2] + pitch
    elif not stopped:
        m.hold = 0

    # --- wheel placement under the trunk
    grade = math.sqrt(m.grade[0] * m.grade[0] + m.grade[1] * m.grade[1])
    hill = clip((grade - 0.11) / 0.06, 0.0, 1.0)
    pull = p.turn_pull + (p.hill_pull - p.turn_pull) * hill
    pull *= clip((abs(m.wz) - 0.03) / p.turn_full, 0.0, 1.0)
    step = p.place_rate * dt
    # A wheel that was put down far out comes back under the trunk as the trunk drives on, not by rolling off again.
    rolling = max(clip(abs(m.speed) / 0.3, 0.1, 1.0), clip(abs(m.wz) / 0.1, 0.0, 1.0))
    if halt:
        rolling = 0.1  # axles that hurry back to their places would keep a stopping robot moving
    total_load = max(m.load[0] + m.load[1] + m.load[2] + m.load[3], 50.0)
    torque = np.empty(4)
    for leg in range(4):
        goal_x = -pull * SIGN_X[leg] + com[0]
        before = m.place[leg, 0]
        furthest = step * rolling
        if climbing:
            goal_x = before
        elif m.cliff * SIGN_X[leg] > 0.0 and m.back_off > 0.0:
            goal_x -= m.cliff * TUCK_LENGTH
            furthest = TUCK_RATE * dt
        m.place[leg, 0] = slew(before, goal_x, furthest)
        m.place[leg, 1] = slew(m.place[leg, 1], com[1], step)
        rate_x = (m.place[leg, 0] - before) / dt
        error_x = HIP_X * SIGN_X[leg] + m.place[leg, 0] + m.shift[0] - centres[leg, 0]
        error_y = (HIP_Y + THIGH_Y + TREAD_Y) * SIGN_Y[leg] + m.place[leg, 1] + m.shift[1] - centres[leg, 1]
        error_z = 0.0
        m.lag[leg, 0] = error_x
        m.lag[leg, 1] = error_y
        if leg == lifted:
            error_x = m.foot[0] - centres[leg, 0]
            error_z = m.foot[2] - centres[leg, 2]
        inv = inverse3(jac[leg])
        stands = jac[leg, 0, 1] < -0.1  # below its hip, not thrown about in a fall
        wheel = 12 + leg
        # The wheel's feed-forward holds the vertical load on the slope; its motor-side speed loop does the rest.
        hold_torque = WHEEL_RADIUS * forward[leg, 2] * m.load[leg]
        extra = clip(tau[wheel] - hold_torque, -p.wheel_torque, p.wheel_torque)
        for joint in range(3):
            i = 3 * leg + joint
            t = weight_torque[leg, joint] - jac_c[leg, 2, joint] * m.load[leg]
            t -= (
                (jac[leg, 0, joint] * push[0] + jac[leg, 1, joint] * push[1])
                * SPRUNG_MASS
                * m.load[leg]
                / total_load
            )
            if joint > 0:
                # The wheel motor's reaction turns the calf; carry it up to the trunk.
                t += extra
            out[OUT_TAU, i] = t
            if joint == 1 and leg != lifted and stands:
                # The calf has no spring: the thigh alone moves the wheel back, however straight the leg is.
                delta = clip(error_x / jac[leg, 0, 1], -0.3, 0.3)
            else:
                delta = clip(
                    inv[joint, 0] * error_x + inv[joint, 1] * error_y + inv[joint, 2] * error_z, -0.3, 0.3
                )
            out[OUT_Q, i] = q[i] + delta
            out[OUT_DQ, i] = inv[joint, 0] * (m.shift_rate[0] + rate_x) + inv[joint, 1] * m.shift_rate[1]
            out[OUT_KP, i] = p.swing_kp if leg == lifted else (0.0 if joint == 2 else p.leg_kp)
            out[OUT_KD, i] = p.calf_kd if joint == 2 else (p.leg_kd if joint == 1 else p.hip_kd)
        if leg != lifted:
            # The thigh's spring alone would push along the calf, mostly upwards; the calf's share makes its force
            # horizontal.
            thigh = 3 * leg + 1
            ratio = clip(jac[leg, 0, 2] / min(jac[leg, 0, 1], -0.1), -1.0, 1.0)
            out[OUT_TAU, thigh + 1] += (
                p.calf_share * clip(p.leg_kp * (out[OUT_Q, thigh] - q[thigh]), -20.0, 20.0) * ratio
            )
        # A wheel far from its place rolls back to it: a held wheel must not let the others drive on under the trunk.
        astray = error_x - clip(error_x, -p.astray, p.astray) if stands else 0.0
        ground_speed = m.vx - turn * points[leg, 1] + rate_x + p.astray_rate * astray
        want = ground_speed / WHEEL_RADIUS - spin[leg]
        band = limit / p.wheel_kd
        want = clip(want, dq[wheel] - band, dq[wheel] + band)
        friction = JOINT_FRICTION * clip(want / 0.5, -1.0, 1.0) + JOINT_DAMPING * want
        out[OUT_DQ, wheel] = want
        out[OUT_KD, wheel] = p.wheel_kd
        if m.hold == 1:
            rolled = q[3 * leg + 1] + q[3 * leg + 2] + pitch
            # A wheel that changes its place under the trunk rolls there.
            m.latch[leg] += rate_x / WHEEL_RADIUS * dt
            out[OUT_Q, wheel] = m.latch[leg] - rolled
            out[OUT_KP, wheel] = p.wheel_kp
            out[OUT_TAU, wheel] = hold_torque
        else:
            out[OUT_Q, wheel] = q[wheel]
            out[OUT_KP, wheel] = 0.0
            drive_torque = m.speed_i * clip(limit / p.wheel_torque, 0.0, 1.0)
            if not climbing:
                # For the sprung mass alone: shanks, wheels and rotors follow the speed loop. With them a stop
                # overshoots.
                drive_torque += WHEEL_RADIUS * SPRUNG_MASS * push[0] * m.load[leg] / total_load
            out[OUT_TAU, wheel] = hold_torque + friction + drive_torque
        torque[leg] = out[OUT_TAU, wheel] - friction
    if m.hold == 0:
        limited = torque.copy()
        limit_traction(limited, m.grip)
        for leg in range(4):
            out[OUT_TAU, 12 + leg] += limited[leg] - torque[leg]
