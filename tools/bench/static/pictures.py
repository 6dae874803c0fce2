"""The static study's pictures: routes over the height map per scene and graph, and bar charts."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np

mpl.use("Agg")
from matplotlib import pyplot as plt

from hal.scenes import load_scene
from planning.search.plan import VARIANTS
from tools.bench.static.study import METRICS, MODES, SCENES, Instance, survey_grid, values

COLOURS = dict(zip(VARIANTS, ("#d62728", "#ff7f0e", "#9467bd", "#1f77b4"), strict=True))


def draw(out: Path, instances: Sequence[Instance], drawn: dict[str, Any]) -> None:
    """One picture per scene and graph with the variants' routes of the first instance, one bar chart per graph."""
    for name in SCENES:
        scene = load_scene(name)
        grid = survey_grid(scene)
        x0, y0, x1, y1 = grid.extent
        for mode in MODES:
            found = drawn.get(f"{name}.{mode}")
            if found is None:
                continue
            figure, axes = plt.subplots(figsize=(11, 11 * (y1 - y0) / (x1 - x0) + 1.0), layout="constrained")
            image = axes.imshow(
                np.where(grid.trusted, grid.height, np.nan),
                origin="lower",
                extent=(x0, x1, y0, y1),
                cmap="viridis",
            )
            axes.set_facecolor("#dddddd")
            for k, (variant, plan) in enumerate(found.items()):
                x, y, _ = plan.points.T
                # Lines that coincide stay visible: the first is the widest.
                label = f"{variant}: {plan.length:.2f} m"
                axes.plot(x, y, "-o", color=COLOURS[variant], lw=6.0 - 1.1 * k, ms=3, label=label)
            ends = found["native"].points[:, :2]
            axes.plot(*ends[0], "w^", ms=11, mec="k")
            axes.plot(*ends[-1], "w*", ms=16, mec="k")
            axes.legend(loc="upper left", bbox_to_anchor=(0.0, -0.08), ncols=5, fontsize=8)
            axes.set(
                title=f"{name}, {mode} graph (grey: not seen)", xlabel="x [m]", ylabel="y [m]", aspect="equal"
            )
            figure.colorbar(image, label="height [m]", shrink=0.8)
            figure.savefig(out / f"{name}_{mode}.png", dpi=110)
            plt.close(figure)
    for mode in MODES:
        figure, panels = plt.subplots(1, len(METRICS), figsize=(16, 3.8), layout="constrained")
        for k, (metric, unit) in enumerate(METRICS.items()):
            for v, variant in enumerate(VARIANTS):
                mine = values(instances, mode, variant)
                at = np.arange(len(mine)) + 0.16 * (v - 2)
                panels[k].bar(
                    at, [a[:, k].mean() for a in mine.values()], 0.16, color=COLOURS[variant], label=variant
                )
                panels[k].set_xticks(range(len(mine)), [s.removeprefix("rescue_") for s in mine])
            panels[k].set_title(f"{metric} [{unit}]")
        figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=5, fontsize=8)
        figure.suptitle(f"Mean per scene, {mode} graph")
        figure.savefig(out / f"bars_{mode}.png", dpi=110)
        plt.close(figure)
