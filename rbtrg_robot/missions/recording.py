"""Drive it once: poses of the robot and words of the operator become the steps of a mission."""

from __future__ import annotations

import math
from typing import Any

from rbtrg_robot.missions.file import MissionError, MissionFile, parse

HELP = "Enter: go here; wait S; ask TEXT; stand; sit; record NAME; undo; q: write the file"


class Recording:
    """Collects steps. A pose is x, y [m], yaw [rad] in `map`."""

    def __init__(self, name: str = "", prior_map: str = "", spacing: float = 0.0) -> None:
        """`spacing`: a step every so many metres on the way [m]; 0 = only where the operator says."""
        self._head = {key: text for key, text in (("name", name), ("map", prior_map)) if text}
        self._spacing = spacing
        self._steps: list[Any] = []
        self._pose: tuple[float, float, float] | None = None
        self._last: tuple[float, float, float] | None = None

    def at(self, pose: tuple[float, float, float]) -> str:
        """The robot is there; what was added, in words, or empty."""
        self._pose = pose
        far = self._last is None or math.dist(pose[:2], self._last[:2]) >= self._spacing
        return self._place() if self._spacing > 0 and far else ""

    def say(self, line: str) -> str:
        """A word of the operator; what became of it."""
        word, _, rest = line.strip().partition(" ")
        try:
            if word == "":
                return self._place()
            if word == "undo":
                return f"{len(self._steps)} steps" if self._steps and self._steps.pop() else "nothing to undo"
            step: Any = {
                "wait": lambda: {"wait": float(rest)},
                "ask": lambda: {"ask": {"question": rest}},
                "record": lambda: {"record": {"name": rest}},
                "stand": lambda: "stand",
                "sit": lambda: "sit",
            }[word]()
            parse({"steps": [step]}, word)
        except (KeyError, ValueError, MissionError):
            return HELP
        return self._add(step)

    def _place(self) -> str:
        if self._pose is None:
            return "where the robot is is not known yet"
        self._last = self._pose
        x, y, yaw = self._pose
        return self._add(
            {"goto": {"x": round(x, 3), "y": round(y, 3), "yaw_deg": round(math.degrees(yaw), 1)}}
        )

    def _add(self, step: Any) -> str:
        self._steps.append(step)
        text = step if isinstance(step, str) else " ".join(f"{k} {v}" for k, v in step.items())
        return f"step {len(self._steps)}: {text}"

    def mission(self) -> MissionFile:
        """What was recorded. Raises MissionError where that is nothing."""
        if not self._steps:
            raise MissionError("nothing was recorded: press Enter where the robot shall go")
        return parse({**self._head, "steps": self._steps}, "the recording")
