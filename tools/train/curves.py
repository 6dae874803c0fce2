"""Learning curves as a picture."""

from __future__ import annotations

import json
from pathlib import Path

PICTURE = "curves.png"


def draw(folder: Path) -> Path:
    """Reward, level of each kind of ground, share of episodes passed and learning rate over the steps -> the
    picture."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    lines = [json.loads(line) for line in (folder / "curves.jsonl").read_text().splitlines()]
    steps = [line["steps"] / 1e6 for line in lines]
    figure, axes = plt.subplots(2, 2, figsize=(10, 7), constrained_layout=True)
    axes[0, 0].plot(steps, [line["reward"] for line in lines])
    axes[0, 0].set_ylabel("reward per step")
    for name in lines[-1]["level"]:
        axes[0, 1].plot(steps, [line["level"][name] for line in lines], label=name)
    axes[0, 1].set_ylabel("mean level")
    axes[0, 1].legend()
    for name in lines[-1]["level"] | lines[-1]["passed"]:
        axes[1, 0].plot(steps, [line["passed"].get(name, float("nan")) for line in lines], label=name)
    axes[1, 0].set_ylabel("episodes passed")
    axes[1, 0].legend()
    axes[1, 1].plot(steps, [line["std"] for line in lines], label="spread of the outputs")
    axes[1, 1].plot(steps, [1000.0 * line["rate"] for line in lines], label="learning rate x 1000")
    axes[1, 1].legend()
    for axis in axes.flat:
        axis.set_xlabel("million steps")
        axis.grid(alpha=0.3)
    figure.savefig(folder / PICTURE, dpi=80)
    plt.close(figure)
    return folder / PICTURE
