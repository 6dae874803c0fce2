"""Distance of the robot per metre of wheel: tyres slip a few percent under load, and the scans tell how many.

Slip beyond that, on an edge or on loose ground, comes and goes. While it lasts the wheels count less."""

from __future__ import annotations

COMPARED_WAY = 0.3
"""Wheel distance [m] over which one comparison is made."""
SLIP_SIGMA = 0.05
"""Standard deviation of the ratio over one comparison: slip comes and goes."""
RANDOM_WALK = 0.003
"""Its random walk per comparison."""
SCALE_LIMITS = (0.80, 1.15)
SLIP_SMOOTHING = 0.4
"""Share of the newest scan in `slip`: a scan is off by millimetres, which is a lot over 0.1 s."""
SLIP_FACTOR = 3.0
"""Slip goes on from sample to sample: it counts this much more than noise that averages out."""


class WheelScale:
    """Scalar Kalman filter on the ratio of driven to rolled distance. Only scans that constrain the forward direction
    count."""

    def __init__(self) -> None:
        self.value = 1.0
        self._variance = 0.03**2
        self._slip = self._doubt = 0.0
        self._rolled = 0.0
        self._driven = 0.0

    @property
    def noise(self) -> float:
        """Standard deviation of the forward velocity by what the wheels slip just now [m/s]."""
        return SLIP_FACTOR * max(abs(self._slip) - self._doubt, 0.0)

    def learn(self, rolled: float, driven: float, seconds: float, sigma: float) -> None:
        """Add the distances [m] of one scan interval along the body's x axis: by the wheels (unscaled), and by the
        scans with their standard deviation `sigma` [m]. What `sigma` explains is no slip."""
        self._slip += SLIP_SMOOTHING * ((driven - self.value * rolled) / seconds - self._slip)
        self._doubt = 2.0 * SLIP_SMOOTHING * sigma / seconds
        self._rolled += rolled
        self._driven += driven
        if abs(self._rolled) < COMPARED_WAY:
            return
        ratio = self._driven / self._rolled
        self.forget()
        if not SCALE_LIMITS[0] - 0.2 < ratio < SCALE_LIMITS[1] + 0.2:
            return  # spinning or blocked wheels, not a scale
        self._variance += RANDOM_WALK * RANDOM_WALK
        gain = self._variance / (self._variance + SLIP_SIGMA * SLIP_SIGMA)
        self.value = min(max(self.value + gain * (ratio - self.value), SCALE_LIMITS[0]), SCALE_LIMITS[1])
        self._variance *= 1.0 - gain

    def forget(self) -> None:
        """Break the comparison: something in it cannot be trusted."""
        self._rolled = self._driven = 0.0
