"""Length of the shortest path of a car that drives forward and backward (Reeds and Shepp 1990, formulas 8.1 to
8.11)."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

HALF_PI = 0.5 * math.pi


@njit(cache=True)
def reeds_shepp(x, y, phi):
    """Length in turning radii from the origin, heading 0, to x, y (in radii), heading `phi` [rad]."""
    best = np.inf
    for flip in (1.0, -1.0):
        for mirror in (1.0, -1.0):
            px, py, ph = flip * x, mirror * y, flip * mirror * phi
            best = min(best, _words(px, py, ph))
            # The same words driven from the goal to the start.
            c, s = math.cos(ph), math.sin(ph)
            best = min(best, _words(px * c + py * s, px * s - py * c, ph))
    return best


@njit(cache=True)
def _words(x, y, phi):
    """Shortest of the base words, all of which begin with a forward left turn."""
    best = np.inf
    s, c = math.sin(phi), math.cos(phi)
    # Towards circles on the same side, and on opposite sides.
    ax, ay = x - s, y - 1.0 + c
    bx, by = x + s, y - 1.0 - c
    ra, ta = math.hypot(ax, ay), math.atan2(ay, ax)
    rb, tb = math.hypot(bx, by), math.atan2(by, bx)
    # 8.1: left, straight, left
    v = _wrap(phi - ta)
    if ta >= 0.0 and v >= 0.0:
        best = min(best, ta + ra + v)
    # 8.2: left, straight, right
    if rb >= 2.0:
        u = math.sqrt(rb * rb - 4.0)
        t = _wrap(tb + math.atan2(2.0, u))
        v = _wrap(t - phi)
        if t >= 0.0 and v >= 0.0:
            best = min(best, t + u + v)
    # 8.3, 8.4: left, right backward, left
    if ra <= 4.0:
        u = -2.0 * math.asin(0.25 * ra)
        t = _wrap(ta + 0.5 * u + math.pi)
        v = _wrap(phi - t + u)
        if t >= 0.0 and u <= 0.0:
            best = min(best, t - u + abs(v))
    # 8.7, 8.8: four arcs
    rho = 0.25 * (2.0 + rb)
    if rho <= 1.0:
        u = math.acos(rho)
        t, v = _outer(u, -u, bx, by, phi)
        if t >= 0.0 and v <= 0.0:
            best = min(best, t + 2.0 * u - v)
    rho = (20.0 - rb * rb) / 16.0
    if 0.0 <= rho <= 1.0:
        u = -math.acos(rho)
        if u >= -HALF_PI:
            t, v = _outer(u, u, bx, by, phi)
            if t >= 0.0 and v >= 0.0:
                best = min(best, t - 2.0 * u + v)
    # 8.9: left, right backward by a quarter, straight, left
    if ra >= 2.0:
        r = math.sqrt(ra * ra - 4.0)
        u = 2.0 - r
        t = _wrap(ta + math.atan2(r, -2.0))
        v = _wrap(phi - HALF_PI - t)
        if t >= 0.0 and u <= 0.0 and v <= 0.0:
            best = min(best, t + HALF_PI - u - v)
    # 8.10: left, right backward by a quarter, straight, right
    if rb >= 2.0:
        t = math.atan2(bx, -by)
        u = 2.0 - rb
        v = _wrap(t + HALF_PI - phi)
        if t >= 0.0 and u <= 0.0 and v <= 0.0:
            best = min(best, t + HALF_PI - u - v)
        # 8.11: five pieces
        u = 4.0 - math.sqrt(rb * rb - 4.0)
        if u <= 0.0:
            t = _wrap(math.atan2((4.0 - u) * bx - 2.0 * by, -2.0 * bx + (u - 4.0) * by))
            v = _wrap(t - phi)
            if t >= 0.0 and v >= 0.0:
                best = min(best, t + math.pi - u + v)
    return best


@njit(cache=True)
def _outer(u, v, xi, eta, phi):
    """First and last arc of the four-arc words."""
    delta = _wrap(u - v)
    a = math.sin(u) - math.sin(delta)
    b = math.cos(u) - math.cos(delta) - 1.0
    t1 = math.atan2(eta * a - xi * b, xi * a + eta * b)
    t2 = 2.0 * (math.cos(delta) - math.cos(v) - math.cos(u)) + 3.0
    tau = _wrap(t1 + math.pi) if t2 < 0.0 else _wrap(t1)
    return tau, _wrap(tau - u + v - phi)


@njit(cache=True)
def _wrap(angle):
    """In (-pi, pi]."""
    return math.pi - (math.pi - angle) % (2.0 * math.pi)
