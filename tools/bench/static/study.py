"""Every instance of the static study: one start-goal pair on one graph under one variant, measured."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hal.scenes import Scene, load_scene
from mapping.grid import ElevationGrid
from planning.errors import NoRoute
from planning.graph.graph import TraversalGraph
from planning.risk.body import BodyModel
from planning.risk.table import RiskTable
from planning.search.plan import VARIANTS, Plan, PlanRequest, plan
from tools.baselines.native import NativeParams, native_graph, snapped
from tools.bench.static.floor import edge_peaks, least_maxima

SCENES = ("rescue_slopes", "rescue_platform", "rescue_steps", "rescue_elevated")
MODES: dict[str, Callable[[ElevationGrid, tuple[float, float], NativeParams, int], TraversalGraph]] = {
    "native": native_graph,
    "corrected": TraversalGraph.build,
}
"""The graphs that are compared."""
METRICS = {"length": "m", "d_fb": "m", "a_lr": "deg", "p_int": "m", "untrusted": "-"}
EXPECTED = {"length": 0.023, "d_fb": -0.100, "a_lr": -0.085, "p_int": -0.149}
"""Relative change of full against native that the paper reports."""
PAPER_NATIVE = {"length": 5.1, "d_fb": 0.60, "a_lr": 36.0, "p_int": 0.56, "untrusted": 0.104}
"""The paper's native means; untrusted as a share."""


@dataclass(frozen=True, slots=True)
class Instance:
    """One start-goal pair on one graph under one variant."""

    scene: str
    graph: str
    seed: int
    pair: int
    variant: str
    nodes: tuple[int, ...]
    length: float
    d_fb: float
    a_lr: float
    p_int: float
    untrusted: float
    cost: float
    least: tuple[float, float, float]
    """Least largest d_fb, a_lr, p_int of any route between these two nodes, each by a route of its own, turns left out.
    """


def measure(route: Plan) -> tuple[float, float, float, float, float]:
    """Length [m], largest d_fb [m], a_lr [deg], p_int [m], mean untrusted share of a route."""
    d_fb, a_lr, p_int, _ = route.maxima
    weight = [t.length for t in route.transitions]
    unknown = [t.mean["edge"]["u"] for t in route.transitions]
    return route.length, d_fb, a_lr, p_int, float(np.average(unknown, weights=weight))


def survey_grid(scene: Scene) -> ElevationGrid:
    """What the scanner stations know of a scene; without a survey, the scene itself."""
    height = scene.height if scene.survey is None else scene.survey
    return ElevationGrid(height, scene.trusted, scene.origin, scene.resolution)


def study(seeds: int, pairs: int) -> tuple[list[Instance], dict[str, Any], list[str]]:
    """All instances, the plans to draw (scene, graph) -> variant -> plan, and what had no route."""
    body = BodyModel()
    instances: list[Instance] = []
    drawn: dict[str, Any] = {}
    missing: list[str] = []
    for name in SCENES:
        scene = load_scene(name)
        grid = survey_grid(scene)
        for mode in MODES:
            for seed in range(seeds):
                try:
                    graph = MODES[mode](grid, scene.start[:2], NativeParams(), seed)
                except NoRoute as none:
                    missing += [f"{name}, {mode}, seed {seed}, pair {k}: {none}" for k in range(pairs)]
                    continue
                table = RiskTable(graph, grid, body)
                edges, peaks = graph.edges, edge_peaks(table, body)
                for k, (start, goal) in enumerate(scene.pairs[:pairs]):
                    try:
                        ends = snapped(graph, grid, start, goal)
                        found = {
                            v: plan(graph, grid, PlanRequest(*ends, variant=v), body, table) for v in VARIANTS
                        }
                    except NoRoute as none:
                        missing.append(f"{name}, {mode}, seed {seed}, pair {k}: {none}")
                        continue
                    if len(found["native"].nodes) < 2:
                        missing.append(f"{name}, {mode}, seed {seed}, pair {k}: start and goal share a node")
                        continue
                    d_fb, a_lr, p_int = least_maxima(edges, peaks, len(graph.nodes), *ends).tolist()
                    drawn.setdefault(f"{name}.{mode}", found)
                    instances += [
                        Instance(name, mode, seed, k, v, p.nodes, *measure(p), p.cost, (d_fb, a_lr, p_int))
                        for v, p in found.items()
                    ]
    return instances, drawn, missing


def values(instances: Sequence[Instance], graph: str, variant: str) -> dict[str, NDArray[np.float64]]:
    """Per scene the metrics (queries, 5) of one variant, each the mean over the graphs on which the query has a
    route."""
    return averaged(instances, graph, variant, lambda i: [getattr(i, m) for m in METRICS])


def averaged(
    instances: Sequence[Instance], graph: str, variant: str, of: Callable[[Instance], Sequence[float]]
) -> dict[str, NDArray[np.float64]]:
    """Per scene (queries, k) means of `of`; queries stand in the same order for every variant."""
    cells: dict[str, dict[int, list[Sequence[float]]]] = {}
    for i in instances:
        if (i.graph, i.variant) == (graph, variant):
            cells.setdefault(i.scene, {}).setdefault(i.pair, []).append(of(i))
    return {
        s: np.array([np.mean(cells[s][q], axis=0) for q in sorted(cells[s])]) for s in SCENES if s in cells
    }


def macro(scenes: dict[str, NDArray[np.float64]]) -> NDArray[np.float64]:
    """(k,) mean of the scenes' means."""
    return np.mean([v.mean(axis=0) for v in scenes.values()], axis=0)


def interval(
    variant: dict[str, NDArray[np.float64]], native: dict[str, NDArray[np.float64]], draws: int = 10_000
) -> NDArray[np.float64]:
    """(2, 5) 95 % bootstrap interval of the relative change of the macro mean: whole queries are resampled within their
    scene, paired."""
    rng = np.random.default_rng(0)
    picks = {s: rng.integers(0, len(v), (draws, len(v))) for s, v in native.items()}
    top = np.mean([variant[s][picks[s]].mean(axis=1) for s in native], axis=0)
    bottom = np.mean([native[s][picks[s]].mean(axis=1) for s in native], axis=0)
    return np.percentile(top / bottom - 1.0, [2.5, 97.5], axis=0)


def changed(instances: Sequence[Instance], graph: str, variant: str) -> float:
    """Share of instances whose node sequence differs from the native one."""
    native = {
        (i.scene, i.seed, i.pair): i.nodes for i in instances if (i.graph, i.variant) == (graph, "native")
    }
    mine = [i for i in instances if (i.graph, i.variant) == (graph, variant)]
    return float(np.mean([i.nodes != native[i.scene, i.seed, i.pair] for i in mine]))
