"""Motion that nobody commanded: what odometry, wheels and gyro tell of a robot that should stand."""

from __future__ import annotations

import math
from collections import deque

from hal.safety.gate_types import GateConfig, GateInputs
from hal.safety.monitors import MOVES_UNTOLD
from hal.safety.slope import CREEP_SLOPE, CREEP_SPEED
from hal.types import NS

SAMPLE_PERIOD = NS // 50
"""[ns] between two samples."""
NOTHING = (math.nan,) * 3


class Untold:
    """Averages over `moving_stop`: sway is no motion.

    Wheels and odometry must agree, the slower counts: a wheel that spins or an odometry that drifts is no motion.
    Odometry alone counts from `CREEP_SPEED` on, as of a robot that slides; so does what leads down a slope. Where one
    of them is silent the other counts.
    """

    def __init__(self, params: GateConfig) -> None:
        self._params = params
        self._since: int | None = None
        self._heard: deque[tuple[float, ...]] = deque()
        """When [ns], vx, vy, wz by odometry, speed of the wheels, yaw rate of the gyro."""
        self.creeps = 0.0
        """[m/s] down a slope; 0 where it does not."""

    def forget(self) -> None:
        """Motion has its reason: a command, a posture, a reflex of the robot. The robot gets time to come to rest
        after it."""
        self._since, self.creeps = None, 0.0
        self._heard.clear()

    def judge(self, now: int, inputs: GateInputs) -> str:
        """What moves without a reason at `now` [ns], in words; empty where nothing does."""
        p = self._params
        if self._since is None or now < self._since:
            self.forget()
            self._since = now
        if (now - self._since) / NS < p.braking_time or (
            self._heard and now - self._heard[-1][0] < SAMPLE_PERIOD
        ):
            return ""
        self._heard.append((now, *(inputs.velocity or NOTHING), *(inputs.wheels or NOTHING[:2])))
        if now - self._heard[0][0] < p.moving_stop * NS:
            return ""
        means = [sum(column) / len(self._heard) for column in zip(*self._heard, strict=True)][1:]
        self._heard.popleft()
        return self._weigh(*means, lean=inputs.lean)

    def _weigh(
        self, vx: float, vy: float, wz: float, wheels: float, gyro: float, *, lean: tuple[float, float]
    ) -> str:
        """Means in m/s and rad/s, not a number where the witness is silent."""
        speeds = _known(math.hypot(vx, vy), abs(wheels))
        turns = _known(0.5 * abs(wz), 0.5 * abs(gyro))
        if not speeds or not turns:
            return ""
        uphill = vx * lean[0] + vy * lean[1] if math.isfinite(vx) else wheels * lean[0]
        downhill = math.hypot(*lean) > math.sin(CREEP_SLOPE) and uphill < 0.0
        speed, least = max(min(speeds), min(turns)), self._params.moving_speed
        self.creeps = speed if downhill and speed > least else 0.0
        if MOVES_UNTOLD.outside(speed, high=CREEP_SPEED if downhill else least):
            return MOVES_UNTOLD.tell(speed=f"{speed:.2f}")
        if MOVES_UNTOLD.outside(speeds[0], high=CREEP_SPEED):
            return MOVES_UNTOLD.tell(speed=f"{speeds[0]:.2f}")
        return ""


def _known(*values: float) -> list[float]:
    return [value for value in values if math.isfinite(value)]
