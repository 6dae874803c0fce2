"""What a run needs to go on after it was interrupted: one file below 1 MB, written anew every few minutes. Adam's
moments are not kept;
they are back after a few iterations in which the critic learns alone.
"""

from __future__ import annotations

import json
import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tools.train.network import Weights
from tools.train.settings import Settings

FILE = "checkpoint.npz"
Float32 = NDArray[np.float32]


@dataclass(slots=True, eq=False)
class Checkpoint:
    """State of a run."""

    settings: Settings
    policy: Weights
    critic: Weights | None
    log_std: Float32 | None
    mean: Float32
    spread: Float32
    level: NDArray[np.int64] | None
    """(n,) of the robots."""
    iteration: int = 0
    steps: int = 0
    """Of all robots together."""
    seconds: float = 0.0
    """Of computing, with the interruptions left out."""
    rate: float | None = None

    def save(self, folder: Path) -> None:
        """Replace the file at once: an interruption leaves the old one or the new one."""
        arrays: dict[str, NDArray[np.generic]] = {"mean": self.mean, "spread": self.spread}
        for k, (weight, bias) in enumerate(self.policy):
            arrays[f"policy{k}.w"], arrays[f"policy{k}.b"] = (
                np.asarray(weight, np.float32),
                np.asarray(bias, np.float32),
            )
        for k, (weight, bias) in enumerate(self.critic or []):
            arrays[f"critic{k}.w"], arrays[f"critic{k}.b"] = (
                np.asarray(weight, np.float16),
                np.asarray(bias, np.float16),
            )
        if self.log_std is not None:
            arrays["log_std"] = np.asarray(self.log_std, np.float32)
        if self.level is not None:
            arrays["level"] = self.level.astype(np.int8)
        header = {
            "settings": self.settings.model_dump(mode="json"),
            "iteration": self.iteration,
            "steps": self.steps,
            "seconds": self.seconds,
            "rate": self.rate,
        }
        part = folder / f".{FILE}"
        with part.open("wb") as file:
            np.savez_compressed(file, header=np.array(json.dumps(header)), **arrays)  # type: ignore[arg-type]
            file.flush()
            os.fsync(file.fileno())
        part.replace(folder / FILE)

    @staticmethod
    def load(folder: Path) -> Checkpoint:
        """What `save` wrote. Raises FileNotFoundError."""
        with np.load(folder / FILE, allow_pickle=False) as file:
            header = json.loads(str(file["header"]))

            def net(name: str) -> Weights:
                layers = sum(key.startswith(name) and key.endswith(".w") for key in file.files)
                return [
                    (file[f"{name}{k}.w"].astype(np.float32), file[f"{name}{k}.b"].astype(np.float32))
                    for k in range(layers)
                ]

            return Checkpoint(
                Settings.model_validate(header["settings"]),
                net("policy"),
                net("critic") or None,
                file["log_std"] if "log_std" in file.files else None,
                file["mean"],
                file["spread"],
                file["level"].astype(np.int64) if "level" in file.files else None,
                header["iteration"],
                header["steps"],
                header["seconds"],
                header["rate"],
            )
