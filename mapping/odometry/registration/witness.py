"""KISS-ICP as its package runs it, beside the tracker: a wide search after gaps, and a second opinion on the way that
was made.

It has its own map, point to point correspondences and an adaptive threshold. Nothing of the tracker enters its poses.
Vizzo et al., "KISS-ICP", RA-L 2023."""

from __future__ import annotations

import math
from collections import deque

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from hal.rotation import rotation_rpy, rotation_vector
from hal.types import Array
from mapping.odometry.registration.voxels import voxel_down_sample

TRIED_HEADINGS = (0.0, 0.25, -0.25, 0.5, -0.5)
"""Headings tried in turn in a search [rad]: registration finds a heading up to 0.4 rad off, but a robot out of
contact turns further."""
OUTVOTED_RATIO = 0.5
"""KISS-ICP is not believed where the tracker ends this many times nearer to where wheels and gyro lead."""
LOOK_COUNT = 10
"""Looks over which a slow disagreement adds up."""


class KissConfig(BaseModel):
    """KISS-ICP; voxels and threshold are those of its package."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    every: int = Field(default=5, ge=1, description="scans from one look to the next")
    voxel_size: float = Field(default=1.0, gt=0.1, le=2.0, description="of its map [m]")
    initial_threshold: float = Field(
        default=2.0, gt=0, description="correspondence scale at the start and of a search [m]"
    )
    min_motion: float = Field(
        default=0.1, gt=0, description="deviations below this do not teach the threshold [m]"
    )
    max_iterations: int = Field(default=50, ge=1, description="least-squares steps per scan")
    convergence: float = Field(
        default=1e-3, gt=0, description="smallest step [m, rad] that is followed by another"
    )
    disagreement: float = Field(
        default=0.5,
        gt=0,
        description="between its way and the tracker's, in units of its threshold: one of them is wrong above",
    )
    disagreement_deg: float = Field(
        default=15.0, gt=0, description="the same for the attitude [deg per m of its threshold]"
    )


def _apart(before: Array, after: Array, reckoned: Array) -> float:
    """Distance [m] between the end of a way from `before` (4, 4) to `after` and that of dead reckoning, `reckoned`
    (4, 4); a radian counts as a metre."""
    off = np.linalg.inv(reckoned) @ np.linalg.inv(before) @ after
    return float(np.linalg.norm(off[:3, 3]) + np.linalg.norm(rotation_vector(off[:3, :3])))


class Witness:
    """KISS-ICP with a memory of where the tracker was at its looks."""

    def __init__(self, params: KissConfig, max_range: float) -> None:
        """`max_range` of the points [m]."""
        from kiss_icp.config import KISSConfig
        from kiss_icp.mapping import get_voxel_hash_map
        from kiss_icp.registration import get_registration
        from kiss_icp.threshold import get_threshold_estimator

        config = KISSConfig()
        config.data.max_range = max_range
        config.mapping.voxel_size = params.voxel_size
        config.adaptive_threshold.initial_threshold = params.initial_threshold
        config.adaptive_threshold.min_motion_th = params.min_motion
        config.registration.max_num_threads = 1  # process-wide: the first instance decides
        config.registration.max_num_iterations = params.max_iterations
        config.registration.convergence_criterion = params.convergence
        self.params = params
        self._map = get_voxel_hash_map(config)
        self._registration = get_registration(config)
        self._threshold = get_threshold_estimator(config)
        self._pose = np.eye(4)
        self._started = False
        self._motion = np.eye(4)
        """Dead reckoning since the last look: what the tracker corrected is not in it."""
        self._tracked = np.eye(4)
        """Where the tracker was at the last look."""
        self._offsets: deque[Array] = deque(maxlen=LOOK_COUNT)
        """(4, 4) frame of the tracker <- own frame, at the last looks."""

    def moved(self, before: Array, predicted: Array) -> None:
        """Dead reckoning led from `before` (4, 4) to `predicted`, frame of the tracker."""
        self._motion = self._motion @ np.linalg.inv(before) @ predicted

    def look(self, frame: Array, tracked: Array, sure: bool = True) -> str:
        """Register `frame` (n, 3) in base_link on its own and insert it into the own map. Returns in plain words what
        speaks against the tracker's pose `tracked` (4, 4); empty if both agree.

        If the tracker is not `sure` there is nothing to compare: in a scene that does not constrain it, point to
        point slides."""
        thin, source = self._thinned(frame)
        if not (self._started and sure):
            self._pose = np.linalg.inv(self._offsets[-1]) @ tracked if self._started else tracked
            self._map.update(thin, self._pose)
            self._started, self._motion = True, np.eye(4)
            self._restart(tracked)
            return ""
        reckoned = self._motion
        guess, sigma = self._pose @ self._motion, self._threshold.get_threshold()
        pose = self._align(source, guess, sigma)
        self._threshold.update_model_deviation(np.linalg.inv(guess) @ pose)
        self._map.update(thin, pose)
        outvoted = _apart(self._tracked, tracked, reckoned) < OUTVOTED_RATIO * _apart(
            self._pose, pose, reckoned
        )
        self._pose, self._motion, self._tracked = pose, np.eye(4), tracked
        off, turned = 0.0, 0.0
        for old in self._offsets:
            apart = np.linalg.inv(old @ pose) @ tracked
            off = max(off, float(np.linalg.norm(apart[:3, 3])))
            turned = max(turned, float(np.linalg.norm(rotation_vector(apart[:3, :3]))))
        turned = math.degrees(turned)
        self._offsets.append(tracked @ np.linalg.inv(pose))
        if off <= self.params.disagreement * sigma and turned <= self.params.disagreement_deg * sigma:
            return ""
        self._restart(tracked)
        if outvoted:  # people who walk past carry it along
            return ""
        return f"KISS-ICP disagrees with the tracker by {100 * off:.0f} cm and {turned:.0f} deg"

    def _restart(self, tracked: Array) -> None:
        """Compare from here on."""
        self._tracked = tracked
        self._offsets.clear()
        self._offsets.append(tracked @ np.linalg.inv(self._pose))

    def search(self, frame: Array, guess: Array, reach: float = 0.0, attempt: int = 0) -> Array:
        """Where `frame` (n, 3) fits within some metres of `guess`: (4, 4), both in the frame of the tracker.

        The heading may be `reach` [rad] off: each `attempt` begins with another one.
        """
        if not self._started:
            return guess
        offset = self._offsets[-1]
        headings = [h for h in TRIED_HEADINGS if abs(h) <= reach] or [0.0]
        turned = np.eye(4)
        turned[:3, :3] = rotation_rpy(0.0, 0.0, headings[attempt % len(headings)])
        _, source = self._thinned(frame)
        own = np.linalg.inv(offset) @ guess @ turned
        return offset @ self._align(source, own, self.params.initial_threshold)

    def found(self, pose: Array) -> None:
        """The tracker is at `pose` (4, 4) after a search: go on from there."""
        if self._started:
            self._pose, self._motion = np.linalg.inv(self._offsets[-1]) @ pose, np.eye(4)

    def _thinned(self, frame: Array) -> tuple[Array, Array]:
        thin = voxel_down_sample(frame, 0.5 * self.params.voxel_size)
        return thin, voxel_down_sample(thin, 1.5 * self.params.voxel_size)

    def _align(self, source: Array, guess: Array, sigma: float) -> Array:
        return self._registration.align_points_to_map(
            points=source,
            voxel_map=self._map,
            initial_guess=guess,
            max_correspondance_distance=3.0 * sigma,
            kernel=sigma,
        )
