"""What a robot is, as its folder says it in `robot.yaml`."""

from __future__ import annotations

import math
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from hal.errors import OperatorError
from hal.lidar.config import LidarConfig
from hal.limbs import LEGS, MOTORS, Limbs, stand_height
from hal.named import BESIDE, PATTERN, beside, named
from hal.types import Array, Capabilities, Extrinsics

_CHECKED = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class RobotError(OperatorError):
    """A robot's folder is missing or wrong; the message says what to write."""


class Body(BaseModel):
    """The box that drives: what must not touch anything."""

    model_config = _CHECKED

    length: float = Field(gt=0.0, le=3.0, description="[m], along x, base_link in its middle")
    width: float = Field(gt=0.0, le=3.0, description="[m], wheels included")
    mass: float = Field(gt=0.0, le=500.0, description="whole robot [kg]")
    sprung_mass: float = Field(
        gt=0.0, le=500.0, description="[kg] that the wheels push: all but wheels and shanks"
    )
    touch_force: float = Field(
        30.0,
        gt=0.0,
        le=1000.0,
        description="[N] on the body beyond what wheels and IMU explain: it touches something",
    )
    axle: float = Field(
        gt=0.0, le=2.0, description="[m] as it drives, wheels touch the ground before and behind base_link"
    )


class Lanes(BaseModel):
    """How lanes are drawn for a controller (`hal.scenes.lanes`), in m, slopes in degrees."""

    model_config = _CHECKED

    within: dict[str, float] = Field(
        description="largest that it drives over reliably with friction 0.6 to 1.0, no more than its "
        "capabilities declare"
    )
    beyond: dict[str, tuple[float, float]] = Field(
        description="least and most of what its capabilities forbid without doubt: 1.4 times the declared "
        "limit and more"
    )

    @model_validator(mode="after")
    def _whole(self) -> Lanes:
        for name, values, wanted in (
            ("within", set(self.within), {"slope", "step", "bar", "rail", "posts", "gap", "rough"}),
            ("beyond", set(self.beyond), {"slope", "step", "bar", "gap"}),
        ):
            if values != wanted:
                raise ValueError(f"{name} has {', '.join(sorted(wanted))}")
        return self

    @classmethod
    def of(cls, able: Capabilities) -> Lanes:
        """By what is declared, where nobody says better."""
        slope, step, gap = math.degrees(able.max_slope), able.max_step, able.max_gap
        return cls(
            within={
                "slope": 0.8 * slope,
                "step": step,
                "bar": step,
                "rail": 0.8 * step,
                "posts": able.max_posts,
                "gap": gap,
                "rough": 0.5 * step,
            },
            beyond={
                "slope": (max(1.4 * slope, 36.0), max(1.8 * slope, 45.0)),
                "step": (max(1.6 * step, 0.16), max(2.4 * step, 0.24)),
                "bar": (max(1.6 * step, 0.16), max(2.4 * step, 0.24)),
                "gap": (1.8 * gap, max(3.0 * gap, 0.30)),
            },
        )


class Controller(BaseModel):
    """What the robot can do with one of its controllers. Speeds as in `hal.types.Capabilities`."""

    model_config = _CHECKED

    what: str = Field(description="in one line")
    envelope: str = Field(description="file of what it was measured to do")
    service: bool = Field(False, description="the vendor's own, on the real robot alone")
    capabilities: dict[str, float | bool]
    lanes: Lanes | None = Field(None, description="None: by its capabilities")

    @model_validator(mode="after")
    def _known(self) -> Controller:
        try:
            Capabilities("", **self.capabilities)  # type: ignore[arg-type]
        except TypeError as error:
            raise ValueError(f"{str(error).rpartition(' ')[2]} is no field of Capabilities") from error
        return self


