"""Judge of a registration: its covariance, and good | degraded | lost with a reason."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from hal.safety.monitors import MOVED_WHILE_STILL
from hal.types import NS, Array
from mapping.odometry.registration.engines import Match
from mapping.odometry.registration.observability import observed

INDEPENDENT_POINTS = 60
"""Points of a scan whose errors are independent."""
SCATTER_SHARE = 0.6
"""Share of the scatter of a scan about the map that does not average out. More serves sparse LiDARs whose wheels roll
cleanly (synthetic runs), less serves wheels that slip and bump (physics)."""
FITS_AGAIN = 0.1, 0.04
"""Share of points off the surfaces and RMS distance from them [m] of a scan that fits beyond doubt, at most,"""
USUAL_FACTOR = 2.0
"""and never more than this times what is usual,"""
USUAL_SPARE = 0.02, 0.01
"""plus this share of points off the surfaces [0..1] and this distance [m]: after level ground all other ground fits
worse."""
ON_PLANES = 0.25
"""Least share of its points in voxels that have a plane."""
VIEW_DROP = 0.25, 0.1
"""Loss of overlap and of points on surfaces [0..1] from one scan to the next that shows that the view is another."""
TURN_SLACK = 0.1
"""Turn [rad] that the gyro does not tell, beside its own uncertainty: a square room fits four times."""
SUSPECT_SHARE = 0.5
"""Share of what is strange that is suspect while wheels and gyro stand still."""
CARRIED_FOR = 5 * NS
"""How long a robot that was moved while it stood still counts as carried [ns]."""
USUAL_WEIGHT = 0.1
"""Weight of a scan in what is usual."""
CARRIED = "; if the robot was carried, bring it back or start the stack anew"


class Health(StrEnum):
    """State of localisation. `lost` must stop motion; `degraded` warns: the pose holds, its margin is thin."""

    GOOD = "good"
    DEGRADED = "degraded"
    LOST = "lost"


class HealthConfig(BaseModel):
    """Limits of the verdict."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    min_on_planes: int = Field(
        default=30, ge=0, le=1000, description="points on known surfaces below which registration is not used"
    )
    min_points: int = Field(
        default=60, ge=10, le=1000, description="registered points below which a scan says nothing"
    )
    overlap_low: float = Field(
        default=0.5, ge=0.2, le=1.0, description="share of points in seen map: degraded below"
    )
    overlap_lost: float = Field(default=0.2, ge=0.05, le=0.9, description="registration is not used below")
    inliers_low: float = Field(
        default=0.8, ge=0.3, le=1.0, description="share of points on the map's surfaces: degraded below"
    )
    inliers_lost: float = Field(default=0.6, ge=0.3, le=1.0, description="registration is not used below")
    residual_high: float = Field(
        default=0.06, ge=0.01, le=0.2, description="RMS distance from the map's surfaces: degraded above [m]"
    )
    information_low: float = Field(
        default=0.02,
        ge=0.001,
        le=0.2,
        description="least share of surface facing any direction: degraded below",
    )
    disagreement: float = Field(
        default=6.0,
        ge=3.0,
        le=20.0,
        description="registration against prediction: degraded above [standard deviations]",
    )
    strange: float = Field(
        default=0.1,
        ge=0.02,
        le=0.5,
        description="a registration that disagrees and moves the prediction further is doubted [m]",
    )
    strange_deg: float = Field(default=3.0, ge=0.5, le=10.0, description="the same for the attitude [deg]")
    jump: float = Field(
        default=3.0,
        ge=0.5,
        le=5.0,
        description="registration is not used when it moves the prediction further [m]",
    )
    young: int = Field(
        default=10, ge=1, le=100, description="scans in the local map below which overlap says nothing"
    )
    gap_degraded: float = Field(
        default=0.25, ge=0.15, le=1.0, description="without a usable scan: degraded [s]"
    )
    gap_lost: float = Field(default=3.0, ge=0.5, le=5.0, description="without a usable scan: lost [s]")
    sigma_lost: float = Field(default=0.3, ge=0.05, le=1.0, description="position uncertainty: lost [m]")
    overlap_again: float = Field(
        default=0.6,
        ge=0.3,
        le=1.0,
        description="in doubt registration is not used below: somewhere else it fits half",
    )
    gap_again: float = Field(
        default=1.0, ge=0.3, le=3.0, description="a longer time without a usable scan is such a gap [s]"
    )
    recover: int = Field(
        default=3, ge=1, le=20, description="fitting scans in a row that end doubt and `lost`"
    )


