"""A base that does less than it is told: a face holds it, or something beside it slows its turn."""

from __future__ import annotations

from planning.tracking.types import TrackerConfig

HELD_TIME = 0.5
"""A base that does not move for so long [s] although it is told to is held by a face; once it moves it is over it after
so long."""
MEAN_TIME = 0.3
"""[s] over which a speed is averaged: a base that climbs at a face rocks to and fro, and gets nowhere."""
TURN_PATIENCE = 2.0
"""A turn on the spot is judged after so long [s]."""
AGAINST_SPEED, AGAINST_TIME = 0.15, 0.3
"""A base that moves so fast [m/s] the other way than it is told to for so long [s] has lost its hold."""
REST_SPEED = 0.05
"""[m/s] at which it has found it again."""


class Stall:
    """Told at each step what the base was commanded and what it did; tells whether that is too little."""

    def __init__(self, params: TrackerConfig) -> None:
        self._params = params
        self._held = 0.0
        """How long the base was told to move and did not, less how long it has moved since [s]."""
        self._mean = 0.0
        """Of the speed over MEAN_TIME [m/s]."""
        self._against = 0.0
        self._lost = False
        self._began = (0, 0.0)
        """When a turn began [ns], and how far it was [rad]."""

    def held(self, v: float, commanded: float, dt: float) -> bool:
        """Whether a face holds the base, or held it just now; `v` as measured, `commanded` [m/s], `dt` [s] since the
        last step."""
        least = self._params.min_speed
        self._mean += (v - self._mean) * min(dt / MEAN_TIME, 1.0)
        if abs(commanded) < 0.9 * least:
            self._held = 0.0
        else:
            moves = self._mean * commanded > 0.5 * least * abs(commanded)
            self._held = max(0.0, min(self._held + (-dt if moves else dt), 2.0 * HELD_TIME))
        return self._held > HELD_TIME

    def against(self, v: float, commanded: float, dt: float) -> bool:
        """Whether the base moves the other way than it is told to, and has not come to rest since: one that climbed a
        hurdle reared, rolled back over the one behind it for a second, and fell. Arguments as of `held`."""
        if self._lost:
            self._lost = abs(v) > REST_SPEED
            self._against = 0.0
        else:
            other = commanded * v < 0.0 and abs(v) > AGAINST_SPEED
            self._against = self._against + dt if other else 0.0
            self._lost = self._against > AGAINST_TIME
        return self._lost

    def turn(self, now: int, left: float, *, aligning: bool) -> bool:
        """Whether the turn on the spot, `left` [rad] of which remain at `now` [ns], is slower than the drive turns by
        itself: the safety gate slows turns beside a wall. `aligning`: whether the base turns."""
        if not aligning:
            self._began = now, left
        since, begun = self._began
        waited = (now - since) * 1e-9
        return waited > TURN_PATIENCE and begun - left < 0.5 * self._params.min_yaw_rate * waited
