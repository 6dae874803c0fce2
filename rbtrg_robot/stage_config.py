"""Parameters of the middleware's own parts. Those of the libraries stand beside their code."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, field_validator

from hal.named import PATTERN
from hal.types import Capabilities
from planning.graph.params import GraphParams, GraphSettings


class NavigatorConfig(BaseModel):
    """Patience of the navigator."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    replan_period: float = Field(2.0, gt=0, description="least time between two replans while driving [s]")
    plan_retry: float = Field(2.0, gt=0, description="ask the planner again after [s]")
    input_timeout: float = Field(1.2, gt=0, le=5.0, description="odometry or map older than this halts [s]")
    patience: float = Field(12.0, gt=0, description="give up after inputs were missing for [s]")
    goal_tolerance: float = Field(
        0.25, gt=0, description="a path that ends further from the goal does not reach it [m]"
    )
    short_retries: int = Field(3, ge=0, description="replans from a path's end that fell short of the goal")
    no_route_retries: int = Field(
        2, ge=0, description="replans at a place, after the first, before other ways out of it are tried"
    )
    max_recoveries: int = Field(
        3, ge=0, description="recoveries at one place before the goal is given up as stuck"
    )
    max_touches: int = Field(
        8,
        ge=1,
        le=50,
        description="touches before a goal is given up: a pane 4 m wide is gone round after as many",
    )
    back_out: float = Field(0.6, gt=0, description="how far to move out of a place when stuck [m]")
    avoid_ahead: float = Field(
        0.5, gt=0, description="where the obstacle is thought to be: ahead of base_link [m]"
    )
    avoid_radius: float = Field(0.3, gt=0, description="radius kept free around it [m]")
    look_pitch: float = Field(
        0.26,
        ge=0.0,
        le=0.5,
        description="nose down to look at the ground ahead, as far as the robot can; at 0.26 an XT16 sees level ground "
        "from 0.9 m on instead of 1.9 m [rad]",
    )


class FreshnessConfig(BaseModel):
    """Largest age of the tracker's inputs while it drives."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    pose: float = Field(0.12, ge=0.04, le=0.5, description="control pose [s]")
    scan: float = Field(0.8, ge=0.3, le=2.0, description="scan odometry behind the pose [s]")
    map: float = Field(1.2, ge=0.8, le=3.0, description="map status [s]")
    goal: float = Field(1.0, ge=0.6, le=3.0, description="goal status of the navigator [s]")


class GraphConfig(GraphSettings):
    """Settings of the graph in the stack: its limits are the robot's own, a number here only makes them tighter."""

    max_step: float | None = Field(
        None,
        gt=0.0,
        description="highest vertical face driven over [m]; None = what robot and controller can",
    )
    max_slope: float | None = Field(
        None, gt=0.0, lt=1.5, description="steepest ground at body scale [rad]; None = what the robot can"
    )
    max_gap: float | None = Field(
        None, ge=0.0, description="widest gap or unseen slit driven over [m]; None = what the robot can"
    )

    max_posts: float | None = Field(
        None,
        gt=0.0,
        description="highest posts of a stepfield that is driven through [m]; None = what robot and controller can",
    )

    keep_step: float = Field(
        0.03, ge=0.0, description="ground found drivable stays so up to this much above max_step [m]"
    )

    def params(self, robot: Capabilities, controller: str) -> GraphParams:
        """For a robot that can so much, driven by a controller with an envelope."""
        limits = {
            name: own if (wanted := getattr(self, name)) is None else min(wanted, own)
            for name, own in (
                ("max_step", robot.max_step),
                ("max_slope", robot.max_slope),
                ("max_gap", robot.max_gap),
                ("max_posts", robot.max_posts),
            )
        }
        return GraphParams(**(self.model_dump() | limits), controller=controller)


GUARD_RANGE = 2.4
"""[m] the guard looks ahead of the body. A LiDAR sees the ground below an edge only far behind the edge: one on the
back whose lowest beam goes down by 15 deg shows that ground lies a step lower not before 2.3 m ahead of the body."""


class GuardConfig(BaseModel):
    """Distances and times at which the guard slows the robot down.

    Bounds: `reaction` is a sweep, a tick of the guard and a period of the gate at least (0.17 s); the simulated robot
    brakes with 3 m/s^2, the vendor's is not measured; the map errs by 0.02 m at an edge.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    reaction: float = Field(
        0.3, ge=0.2, le=1.0, description="from the sweep that shows an obstacle to the brakes [s]"
    )
    deceleration: float = Field(
        1.5, ge=0.5, le=2.5, description="that the robot brakes with at least [m/s^2]"
    )
    margin: float = Field(0.03, ge=0.02, le=0.3, description="kept between body and obstacle [m]")
    window_timeout: float = Field(
        0.5, ge=0.2, le=1.0, description="a map window older than this says nothing [s]"
    )
    pose_timeout: float = Field(0.2, ge=0.05, le=0.5, description="so does a pose [s]")

    def fastest(self) -> float:
        """[m/s] from which the body stops within what the guard looks at."""
        left = GUARD_RANGE - self.margin
        return self.deceleration * (
            math.sqrt(self.reaction**2 + 2.0 * left / self.deceleration) - self.reaction
        )


class ElevationStageConfig(BaseModel):
    """Cadence of the elevation process, counted in scans so that a re-run makes the same map."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    publish_every: int = Field(5, ge=1, description="scans between two map updates")
    window: float = Field(2.8, gt=0, le=10.0, description="half width of the window around the robot [m]")
    clean_every: int = Field(3, ge=1, description="scans between two visibility clean-ups")
    finder: str = Field(
        "branch_and_bound",
        pattern=PATTERN,
        description="who finds the robot in a prior map: the project's, an installed finder (entry point of "
        "rbtrg.finders) or package.module:function (docs/extend.md)",
    )