@dataclass(frozen=True, slots=True)
class Verdict:
    """Verdict on one scan."""

    health: Health
    reason: str
    """Plain words; empty when good."""
    use: bool
    """The pose may correct the filter."""
    insert: bool
    """The scan may enter the local map: never in doubt, or one wrong fit would make the next ones fit."""
    covariance: Array
    """(6, 6) of the registered pose: position in `odom` [m], rotation about base_link in `odom` axes [rad]."""
    degenerate: Array
    """(3,) direction in `odom` in which the scene constrains least (unit)."""
    degeneracy: float
    """Share of the surface that faces this direction [0..1/3]; 0 means sliding freely."""
    strange: bool = False
    """Far from the prediction, more than its covariance allows."""
    held: bool = False
    """The robot stands: the pose corrects height and tilt alone."""


class HealthMonitor:
    """Remembers when scans last fitted."""

    def __init__(self, params: HealthConfig) -> None:
        self.params = params
        self.lost = False
        self._doubt = ""
        """Why the robot may be elsewhere."""
        self._tracked = False
        """Nothing but a second opinion speaks for that: scan after scan fitted."""
        self._last_fit = 0
        self._fits = 0
        self._against = 0
        """Scans in a row that say that a robot moved whose wheels and gyro stand still."""
        self._usual = np.array(FITS_AGAIN) / USUAL_FACTOR
        """Share of points off the surfaces and RMS distance [m] of scans that were mapped."""
        self._carried_until = 0
        """No scan is held against until then [ns]: the robot is carried, or its floor moves."""
        self._sigma_fit = 0.0
        """Position uncertainty when a scan last fitted [m]."""
        self._last = 0.0, 0.0
        """Overlap and share on surfaces of the last scan that was used."""

    def start(self, stamp: int, lost: bool = False) -> None:
        """Localisation begins at `stamp` [ns]; `lost`: in a map from before that scans have yet to fit."""
        self.lost, self._doubt, self._last_fit, self._fits = lost, "", stamp, 0
        self._tracked, self._sigma_fit = False, 0.0

    def doubt(self, reason: str, tracked: bool = False) -> None:
        """The robot may be elsewhere: scans must fit beyond doubt, `recover` of them in a row.

        `tracked`: a second opinion about a robot that was tracked until now. Its scans need not fit as well as is
        usual. In new terrain they may not have done so before either, and while they are refused the map does not
        learn what is new there."""
        self._tracked = tracked and not self.lost and (self._tracked or not self._doubt)
        self._doubt, self._fits = reason, 0

    def doubts(self, stamp: int) -> bool:
        """Whether a scan at `stamp` [ns] is searched for: lost, in doubt, or after a gap."""
        return self.lost or bool(self._doubt) or self.gap(stamp) > self.params.gap_again

    def gap(self, stamp: int) -> float:
        """Time without a usable scan [s]."""
        return max(stamp - self._last_fit, 0) * 1e-9

    def without_match(self, stamp: int, sigma: float, reason: str) -> tuple[Health, str]:
        """No registration at `stamp` [ns]; `sigma`: position uncertainty [m] of the dead reckoning."""
        gap = self.gap(stamp)
        sigma = math.sqrt(max(sigma**2 - self._sigma_fit**2, 0.0))  # on open ground it was large before
        if self.lost or gap > self.params.gap_lost or sigma > self.params.sigma_lost:
            return self.lose(stamp, reason)
        if gap > self.params.gap_degraded or reason:
            return Health.DEGRADED, f"{reason or 'no scan'}; dead reckoning for {gap:.1f} s"
        return Health.GOOD, ""

    def lose(self, stamp: int, reason: str) -> tuple[Health, str]:
        """From `stamp` [ns] on the pose is unknown, for this `reason`: scans must fit again, `recover` of them in a
        row."""
        self.lost, self._fits = True, 0
        return Health.LOST, f"{reason}; dead reckoning for {self.gap(stamp):.1f} s"

    def dropped(self, match: Match) -> bool:
        """The scan fits much worse than the one before: the robot sees something new, or is elsewhere."""
        return match.overlap < self._last[0] - VIEW_DROP[0] or match.inliers < self._last[1] - VIEW_DROP[1]

    def judge(
        self,
        stamp: int,
        match: Match,
        predicted: Array,
        prior: Array,
        scans: int,
        sigma: float,
        still: bool = False,
    ) -> Verdict:
        """Weigh a registration.

        `predicted`: (4, 4) pose before it; `prior`: (6, 6) covariance of that, axes as in `Verdict.covariance`;
        `scans`: number of scans in the local map; `sigma`: systematic error of a registered surface [m]; `still`:
        wheels and gyro say that the robot stands."""
        s = self.params
        covariance, direction, share = pose_covariance(match, sigma, prior)
        difference = np.concatenate(
            [match.pose[:3, 3] - predicted[:3, 3], _log(match.pose[:3, :3] @ predicted[:3, :3].T)]
        )
        # one scan may be off by what all its points share: that is no disagreement
        shared = sigma**2 / _variance(match, sigma)
        spread = shared * INDEPENDENT_POINTS * covariance + prior
        off = math.sqrt(float(difference @ np.linalg.solve(spread, difference)))
        moved = float(np.linalg.norm(difference[:3]))
        turned = math.degrees(float(np.linalg.norm(difference[3:])))
        bad, weak, again, strange, held, watched = "", "", False, False, False, False
        if match.points < s.min_points:
            bad = f"only {match.points} points in the scan"
        elif scans:
            young = scans < s.young
            few = match.on_planes < max(ON_PLANES * match.points, s.min_on_planes)
            again = self.doubts(stamp)
            strange = off > s.disagreement and (moved > s.strange or turned > s.strange_deg)
            watched = still and not again
            held = watched and stamp > self._carried_until
            suspect = off > s.disagreement and (
                moved > SUSPECT_SHARE * s.strange or turned > SUSPECT_SHARE * s.strange_deg
            )
            self._against = self._against + 1 if held and suspect else 0
            if held:
                strange = MOVED_WHILE_STILL.outside(self._against)
                held = not strange
                if strange:
                    self._carried_until = stamp + CARRIED_FOR
            if match.overlap < s.overlap_lost and not young:
                bad = f"scan overlaps the map by {match.overlap:.0%}"
            elif few and (match.overlap < s.overlap_low or match.on_planes < s.min_on_planes) and not young:
                bad = f"only {match.on_planes} points on known surfaces"
            elif match.inliers < s.inliers_lost and not young:
                bad = f"only {match.inliers:.0%} of the scan lies on the map's surfaces"
            elif moved > s.jump:
                bad = f"registration jumped by {moved:.2f} m"
            elif (again or strange) and turned > math.degrees(TURN_SLACK + 3.0 * _sigma(prior[3:, 3:])):
                bad = f"the scan fits where the gyro does not lead, {turned:.0f} deg off"
            elif (again or strange) and not self.fits_again(match, young, self._only_asked(stamp, strange)):
                bad = (
                    f"{match.overlap:.0%} of the scan overlaps the map, {match.inliers:.0%} of that lies "
                    "on its surfaces"
                )
            elif match.overlap < s.overlap_low and not young:
                weak = f"scan overlaps the map by {match.overlap:.0%}"
            elif match.inliers < s.inliers_low:
                weak = f"{match.inliers:.0%} of the scan lies on the map's surfaces"
            elif match.residual > s.residual_high:
                weak = f"scan is {1e3 * match.residual:.0f} mm off the map"
            elif share < s.information_low and not young:
                weak = "nothing constrains the direction ({:+.1f}, {:+.1f}, {:+.1f})".format(*direction)
            elif off > s.disagreement:
                weak = f"scan and dead reckoning disagree by {100 * moved:.0f} cm"
        if strange:
            words = MOVED_WHILE_STILL.tell(moved=moved, turned=turned)
            # In doubt it was found elsewhere: that is no motion.
            self.doubt(words if watched else "scan and dead reckoning disagree")
        elif again and not self._doubt:
            self.doubt("no scan fitted for a while")
        if bad:
            bad += CARRIED if again else ""
            health, reason = self.without_match(stamp, _sigma(prior), bad)
            return Verdict(health, reason, False, False, covariance, direction, share)
        self._last_fit, self._last = stamp, (match.overlap, match.inliers)
        self._sigma_fit = _sigma(prior)
        self._fits += 1
        if (self.lost or self._doubt) and self._fits < s.recover:
            health = Health.LOST if self.lost else Health.DEGRADED
            reason = "; ".join(filter(None, [self._doubt, "scans fit again, confirming"]))
            return Verdict(health, reason, True, False, covariance, direction, share, strange)
        self.lost, self._doubt, self._tracked = False, "", False
        if scans >= s.young and self.fits_again(match, False):
            self._usual += USUAL_WEIGHT * (np.array([1.0 - match.inliers, match.residual]) - self._usual)
        health = Health.DEGRADED if weak else Health.GOOD
        # What seems to move past a robot that stands must not become the map that shows it standing.
        mapped = not (held and self._against)
        return Verdict(health, weak, True, mapped, covariance, direction, share, strange, held)

    def _only_asked(self, stamp: int, strange: bool) -> bool:
        """Whether a second opinion is all that speaks against the tracker at `stamp` [ns]."""
        return self._tracked and not (self.lost or strange) and self.gap(stamp) <= self.params.gap_again

    def fits_again(self, match: Match, young: bool, tracked: bool = False) -> bool:
        """Whether a scan after a gap fits as well as those of a robot that knows where it is. Level ground fits
        everywhere: in a wrong place up to 0.9 of a scan overlaps and up to 0.93 of that lies on surfaces, 3 to 9 cm
        off them.

        `young`: the local map has few scans. On open ground the rings of one scan make hardly any plane; then overlap
        must do. `tracked`: there was no gap, see `doubt`; then the scan must fit as well as a `good` one."""
        if young and match.on_planes < self.params.min_on_planes:
            return match.overlap >= self.params.overlap_again
        off, residual = np.minimum(FITS_AGAIN, USUAL_FACTOR * self._usual + USUAL_SPARE)
        if tracked:
            off, residual = 1.0 - self.params.inliers_low, self.params.residual_high
        return (
            match.overlap >= self.params.overlap_again
            and (young or match.on_planes >= ON_PLANES * match.points)
            and 1.0 - match.inliers <= off
            and match.residual <= residual
        )


