"""Inputs and outputs of planning."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from planning.risk.chance import Chance

Place = tuple[float, float] | int
"""x, y in metres, or the index of a node."""

Variant = Literal["native", "edge-only", "mean-only", "full"]
VARIANTS: tuple[Variant, ...] = ("native", "edge-only", "mean-only", "full")
"""native: the graph's own cost; edge-only: no turns; mean-only: no tails; full: the paper's method."""
SETS = ("edge", "sweep", "terminal sweep")


@dataclass(frozen=True, slots=True)
class DriveRules:
    """How the robot drives, which is no part of the paper's cost and the same for all its variants."""

    backward: float = math.inf
    """Factor of a metre driven backward; infinite: it drives forward only. Not for `native` and `edge-only`, which know
    no turns."""
    turning: float = 0.0
    """What a turn costs [m/rad], as it takes time. Not for `native` and `edge-only`."""
    straight: bool = False
    """Straighten the route where that costs no more (`planning.search.straight`), on a graph that knows its map."""
    guarded: bool = False
    """Turn on the spot only where the guard lets the body turn (`planning.search.guarded`), if there is such a way, on
    a graph that knows its map."""


@dataclass(frozen=True, slots=True)
class Driven:
    """What is left of the route that is driven."""

    points: NDArray[np.float64]
    """(n, 2) x, y [m] ahead of the robot, the end of the route last."""
    back: NDArray[np.bool_]
    """(n,) whether the way to each of these is driven backward."""


@dataclass(frozen=True, slots=True)
class PlanRequest:
    """Start and goal. A place is x, y [m] in `map` or a node index; yaw in radians, None = any."""

    start: Place
    goal: Place
    start_yaw: float | None = None
    goal_yaw: float | None = None
    variant: Variant = "full"
    allow_frontier: bool = False
    """For a goal that cannot be reached over known ground, plan to the most promising frontier instead."""
    previous_frontier: tuple[float, float] | None = None
    """x, y [m] of the frontier driven to so far (`Plan.frontier`): it is kept unless another is clearly better."""
    tried: tuple[tuple[float, float, float], ...] = ()
    """x, y, radius [m] around places where the robot looked from already, and around frontiers that it gave up, in
    which no frontier is left."""
    rules: DriveRules = DriveRules()
    driven: Driven | None = None
    """Kept where it leads to the same end, unless the new route is clearly better (`planning.search.keep`)."""
    held: tuple[bool, bool] = (False, False)
    """Whether the guard held a turn on the spot at `start` to the left, to the right: it sees more than the map.
    Another way is taken, if there is one."""


@dataclass(frozen=True, slots=True)
class Transition:
    """One edge of the route with the turn before it (and after it, at the goal), and why it costs what it does."""

    nodes: tuple[int, int]
    length: float
    """Planar [m]."""
    risk: float
    """Native risk r of the edge [-]."""
    body: float
    """B [-]."""
    unknown: float
    """U [-]."""
    cost: float
    """[m]: length (1 + sigma r + lambda_b B + lambda_u U) under the searched variant, `turn_cost` and `price`."""
    turn_cost: float
    """[m] for turning before the edge (or after it, at the goal), its price included, see `planning.risk.turns`."""
    price: float
    """[m] for what the edge crosses, by the controller's envelope (`planning.graph.prices`)."""
    backward: bool
    """Driven with the rear of the body ahead."""
    mean: dict[str, dict[str, float]]
    """Per pose set and feature (`FEATURES`): mean of the scaled values."""
    tail: dict[str, dict[str, float]]
    """Per pose set and feature: mean of the largest tenth."""
    peak: dict[str, dict[str, float]]
    """Per pose set and feature: largest value, unscaled [m, deg, m, -]."""


@dataclass(frozen=True, slots=True)
class Plan:
    """A route over the graph and its explanation."""

    nodes: tuple[int, ...]
    """Node indices, start to goal. A start or goal that is no node of the graph comes after its last node."""
    cost: float
    """[m], under the searched variant."""
    native_cost: float
    """[m], sum of l (1 + sigma r) of the same route."""
    length: float
    """Planar length of the route [m]."""
    transitions: tuple[Transition, ...]
    points: NDArray[np.float64] = field(repr=False)
    """(n, 3) x, y, z [m], `map`: the nodes, inner ones moved where the route was straightened."""
    request: PlanRequest
    reaches_goal: bool = True
    """False when the plan ends at a frontier, from where the robot has to look again."""
    frontier: tuple[float, float] | None = None
    """x, y [m] of that frontier."""
    to_go: float = 0.0
    """[m] from that frontier to the goal, see `planning.search.to_go.way_to_go`."""
    short: float = 0.0
    """[m] from the plan's end to the goal asked for, where that is too near to something to stand there; around walls,
    where nothing leads to it."""
    kept: bool = False
    """This is what was left of the route driven so far."""
    expanded: int = 0
    """States the search expanded."""
    chance: Chance | None = None
    """How likely it fails, see `planning.risk.chance`; None: not told."""

    @property
    def p_fail(self) -> float:
        """Probability that the route fails, as far as it is planned; NaN: not known."""
        return math.nan if self.chance is None else self.chance.p_fail

    @property
    def worth(self) -> float:
        """[m] all the way to the goal as far as it is known: what is still to be paid. Smaller is better."""
        return self.cost + self.to_go

    @property
    def maxima(self) -> tuple[float, float, float, float]:
        """Largest d_fb [m], a_lr [deg], p_int [m], u [-] of any pose of the route, turns included."""
        sets = [p for t in self.transitions for p in t.peak.values()]
        d, a, p, u = (max((s[f] for s in sets), default=0.0) for f in ("d_fb", "a_lr", "p_int", "u"))
        return d, a, p, u