class LoopsConfig(BaseModel):
    """Loops that are closed while the robot works."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    online: bool = Field(False, description="find loops while the stack runs, and close them")
    least: float = Field(0.1, ge=0.0, description="a map that moves less than this is not taken [m]")
    drift: float = Field(
        1.0, ge=0.1, le=100.0, description="how many times more than usual the odometry drifts"
    )


class PlannerConfig(BaseModel):
    """Settings of the planner process; the graph and the body have their own."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    method: str = Field(
        "rb_trg",
        pattern=PATTERN,
        description="rb_trg: the project's planner; an installed planner (entry point of rbtrg.planners) or "
        "package.module:function (docs/extend.md)",
    )
    variant: Literal["native", "edge-only", "mean-only", "full"] = Field(
        "full", description="rb_trg: cost variant of the search"
    )
    backward: float = Field(
        1.6, ge=1.0, description="factor of the cost of a metre driven backward; .inf = forward only"
    )
    turning: float = Field(
        0.3,
        ge=0.0,
        description="cost of a turn [m/rad]; half of the way at 0.5 m/s in the time of a turn at 0.8 rad/s; "
        "0 = as in the paper",
    )
    accept_risk: float = Field(
        0.2,
        ge=0.0,
        le=1.0,
        description="largest probability that a route fails with which its goal is driven to; above it the "
        "goal is refused unless it was sent with --accept",
    )
    update_period: float = Field(
        2.0,
        gt=0,
        description="the graph follows the map this often while a path is driven, and at each request [s]",
    )


class RecorderConfig(BaseModel):
    """When to flush, when to begin a new file, and what may stay on the disk."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    profile: Literal["full", "standard", "lean"] = Field(
        "standard",
        description="standard: odometry and map can be made again, sweeps packed; full: everything; lean: no "
        "clouds, no re-run",
    )
    flush_period: float = Field(
        0.25, gt=0, description="most that a killed recorder loses, beside what comes until it is back [s]"
    )
    rotate_seconds: float = Field(300.0, gt=0, description="begin a new file after [s]")
    rotate_megabytes: int = Field(1000, gt=0, description="or after [MB]")
    keep_gb: float = Field(
        50.0, gt=0, description="all runs of a log folder together; the oldest unmarked go first [GB]"
    )
    spare_gb: float = Field(
        2.0,
        ge=0,
        description="free space below which no clouds are recorded, and nothing below a tenth of it [GB]",
    )


class CommsConfig(BaseModel):
    """What the robot does when nobody watches it any more."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    timeout: float = Field(
        30.0, gt=0, le=86400, description="no operator is in contact after so long without a sign of one [s]"
    )
    on_loss: Literal["continue", "hold", "return"] = Field(
        "continue",
        description="then: go on, stand until one is, or come home along the trail until one is; a mission "
        "may have its own",
    )


class HomeConfig(BaseModel):
    """When a battery sends the robot home."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    reserve: float = Field(
        1.2,
        ge=1.0,
        le=5.0,
        description="the way home may take so many times what driving cost so far",
    )
    per_metre: float = Field(
        0.0005,
        gt=0.0,
        le=0.1,
        description="state of charge [0..1] that a metre takes at least, and alone until driving took 2 %",
    )
    speed: float = Field(
        0.3, gt=0.0, le=3.0, description="speed along ways home, by experience of explored ground [m/s]"
    )
    told_ahead: float = Field(
        120.0, ge=0.0, le=3600.0, description="so long before the way home must begin it is told [s]"
    )


class ConsoleConfig(BaseModel):
    """Where the page for operators is served."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    address: str = Field(
        "127.0.0.1",
        pattern=r"^([0-9]{1,3}(\.[0-9]{1,3}){3}|[0-9a-fA-F:]+|[A-Za-z][A-Za-z0-9.-]*)$",
        description="address of this computer to serve on; any but 127.0.0.1 needs the keys of `keys init`",
    )
    port: int = Field(
        7480, ge=0, le=65535, description="TCP port; another free one where it is taken on 127.0.0.1; 0 = any"
    )

    webhooks: tuple[Annotated[str, Field(pattern=r"^https?://[^\s/]+(/\S*)?$")], ...] = Field(
        (), description="addresses that every event is posted to as JSON (http or https)"
    )

    @field_validator("address")
    @classmethod
    def _one_address(cls, value: str) -> str:
        if value in ("0.0.0.0", "::"):
            raise ValueError("name one address of this computer: browsers must say which they mean")
        return value
