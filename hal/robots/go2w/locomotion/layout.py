"""`Description` as arrays: what a policy is shown, and what its outputs are turned into. The same for driving and for
training."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hal.limbs import MOTORS, WHEEL_JOINTS
from hal.robots.go2w.locomotion.description import Description
from hal.types import Array

BRAKE_DAMPING = 2.0
"""[Nms/rad] of wheels that a policy does not know."""


class Layout:
    """For one robot or for many: every array may have leading axes. Joint arrays of the robot are (..., 16) in the
    order of `hal.limbs.MOTORS`; those of the policy are (..., n), `n` = `size`, in its own."""

    def __init__(self, description: Description) -> None:
        joints = description.joints
        self.size = n = len(joints)
        self._of = np.array([MOTORS.index(name) for name in joints])
        """(n,) index into the robot's joints of each of the policy's."""
        wheel = np.array([name.endswith("_wheel") for name in joints])
        self._leg, self._wheel = np.flatnonzero(~wheel), np.flatnonzero(wheel)
        action, stand = description.action, np.where(wheel, 0.0, description.stand)
        self.scale = np.broadcast_to(np.asarray(action.scale, float), n).copy()
        self._offset = (
            stand if action.offset is None else np.broadcast_to(np.asarray(action.offset, float), n)
        )
        self.lower, self.upper = (
            np.broadcast_to(np.asarray(limit, np.float32), n).copy() for limit in action.clip
        )
        self._targets = (
            None
            if action.targets is None
            else tuple(np.broadcast_to(np.asarray(limit, float), n) for limit in action.targets)
        )
        self.default = np.zeros(len(MOTORS))
        self.default[self._of] = stand
        self.kp, self.kd = np.zeros(len(MOTORS)), np.full(len(MOTORS), BRAKE_DAMPING)
        self.kp[self._of], self.kd[self._of] = description.kp, description.kd
        self.kp[WHEEL_JOINTS] = 0.0
        self.frame_size = 0
        """Numbers of all terms of one age."""
        self.places = np.empty((0, 2))
        """(m, 2) whose heights the policy sees [m], in the heading frame."""
        self.unknown = 0.0
        """What they count as where they are not known: base_link above the ground [m]."""
        self._terms: list[tuple[str, slice, Array, float]] = []
        low, high = [], []
        for term in description.observation:
            size = description.size(term)
            part = slice(self.frame_size, self.frame_size + size)
            scale = np.broadcast_to(np.asarray(term.scale, float), size)
            clip = term.clip if term.clip is not None else (-np.inf, np.inf)
            ends = np.stack([np.broadcast_to(np.asarray(c, float), size) * scale for c in clip])
            low.append(ends.min(axis=0))
            high.append(ends.max(axis=0))
            if term.term == "heights":
                self.places, self.unknown = term.places(), term.unknown or 0.0
            self._terms.append((term.term, part, scale, term.offset))
            self.frame_size += size
        with np.errstate(invalid="ignore"):
            self._low, self._high = (np.concatenate(ends).astype(np.float32) for ends in (low, high))
        self._low[np.isnan(self._low)], self._high[np.isnan(self._high)] = -np.inf, np.inf
        self.seen = self._gather(description)
        """(k,) index of each number of the observation into frames of rising age (`oldest` + 1, frame_size),
        raveled."""
        self.oldest = max(max(description.ages(term)) for term in description.observation)

    def _gather(self, description: Description) -> NDArray[np.int64]:
        parts = [part for _, part, _, _ in self._terms]
        within = [np.arange(part.start, part.stop) for part in parts]
        if description.history.order == "frame":
            whole = np.concatenate(within)
            return np.concatenate([age * self.frame_size + whole for age in description.history.ages])
        return np.concatenate(
            [
                age * self.frame_size + index
                for term, index in zip(description.observation, within, strict=True)
                for age in description.ages(term)
            ]
        )

    def frame(
        self, gyro: Array, up: Array, command: Array, q: Array, dq: Array, action: NDArray[np.float32],
        out: NDArray[np.float32], above: Array | None = None,
    ) -> None:  # fmt: skip
        """Write `out` (..., frame_size).

        gyro (..., 3) [rad/s] and world z `up` (..., 3) in base_link; `command` (..., 3): vx, vy [m/s], wz [rad/s];
        q, dq (..., 16) [rad, rad/s]; `action` (..., n): the output of the step before; `above` (..., m):
        base_link above the ground at `places` [m], NaN where it is not known.
        """
        for name, part, scale, offset in self._terms:
            if name == "gyro":
                out[..., part] = gyro * scale
            elif name == "gravity":
                out[..., part] = -up * scale
            elif name == "command":
                out[..., part] = command * scale
            elif name == "angles":
                angles = (q - self.default)[..., self._of] * scale
                angles[..., self._wheel] = 0.0
                out[..., part] = angles
            elif name == "speeds":
                out[..., part] = dq[..., self._of] * scale
            elif name == "action":
                out[..., part] = action * scale.astype(np.float32)
            elif above is not None:
                out[..., part] = (np.where(np.isnan(above), self.unknown, above) - offset) * scale
        np.clip(out, self._low, self._high, out=out)

    def targets(self, action: NDArray[np.float32]) -> tuple[Array, Array]:
        """Joint angles [rad] and speeds [rad/s], both (..., 16), that the motors hold for a clipped output (..., n)."""
        target = action * self.scale + self._offset
        if self._targets is not None:
            target = np.clip(target, *self._targets)
        q, dq = np.zeros((*target.shape[:-1], len(MOTORS))), np.zeros((*target.shape[:-1], len(MOTORS)))
        q[..., self._of[self._leg]] = target[..., self._leg]
        dq[..., self._of[self._wheel]] = target[..., self._wheel]
        return q, dq