def pose_covariance(match: Match, sigma: float, prior: Array) -> tuple[Array, Array, float]:
    """Covariance (6, 6) of a registration, least constrained direction (3,) of the position, and its share of facing
    surface.

    Neighbouring points share errors of the map and of its discretisation (`sigma` [m]). The following scans share
    what noise did to the map (`residual`). So a scan counts as `INDEPENDENT_POINTS` points, however many it has. What
    is not observed says nothing. `prior`: (6, 6) of the prediction, see `Observed.blurred`."""
    seen = observed(match.information)
    covariance = seen.covariance((_variance(match, sigma) + seen.blurred(prior)) / INDEPENDENT_POINTS)
    h = match.information / max(seen.weight, 1e-9)
    position = h[:3, :3] - h[:3, 3:] @ np.linalg.solve(h[3:, 3:] + 1e-3 * np.eye(3), h[3:, :3])
    values, vectors = np.linalg.eigh(0.5 * (position + position.T))
    return 0.5 * (covariance + covariance.T), vectors[:, 0], max(float(values[0]), 0.0)


def _variance(match: Match, sigma: float) -> float:
    """Of one independent point about the map [m^2]."""
    return sigma**2 + (SCATTER_SHARE * match.residual) ** 2


def _sigma(covariance: Array) -> float:
    """Largest standard deviation of the first three axes: of the position [m] for a whole covariance."""
    return math.sqrt(float(max(np.linalg.eigvalsh(covariance[:3, :3])[-1], 0.0)))


def _log(matrix: Array) -> Array:
    """Small rotation vector of a rotation matrix (first order is enough for a test statistic)."""
    return 0.5 * np.array(
        [matrix[2, 1] - matrix[1, 2], matrix[0, 2] - matrix[2, 0], matrix[1, 0] - matrix[0, 1]]
    )
