"""What a Go2-W can do with each controller of ours, in simulation and at the motors of the real robot: rates and
limits."""

from __future__ import annotations

import math
from dataclasses import replace

from hal.lowlevel import Controller
from hal.types import Capabilities

_RATES: dict[Controller, Capabilities] = {
    "vmc": Capabilities(
        "vmc",
        max_vx=1.0,
        max_wz=1.0,
        min_vx=0.06,
        min_wz=0.05,
        max_trunk_tilt=math.radians(15.0),
        creep=0.1,
    ),
    "policy": Capabilities(
        "policy",
        max_vx=1.0,
        max_vy=0.5,
        max_wz=1.0,
        min_vx=0.2,
        min_wz=0.3,
        strafe=True,
    ),
    "hybrid": Capabilities(
        "hybrid",
        max_vx=1.0,
        max_wz=1.0,
        min_vx=0.06,
        min_wz=0.05,
        max_trunk_tilt=math.radians(15.0),
        creep=0.1,
    ),
}
"""Speeds and rates; `min_vx` and `min_wz` from `tools.bench envelope`, rows `deadband_*`. The policy knows no posture:
its trunk cannot be tilted. The hybrid controller has the slow speeds and the tilt of the model-based one."""

KEPT: dict[Controller, dict[str, float]] = {
    "vmc": {
        "max_step": 0.10,
        "max_slope": math.radians(25.0),
        "max_gap": 0.10,
        "max_posts": 0.05,
    },
    "policy": {
        "max_step": 0.25,
        "max_slope": math.radians(30.0),
        "max_gap": 0.12,
        "max_posts": 0.20,
        "step_vx": 0.5,
    },
    "hybrid": {
        "max_step": 0.20,
        "max_slope": math.radians(30.0),
        "max_gap": 0.12,
        "max_posts": 0.12,
        "step_vx": 0.5,
    },
}
"""Limits, each as it was before there was an envelope: the planner's rules were tuned to them, and lanes are graded by
them. The measured ones (`hal.envelope.limits`) stand beside them in docs/simulated_robot.md. One is read off when the
planner prices what it limits."""

ABILITIES: dict[Controller, Capabilities] = {
    name: replace(rates, **KEPT[name])  # type: ignore[arg-type]
    for name, rates in _RATES.items()
}
"""By the name of the controller, which is theirs too; without LiDARs."""
