"""The protocol of the closed-loop study: everything that was fixed before a result was seen.
`docs/measurements/evaluation.md` gives the reasons."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from planning.tracking import TrackerConfig

SCENES = ("rescue_slopes", "rescue_platform", "rescue_steps", "rescue_elevated")
QUERY_COUNT = 10
"""Start-goal pairs per scene: those of the results in `docs/measurements/evaluation.md`."""
MOST_QUERIES = 40
"""Pairs that each scene has, for studies that resolve smaller differences."""
SHARED = ("native", "edge-only", "mean-only", "full")
"""Methods that share one graph per query, its snapped endpoints and the smoothing that looks at no risk."""
OWN = ("guarded", "ours")
"""`guarded`: full, smoothed by `planning.path.make_path` between its nodes. `ours`: the planner as it drives, see
`routes`."""
BASELINES = {
    "t_hybrid": "tools.baselines.t_hybrid:plan",
    "art": "tools.baselines.art:plan",
    "art-unmasked": "tools.baselines.art:unmasked",
}
"""Planners of others between the same snapped endpoints. T-Hybrid's line is driven as it is, ART's is smoothed like the
graphs'.
`art-unmasked`: its feet may stand on unseen ground."""
PERCEIVED = ("ours-mapped", "ours-seen")
"""The whole stack, which is told its start and nothing else of the truth: with the survey as prior map, or with what it
sees on its way."""
METHODS = (*SHARED, *OWN, *BASELINES, *PERCEIVED)
COLLIDERS = ("all", "vendor")
"""`all`: ours; `vendor`: without wheel-motor housings, as in the vendor's model."""

COMMANDED_SPEED = 0.50
"""Commanded [m/s]."""
TRACKER = TrackerConfig(max_speed=COMMANDED_SPEED, max_cross_track=100.0)
"""Frozen for all methods; it gets no slope."""
WHEEL_FRICTION = (0.6, 1.0)
"""Drawn uniformly, of the wheels."""
START_JITTER = (0.05, np.radians(5.0))
"""Largest offset of the start along x and y [m] and in yaw [rad], drawn uniformly."""
APRON_WIDTH = 1.0
"""Level ground around a scene [m]."""
SETTLE_TIME = 3.0
"""Under zero velocity before the drive [s]."""
WHEELS_NEEDED = 3
SETTLED_TILT = dict.fromkeys(SCENES, (20.0, 20.0)) | {"rescue_elevated": (35.0, 45.0)}
"""Largest |roll| and |pitch| after settling [deg]."""
GOAL_RADIUS = 0.25
"""From the goal [m]."""
TIME_BUDGET = 90.0
"""[s]"""
STRICT_SPEED, STRICT_TIME = 0.1, 0.5
"""The stricter arrival: this slow [m/s] for this long [s] within `GOAL_RADIUS`."""
STRICT_WAIT = 5.0
"""How long after arriving the stricter arrival is waited for [s]."""
DIAGNOSTIC_TIME = 20.0
"""Diagnostics are over this time from the start of the drive [s], or until arrival; no trial is ended before it."""
FALLEN_TILT, FALLEN_TIME = 60.0, 4.0
"""Tilt [deg] and how long [s]."""
STALLED_TIME = 20.0
"""Without 5 cm of progress or 2 cm nearer to the goal [s]."""
FACE_RISE = 0.30
"""A rise of the true ground within 4 cm along a route's centre line that counts as a wall [m]."""


@dataclass(frozen=True, slots=True)
class Trial:
    """One drive."""

    scene: str
    query: int
    method: str
    controller: str
    colliders: str
    draw: int

    @property
    def key(self) -> str:
        """Name in the records."""
        return ".".join(str(v) for v in asdict(self).values())


def trials(
    methods: list[str],
    controllers: list[str],
    colliders: list[str],
    scenes: list[str],
    draws: int,
    queries: int = QUERY_COUNT,
) -> list[Trial]:
    """All trials, ordered so that a study cut short is complete in its first draws."""
    return [
        Trial(scene, query, method, controller, set_of, draw)
        for controller in controllers
        for set_of in colliders
        for draw in range(draws)
        for query in range(queries)
        for scene in scenes
        for method in methods
    ]


def conditions(trial: Trial) -> dict[str, Any]:
    """Friction and start offset of a trial: the same for all methods, controllers and collider sets."""
    rng = np.random.default_rng([SCENES.index(trial.scene), trial.query, trial.draw, 77])
    friction = float(rng.uniform(*WHEEL_FRICTION))
    dx, dy, dyaw = (rng.uniform(-1.0, 1.0, 3) * (START_JITTER[0], START_JITTER[0], START_JITTER[1])).tolist()
    return {"friction": friction, "dx": dx, "dy": dy, "dyaw": dyaw}


def methods_in(records: Sequence[Mapping[str, Any]]) -> list[str]:
    """Methods of the records: the known ones in their order, then planners of one's own."""
    there = {r["method"] for r in records}
    return [m for m in METHODS if m in there] + sorted(there - set(METHODS))
