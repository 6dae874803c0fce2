"""Bars of success per scene, and routes with the ways driven."""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np

mpl.use("Agg")
from matplotlib import pyplot as plt

from tools.bench.closed_loop.protocol import SCENES, methods_in
from tools.bench.closed_loop.routes import Route, scene_of

COLOURS = {
    "native": "#d62728",
    "edge-only": "#ff7f0e",
    "mean-only": "#9467bd",
    "full": "#1f77b4",
    "guarded": "#17becf",
    "ours": "#111111",
    "t_hybrid": "#8c564b",
    "art": "#e377c2",
    "art-unmasked": "#f7b6d2",
    "ours-mapped": "#555555",
    "ours-seen": "#999999",
}


def colour_of(method: str) -> str:
    """Of a line or bar; a planner of one's own gets one that depends on its name alone."""
    return COLOURS.get(method, f"C{zlib.crc32(method.encode()) % 10}")


def draw(out: Path, records: Sequence[dict[str, Any]], routes: Sequence[Route]) -> None:
    """One bar chart per controller and collider set, one picture of the routes per scene."""
    for controller, colliders in sorted({(r["controller"], r["colliders"]) for r in records}):
        mine = [r for r in records if (r["controller"], r["colliders"]) == (controller, colliders)]
        bars(out / f"success_{controller}_{colliders}.png", mine)
    for scene in sorted({r["scene"] for r in records}):
        maps(out / f"routes_{scene}.png", scene, [r for r in routes if r.scene == scene])


def bars(file: Path, records: Sequence[dict[str, Any]]) -> None:
    """End-to-end success per scene and method; light: eligible trials."""
    methods = methods_in(records)
    scenes = [s for s in SCENES if any(r["scene"] == s for r in records)]
    figure, axes = plt.subplots(figsize=(9, 3.6), layout="constrained")
    width = 0.84 / len(methods)
    for k, method in enumerate(methods):
        for j, scene in enumerate((*scenes, "all")):
            mine = [r for r in records if r["method"] == method and scene in (r["scene"], "all")]
            at = j + width * (k - 0.5 * (len(methods) - 1))
            share = [100 * np.mean([r[n] for r in mine]) for n in ("eligible", "success")]
            axes.bar(at, share[0], 0.9 * width, color=colour_of(method), alpha=0.25)
            axes.bar(at, share[1], 0.9 * width, color=colour_of(method), label=method if j == 0 else None)
    axes.set_xticks(range(len(scenes) + 1), [*(s.removeprefix("rescue_") for s in scenes), "all"])
    axes.set(ylabel="trials [%]", ylim=(0, 100), title="Success end to end (light: eligible)")
    figure.legend(loc="outside lower center", ncols=6, fontsize=8)
    figure.savefig(file, dpi=90)
    plt.close(figure)


def maps(file: Path, name: str, routes: Sequence[Route]) -> None:
    """All queries of a scene: the true ground and each method's line."""
    scene = scene_of(name)
    x0, y0, x1, y1 = scene.extent
    queries = sorted({r.query for r in routes})
    figure, panels = plt.subplots(
        (len(queries) + 1) // 2,
        2,
        figsize=(12, 1.2 + 2.4 * len(queries) / 2),
        layout="constrained",
        squeeze=False,
    )
    for panel, query in zip(panels.ravel(), queries, strict=False):
        panel.imshow(scene.height, origin="lower", extent=(x0, x1, y0, y1), cmap="Greys")
        for r in (r for r in routes if r.query == query and r.line):
            line = np.array(r.line)
            panel.plot(line[:, 0], line[:, 1], color=colour_of(r.method), lw=1.2, label=r.method)
        panel.set_title(f"{query}", fontsize=8, loc="left")
        panel.set_axis_off()
    labels = {
        label: h for p in panels.ravel() for h, label in zip(*p.get_legend_handles_labels(), strict=True)
    }
    figure.legend(labels.values(), labels.keys(), loc="outside lower center", ncols=8, fontsize=8)
    figure.savefig(file, dpi=70)
    plt.close(figure)