class Robot(BaseModel):
    """Everything that is a fact of a robot. Lengths [m], angles [rad], frame base_link: x forward, y left, z up."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, arbitrary_types_allowed=True)

    folder: Path
    name: str = Field(pattern=r"^[a-z][a-z0-9_-]*$")
    title: str
    body: Body
    limbs: Limbs
    moves: tuple[str, ...] = Field(MOTORS, description="joints that it has, by the names of hal.limbs.MOTORS")
    stand: tuple[float, float, float] = Field(description="hip, thigh and calf angle as it stands [rad]")
    imu: Extrinsics
    mounts: dict[str, Extrinsics] = Field({}, description="usual pose of a LiDAR, by its model")
    lidars: tuple[LidarConfig, ...] = Field(description="what it carries as it is delivered")
    controllers: dict[str, Controller] = Field(min_length=1, description="the first one is the default")
    backends: tuple[str, ...] = Field(("sim",), description="by which it can be driven")
    simulated: str = Field(
        "", description=".module:object of the folder, or package.module:object, a hal.mujoco.robot.Simulated"
    )
    checks: str = Field(
        "", description="package.module:function that raises where a controller would not start"
    )
    fetches: str = Field(
        "",
        description="package.module:function(name, source) that fetches a public policy and tells of it, line by line",
    )
    tells: str = Field(
        "", description="package.module:function(policy) that tells what a learnt policy needs, line by line"
    )
    description: str = Field(
        "", pattern=rf"^$|{PATTERN}|{BESIDE}", description="function that writes its URDF"
    )
    settings: dict[str, Any] = Field(
        {}, description="of the stack's configuration, where its defaults do not suit"
    )

    @model_validator(mode="after")
    def _fits(self) -> Robot:
        unknown = sorted(set(self.moves) - set(MOTORS))
        if unknown:
            raise ValueError(f"moves: {', '.join(unknown)} is no joint; there are {', '.join(MOTORS)}")
        for lidar in self.lidars:
            if lidar.mount is None and lidar.model not in self.mounts:
                raise ValueError(f"mounts: say where the {lidar.model} sits")
        if "sim" in self.backends and not self.simulated:
            raise ValueError("simulated: name what MuJoCo builds it from, or leave `sim` out of `backends`")
        return self

    @cached_property
    def pose(self) -> Array:
        """(16,) joint angles [rad] as it stands."""
        return np.array([*self.stand] * len(LEGS) + [0.0] * len(LEGS))

    @cached_property
    def height(self) -> float:
        """Of base_link above level ground as it stands [m]."""
        return stand_height(self.limbs, self.pose)

    @property
    def wheeled(self) -> bool:
        """Its wheels turn: else it stands on feet."""
        return MOTORS[-1] in self.moves

    @property
    def own(self) -> tuple[str, ...]:
        """Controllers of ours: those that drive it in simulation."""
        return tuple(name for name, controller in self.controllers.items() if not controller.service)

    @property
    def usual(self) -> str:
        """The controller that it is delivered with."""
        return next(iter(self.controllers))

    def capabilities(self, controller: str) -> Capabilities:
        """Of a controller. Raises RobotError."""
        limits: dict[str, Any] = self._controller(controller).capabilities
        return Capabilities(
            f"{self.name}-{controller}", length=self.body.length, width=self.body.width, **limits
        )

    def lanes(self, controller: str) -> Lanes:
        """How lanes are drawn for a controller. Raises RobotError."""
        return self._controller(controller).lanes or Lanes.of(self.capabilities(controller))

    def envelope_file(self, controller: str) -> Path:
        """Where the envelope of a controller stands. Raises RobotError."""
        return self.folder / self._controller(controller).envelope

    def mounted(self, lidars: tuple[LidarConfig, ...]) -> tuple[LidarConfig, ...]:
        """LiDARs that say where they are: where nothing else is said, where this robot usually carries them."""
        return tuple(
            lidar
            if lidar.mount is not None
            else lidar.model_copy(update={"mount": self.mounts.get(lidar.model, lidar.spec.mount)})
            for lidar in lidars
        )

    def check(self, controller: str, policy: str) -> None:
        """Whether a controller can be started with the learnt policy of that file or name. Raises an OperatorError."""
        self._controller(controller)
        if self.checks:
            self.load(self.checks)(controller, policy)

    def model(self) -> Any:
        """What MuJoCo builds it from, a `hal.mujoco.robot.Simulated`. Raises RobotError, NamedError."""
        if not self.simulated:
            raise RobotError(f"robot {self.name} cannot be simulated: `simulated` in its robot.yaml is empty")
        return self.load(self.simulated)

    def load(self, target: str) -> Any:
        """What a door of the folder names. Raises NamedError."""
        what = f"part of robot {self.name}"
        if target.startswith("."):
            return beside(self.folder, target, what)
        return named(target, what, "rbtrg.robots")

    def _controller(self, name: str) -> Controller:
        if name not in self.controllers:
            raise RobotError(
                f"robot {self.name} has no controller {name!r}: use {', '.join(self.controllers)}"
            )
        return self.controllers[name]
