"""What the wheels feel: contact forces from leg torques, and whether an edge holds a wheel that a turn drags
sideways."""

from __future__ import annotations

import math

from numba import njit

from hal.robots.go2w.locomotion.params import VmcParams
from hal.types import Array
from hal.wheel_force import axle_force


@njit(cache=True)
def clip(x: float, low: float, high: float) -> float:
    """`x` inside [low, high]."""
    return min(max(x, low), high)


@njit(cache=True)
def estimate_contacts(m, tau: Array, weight_torque: Array, jac: Array, dt: float, p: VmcParams) -> None:
    """Contact forces from leg torques (quasi-static), low-passed, and contact flags with hysteresis.

    What a wheel takes from the ground goes through its axle, wherever it is touched: the leg carries it by the
    Jacobian of the wheel centre (`jac`, H), and the wheel motor's reaction by thigh and calf."""
    alpha = dt / (dt + p.force_filter)
    for leg in range(4):
        wheel = tau[12 + leg]
        force = axle_force(
            jac[leg],
            weight_torque[leg, 0] - tau[3 * leg],
            weight_torque[leg, 1] - tau[3 * leg + 1] + wheel,
            weight_torque[leg, 2] - tau[3 * leg + 2] + wheel,
        )
        for axis in range(3):
            m.force[leg, axis] += alpha * (clip(force[axis], -300.0, 300.0) - m.force[leg, axis])
        if m.contact[leg] == 1:
            if m.force[leg, 2] < p.contact_off:
                m.contact[leg] = 0
        elif m.force[leg, 2] > p.contact_on:
            m.contact[leg] = 1


@njit(cache=True)
def turn_share(m, dt: float, p: VmcParams) -> float:
    """Share of a turn on the spot that may go on, 0..1: turning against a wheel that an edge holds tips the robot.

    A sliding wheel is held by no more than its load times friction (1.0, the best there is). A larger force comes
    from an edge. A wheel dragged far from its place also leaves the trunk without support on its side, however weakly
    it is held. The mean lag of all wheels does not count: gravity on a slope drags them alike."""
    norm = 1.0 / math.sqrt(1.0 + m.slope_x * m.slope_x + m.slope_y * m.slope_y)
    mean_x = 0.25 * (m.lag[0, 0] + m.lag[1, 0] + m.lag[2, 0] + m.lag[3, 0])
    mean_y = 0.25 * (m.lag[0, 1] + m.lag[1, 1] + m.lag[2, 1] + m.lag[3, 1])
    jam = 0.0
    strain = 0.0
    for leg in range(4):
        f = m.force[leg]
        load = norm * (f[2] - m.slope_x * f[0] - m.slope_y * f[1])
        along = math.sqrt(max(f[0] * f[0] + f[1] * f[1] + f[2] * f[2] - load * load, 0.0))
        jam = max(jam, along - max(load, 0.0))
        strain = max(strain, math.hypot(m.lag[leg, 0] - mean_x, m.lag[leg, 1] - mean_y))
    alpha = dt / (dt + 0.05)
    m.jam += alpha * (jam - m.jam)
    m.strain += alpha * (strain - m.strain)
    held = max(m.jam / p.turn_jam, (m.strain / p.turn_strain - 0.6) / 0.4)
    return 1.0 - clip(held, 0.0, 1.0)
