"""A trial seen from above: the lane, where the robot drove, and where it said what."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from hal.scenes import load_scene
from hal.scenes.picture import GREEN, RED, WHITE, TopView
from tools.bench.lanes.trial import Trial

TRACK = (90, 200, 255)
LABEL_PERIOD = 1.0
"""[s] between two labels."""


def draw(record: Mapping[str, Any], out: Path) -> None:
    """Write FILE.png for the record of a trial."""
    trial = Trial(
        record["seed"],
        record["level"],
        record["controller"],
        record["map"],
        goal=record.get("goal", ""),
        made_of=record["made_of"],
    )
    scene = load_scene(trial.scene)
    view = TopView(scene.height, scene.trusted, scene.origin, scene.resolution, 1400)
    track = record["track"]
    view.line([(p[1], p[2]) for p in track], TRACK, 2)
    for p in track[::10]:
        view.disc(p[1], p[2], TRACK, 2)
    for name, (x, y, _) in scene.goals.items():
        view.disc(x, y, RED, 5)
        view.label(x, y, name)
    last = -LABEL_PERIOD
    for state in record["states"]:
        if state["t"] - last >= LABEL_PERIOD and (
            state["detail"] or state["reason"] or state["state"] == "recovering"
        ):
            view.disc(state["x"], state["y"], WHITE, 4)
            view.label(state["x"], state["y"], f"{state['t']:.0f} s {state['reason'] or state['state']}")
            last = state["t"]
    if track:
        _, x, y, _, yaw, _ = track[-1]
        view.arrow(x, y, yaw, 0.35, GREEN)
    view.save(out)
