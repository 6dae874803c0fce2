"""The whole stack's configuration: one frozen model, validated before any process starts.

Layers, later ones win: defaults, `--config FILE` (YAML), `--set a.b=c`, the flags of `up`.
"""

from __future__ import annotations

import math
import platform
from collections.abc import Iterable
from copy import deepcopy
from importlib.metadata import entry_points
from pathlib import Path
from typing import Annotated, Any

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator

from hal.camera import CameraConfig
from hal.envelope import SPORT, Envelope, stored
from hal.errors import OperatorError
from hal.lidar.config import LidarConfig
from hal.mujoco.config import SimConfig
from hal.named import PATTERN
from hal.robots import DEFAULT, Robot, RobotError, describe
from hal.safety.gate import GateConfig
from hal.safety.geofence import Fence, Geofence, GeofenceError
from hal.scenes import Scene, load_scene
from hal.types import Capabilities, MountedLidar
from hal.unitree.config import UnitreeConfig
from mapping.elevation.config import ElevationConfig
from mapping.elevation.holes import Crossing
from mapping.grid import FARTHEST_PLACE
from mapping.odometry.own import OwnPart, too_far
from mapping.odometry.pipeline import OdometryConfig
from planning.graph.graph import GraphParams
from planning.risk.body import BodyModel
from planning.tracking.tracker import TrackerConfig
from rbtrg_robot import __version__, yaml_file
from rbtrg_robot.provenance import commit, package_version
from rbtrg_robot.run_folder import bus_socket
from rbtrg_robot.scope import ROBOT, Scope
from rbtrg_robot.stage_config import (
    CommsConfig,
    ConsoleConfig,
    ElevationStageConfig,
    FreshnessConfig,
    GraphConfig,
    GuardConfig,
    HomeConfig,
    LoopsConfig,
    NavigatorConfig,
    PlannerConfig,
    RecorderConfig,
)
from rbtrg_robot.yaml_file import YamlError

GUARD = "guard"
"""The process that a real robot is not driven without."""
CAMERAS = ("sim", "unitree")
"""Backends whose robot has a camera that we know."""


class ConfigError(OperatorError):
    """A configuration file or key is wrong; the message names it."""


def _checked(area: list[tuple[float, float]]) -> None:
    """Raises ValueError for what is no polygon in `map`."""
    try:
        Geofence.of(area)
    except GeofenceError as error:
        raise ValueError(str(error)) from error
    if not max(abs(v) for corner in area for v in corner) < FARTHEST_PLACE:
        raise ValueError(f"`map` reaches {FARTHEST_PLACE / 1000:.0f} km")


class NetworkConfig(BaseModel):
    """Who else than this computer reaches the stack."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    listen: tuple[Annotated[str, Field(pattern=r"^tls/(\[[0-9a-fA-F:]+\]|[^:/\s]+):\d{1,5}$")], ...] = Field(
        (), description="tls/ADDRESS:PORT where people with certificates connect; empty = loopback only"
    )
    join: bool = Field(
        False,
        description="use the router that listens on `port` already, a zenohd or that of another robot's "
        "stack, instead of bringing one",
    )
    open_bus: bool = Field(
        False,
        description="with a real robot: every user of this computer, ROS tools and stacks that join have all "
        "rights on `port`, as in simulation; else they look and stop",
    )
    keys: str = Field(
        "", description="folder of the robot's certificate; empty = `robot` where `keys init` puts it"
    )

    @model_validator(mode="after")
    def _who_joins_serves_nobody(self) -> NetworkConfig:
        if self.join and self.listen:
            raise ValueError("`listen` belongs to the stack that brings the router: not with `join`")
        return self


class StackConfig(BaseModel):
    """Everything that can be set. Units stand in the descriptions."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    robot: str = Field(
        ROBOT,
        pattern=r"^[A-Za-z][A-Za-z0-9_-]*$",
        description="name of this robot; another than the default is the ROS namespace of its topics",
    )
    robot_model: str = Field(
        DEFAULT, description="what the robot is: a name of `robot list`, or a folder that holds robot.yaml"
    )
    backend: str = Field(
        "sim",
        pattern=PATTERN,
        description="sim, unitree, or one of your own: an entry point `rbtrg.backends` or package.module:function",
    )
    port: int = Field(7447, ge=1024, le=65535, description="TCP port of the Zenoh router, loopback only")
    domain: int = Field(0, ge=0, le=232, description="ROS domain")
    network: NetworkConfig = NetworkConfig()
    scene: str = Field("yard", description="built-in scene or terrain file (sim)")
    scene_options: dict[str, Any] = Field({}, description="import options of a scene file")
    controller: str = Field(
        "hybrid",
        description="of those in the robot's description: `robot show`; its first one is the default",
    )
    policy_dir: str = Field(
        "",
        description="of a controller that learnt: a folder in rl_sar's layout, a file of `tools.train` or "
        "the name of a fetched one; "
        "empty: the robot's own",
    )
    lidars: tuple[LidarConfig, ...] = Field(
        default_factory=lambda: describe().lidars,
        min_length=1,
        description="what the robot carries; the main one is needed",
    )
    own_parts: tuple[OwnPart, ...] = Field(
        (),
        description="boxes in base_link that belong to the robot beside its body: returns there do not count",
    )
    camera: CameraConfig = CameraConfig()
    seed: int = Field(0, ge=0, description="seed of everything random in the simulation and the graph")
    sim: SimConfig = SimConfig(lidar_step=2)
    interface: str = Field("", description="network interface of the robot (unitree)")
    dry_run: bool = Field(False, description="log requests to the robot and send nothing (unitree)")
    unitree: UnitreeConfig = UnitreeConfig()
    viewer: bool = Field(False, description="show the simulated robot in a window; needs a display (sim)")
    origin: tuple[float, float, float] | None = Field(
        None, description="x, y [m], yaw [rad] of the robot in `map` at start; None = the scene's start"
    )
    area: list[tuple[float, float]] | None = Field(
        None, description="polygon x, y [m] in `map`: goals outside are refused, the robot stops at its edge"
    )
    keepout: dict[str, list[tuple[float, float]]] = Field(
        {}, description="polygons by their names, as `area`: the robot keeps out of each"
    )
    without: tuple[str, ...] = Field((), description="processes not to start")
    record: bool = Field(True, description="write the MCAP log of the run")
    log_dir: str = Field("logs", description="folder of this run's log and process output")
    map_file: str = Field("", description="prior map (.npz, .pcd, .ply)")

    gate: GateConfig = GateConfig()
    odometry: OdometryConfig = OdometryConfig()
    elevation: ElevationConfig = ElevationConfig()
    elevation_stage: ElevationStageConfig = ElevationStageConfig()
    loops: LoopsConfig = LoopsConfig()
    graph: GraphConfig = GraphConfig()
    body: BodyModel = BodyModel()
    planner: PlannerConfig = PlannerConfig()
    navigator: NavigatorConfig = NavigatorConfig()
    tracker: TrackerConfig = TrackerConfig(max_speed=0.5)
    freshness: FreshnessConfig = FreshnessConfig()
    guard: GuardConfig = GuardConfig()
    recorder: RecorderConfig = RecorderConfig()
    console: ConsoleConfig = ConsoleConfig()
    comms: CommsConfig = CommsConfig()
    home: HomeConfig = HomeConfig()

    @model_validator(mode="before")
    @classmethod
    def _of_its_robot(cls, values: Any) -> Any:
        """Under what is given lie the facts of the robot: what it carries, how large it is, where its IMU sits."""
        if not isinstance(values, dict):
            return values
        try:
            robot = describe(values.get("robot_model", DEFAULT))
        except RobotError as error:
            raise ValueError(str(error)) from error
        facts = _facts(robot)
        _merge(facts, values)
        return facts

    @field_validator("unitree")
    @classmethod
    def _lidars_stand_in_one_place(cls, unitree: UnitreeConfig) -> UnitreeConfig:
        if "lidars" in unitree.model_fields_set:
            raise ValueError("set `lidars`, not `unitree.lidars`")
        return unitree

    @field_validator("lidars")
    @classmethod
    def _one_of_each(cls, value: tuple[LidarConfig, ...]) -> tuple[LidarConfig, ...]:
        names = [lidar.name for lidar in value]
        if "main" not in names or len(set(names)) < len(names):
            raise ValueError("one LiDAR is `main`, another may be `head`, no name comes twice")
        return value

    @field_validator("origin")
    @classmethod
    def _near_enough(cls, origin: tuple[float, float, float] | None) -> tuple[float, float, float] | None:
        if origin is not None and not max(map(abs, origin)) < 0.5 * FARTHEST_PLACE:
            raise ValueError(
                f"`map` reaches {FARTHEST_PLACE / 1000:.0f} km: subtract the coordinates of a place nearby"
            )
        return origin

    @field_validator("area")
    @classmethod
    def _spans_an_area(cls, area: list[tuple[float, float]] | None) -> list[tuple[float, float]] | None:
        if area is not None:
            _checked(area)
        return area

    @field_validator("keepout")
    @classmethod
    def _span_areas(
        cls, keepout: dict[str, list[tuple[float, float]]]
    ) -> dict[str, list[tuple[float, float]]]:
        for area in keepout.values():
            _checked(area)
        return keepout

    @model_validator(mode="after")
    def _no_smaller_than_it_is(self) -> StackConfig:
        own, body = self.facts.body, self.body
        if (
            not own.length <= body.length <= own.length + 0.8
            or not own.width <= body.width <= own.width + 0.57
        ):
            raise ValueError(
                f"body: the robot is {own.length} m long and {own.width} m wide: larger, up to "
                f"{own.length + 0.8:.1f} and "
                f"{own.width + 0.57:.1f} m, where it carries something"
            )
        if wrong := too_far(self.own_parts, own.length, own.width):
            raise ValueError(f"own_parts: {wrong}")
        if self.gate.fence_margin < own.length / 2:
            raise ValueError(f"gate.fence_margin: the body reaches {own.length / 2} m ahead of base_link")
        return self

    @model_validator(mode="after")
    def _of_the_robot(self) -> StackConfig:
        robot = self.facts
        # Entry points are looked for last: it reads a file of each package that is installed.
        known = ":" in self.backend or self.backend in robot.backends
        if not known and self.backend not in entry_points(group="rbtrg.backends").names:
            raise ValueError(
                f"backend: {robot.title} is driven by {', '.join(robot.backends)}, not by {self.backend}"
            )
        if self.controller not in robot.own:
            raise ValueError(f"controller: {robot.title} has {', '.join(robot.own)}, not {self.controller!r}")
        return self

    @model_validator(mode="after")
    def _safe_on_hardware(self) -> StackConfig:
        if not self.simulated and GUARD in self.without:
            raise ValueError("`without` cannot hold guard: nothing else sees what the real robot runs into")
        fastest, most = self.guard.fastest(), self.capabilities().max_vx
        if most > fastest + 1e-6:
            raise ValueError(
                f"`guard.reaction` and `guard.deceleration` stop a robot of {fastest:.2f} m/s before what "
                "the guard sees, and this one drives "
                f"{most:.2f} m/s"
            )
        return self

    @property
    def facts(self) -> Robot:
        """What the robot is."""
        return describe(self.robot_model)

    @property
    def simulated(self) -> bool:
        """Source clock is the simulator's."""
        return self.backend == "sim"

    @property
    def absent(self) -> tuple[str, ...]:
        """Processes that are not started."""
        unused = {"recorder": not self.record, "loops": not self.loops.online}
        return (*self.without, *(name for name, none in unused.items() if none and name not in self.without))

    @property
    def scope(self) -> Scope:
        """Where its topics lie on the network."""
        return Scope.of(self.domain, self.robot)

    @property
    def closed(self) -> bool:
        """The bus moves a real robot: other users of this computer look and stop."""
        return self.backend != "sim" and not (self.network.open_bus or self.network.join)

    @property
    def public(self) -> str:
        """Where every user of this computer comes in."""
        return f"tcp/127.0.0.1:{self.port}"

    @property
    def endpoint(self) -> str:
        """Where the stack's processes and its user's commands come in. Raises UnsafeFolder."""
        return f"unixsock-stream/{bus_socket(self.robot)}" if self.closed else self.public

    def load_scene(self) -> Scene:
        """The simulated terrain. Raises SceneError."""
        return load_scene(self.scene, **self.scene_options)

    def start_pose(self) -> tuple[float, float, float]:
        """x, y [m], yaw [rad] of the robot in `map` at start."""
        if self.origin is not None:
            return self.origin
        return self.load_scene().start if self.simulated else (0.0, 0.0, 0.0)

    def allowed_area(self) -> tuple[tuple[float, float], ...] | None:
        """Polygon in `map` that goals and robot must stay in."""
        if self.area is not None:
            return tuple(self.area)
        return self.load_scene().allowed_area if self.simulated else None

    def fence(self) -> Fence:
        """What goals and robot must stay in, and keep out of. Raises SceneError."""
        return Fence.of(self.allowed_area(), self.keepout)

    def mounted_lidars(self) -> tuple[MountedLidar, ...]:
        """The LiDARs in base_link."""
        return (
            self.unitree_options().mounted()
            if self.backend == "unitree"
            else tuple(lidar.mounted() for lidar in self.facts.mounted(self.lidars))
        )

    def unitree_options(self) -> UnitreeConfig:
        """Settings of the real robot with the LiDARs it carries."""
        return self.unitree.model_copy(update={"lidars": self.lidars, "robot_model": self.robot_model})

    def capabilities(self) -> Capabilities:
        """What the robot can do with its controller."""
        return (
            self.unitree_options().capabilities(self.controller)
            if self.backend == "unitree"
            else self.facts.capabilities(self.controller)
        )

    def envelope(self) -> Envelope:
        """What its controller was measured to do. Raises EnvelopeError."""
        return stored(self._measured)

    def graph_params(self) -> GraphParams:
        """Settings of the graph; its limits are the robot's own, or tighter. Where a LiDAR in the head sees the ground
        at the feet, none around the start is taken for granted.
        """
        limbs = self.facts.limbs
        wheels = {"axle": self.facts.body.axle, "tread": limbs.tread, "tread_width": limbs.tread_width}
        wheels["radius"] = limbs.radius
        head = {"blind_radius": 0.0} if any(lidar.name == "head" for lidar in self.lidars) else {}
        params = self.graph.params(self.capabilities(), self._measured)
        return params.model_copy(update=wheels | head)

    @property
    def _measured(self) -> str:
        """Whose envelope counts, as `hal.envelope.stored` calls it."""
        service = self.backend == "unitree" and self.unitree.level != "low"
        controller = SPORT if service else self.controller
        return controller if self.robot_model == DEFAULT else f"{self.robot_model}/{controller}"

    def crossing(self) -> Crossing:
        """Which holes the robot crosses."""
        params = self.graph_params()
        return Crossing(params.max_gap, params.climbed)

    def tracker_config(self) -> TrackerConfig:
        """Settings of the tracker, which asks for no motion so slow that the robot does not follow."""
        robot = self.capabilities()
        limits = {
            "min_speed": max(self.tracker.min_speed, robot.min_vx),
            "step_speed": min(max(self.tracker.step_speed, robot.step_vx), self.tracker.max_speed),
            "min_yaw_rate": max(self.tracker.min_yaw_rate, robot.min_wz),
        }
        return self.tracker.model_copy(update=limits)

    def to_yaml(self) -> str:
        """As `--config` reads it."""
        text: str = yaml.safe_dump(self.model_dump(mode="json"), sort_keys=False)
        return text

    def metadata(self) -> dict[str, str]:
        """What a log says of the run that made it."""
        packages = ("eclipse-zenoh", "numpy", "numba", "mujoco", "kiss-icp", "cyclonedds", "mcap")
        return {
            "version": __version__,
            "commit": commit(),
            "robot": self.robot,
            "robot_model": self.facts.title,
            "backend": self.backend,
            "scene": self.scene if self.simulated else "",
            "controller": self.controller if self.backend != "unitree" or self.unitree.level == "low" else "",
            "lidars": ", ".join(f"{lidar.name} {lidar.model}" for lidar in self.lidars),
            "seed": str(self.seed),
            "clock": "simulated" if self.simulated else "wall",
            "machine": f"{platform.machine()} {platform.system()} Python {platform.python_version()}",
            **{f"package.{name}": package_version(name) for name in packages},
        }


def load(
    file: Path | None = None, sets: Iterable[str] = (), *, base: dict[str, Any] | None = None, **flags: Any
) -> StackConfig:
    """Merge the layers: `base`, then `file`, `sets`, `flags` (those that are None do not count). Raises ConfigError."""
    given: dict[str, Any] = {}
    _merge(given, base or {})
    if file is not None:
        try:
            loaded = yaml_file.read(file)
        except OSError as error:
            raise ConfigError(f"cannot read {file}: {error.strerror}") from error
        except YamlError as error:
            raise ConfigError(f"{file} is not YAML: {error}") from error
        if not isinstance(loaded, dict | None):
            raise ConfigError(f"{file} must hold `key: value` lines")
        _merge(given, loaded or {})
    for item in sets:
        key, sign, text = item.partition("=")
        if not sign or not key:
            raise ConfigError(f"--set wants a.b=c, got {item!r}")
        try:
            _assign(given, key.split("."), yaml_file.parse(text))
        except YamlError as error:
            raise ConfigError(f"--set {key}: {text!r} is no value") from error
    given |= {key: value for key, value in flags.items() if value is not None}
    try:
        # Whole, or one key of a group would drop the others' defaults.
        values = StackConfig(robot_model=given.get("robot_model", DEFAULT)).model_dump(mode="json")
        if given.get("backend", "sim") not in CAMERAS:
            values["camera"]["source"] = "off"
        _merge(values, given)
        return StackConfig.model_validate(values)
    except ValidationError as error:
        raise ConfigError(explain(error)) from error


def of_log(attached: bytes) -> tuple[dict[str, Any], list[str]]:
    """The configuration a log was made with, and its keys that this version does not have, left out of it. Raises
    ConfigError."""
    try:
        values: dict[str, Any] = yaml_file.parse(attached) or {}
    except YamlError as error:
        raise ConfigError(f"the configuration in the log is not YAML: {error}") from error
    if not isinstance(values, dict):
        raise ConfigError("the configuration in the log holds no `key: value` lines")
    if "lidar" in values:  # before a robot carried several
        main = {"model": values.pop("lidar"), "mount": values.pop("mount", None)}
        values["lidars"] = [main]
    unknown: list[str] = []
    try:
        StackConfig.model_validate(values)
    except ValidationError as error:
        for wrong in error.errors():
            if wrong["type"] == "extra_forbidden":
                *path, key = wrong["loc"]
                group: Any = values
                for part in path:
                    group = group[part]
                del group[key]
                unknown.append(".".join(str(part) for part in wrong["loc"]))
    return values, unknown


def _facts(robot: Robot) -> dict[str, Any]:
    """Of the configuration, what is a fact of the robot."""
    body = robot.body
    values: dict[str, Any] = {
        "controller": robot.usual,
        "lidars": robot.lidars,
        "body": {"length": body.length, "width": body.width},
        "graph": {"length": body.length, "width": body.width},
        "gate": {"fence_margin": 0.5 * math.hypot(body.length, body.width)},
        "odometry": {"inertial": {"imu_position": robot.imu.translation, "limbs": robot.limbs}},
        "elevation": {"body_size": (body.length, body.width)},
    }
    _merge(values, deepcopy(robot.settings))
    return values


def _merge(values: dict[str, Any], over: dict[str, Any]) -> None:
    """Lay `over` over `values`, key by key in groups; of a model what was set in it."""
    for key, value in over.items():
        if isinstance(value, BaseModel) and isinstance(values.get(key), dict):
            value = {name: getattr(value, name) for name in value.model_fields_set}
        if isinstance(value, dict) and isinstance(values.get(key), dict):
            _merge(values[key], value)
        else:
            values[key] = value


def _assign(values: dict[str, Any], path: list[str], value: Any) -> None:
    for key in path[:-1]:
        if values.get(key) is None:
            values[key] = {}
        values = values[key]
        if not isinstance(values, dict):
            raise ConfigError(f"--set {'.'.join(path)}: {key} is no group of keys")
    values[path[-1]] = value


def explain(error: ValidationError) -> str:
    """One line: which key, what is wrong."""
    first = error.errors()[0]
    key = ".".join(str(part) for part in first["loc"])
    if not key:  # of the configuration as a whole: the message names the key
        return first["msg"].removeprefix("Value error, ")
    more = f" (and {error.error_count() - 1} more)" if error.error_count() > 1 else ""
    if key.startswith("network.listen."):
        return (
            f"configuration key 'network.listen': {first['input']!r} is not tls/ADDRESS:PORT; nothing "
            f"else is served{more}"
        )
    if first["type"] == "extra_forbidden":
        return f"there is no configuration key {key!r}; `rbtrg-robot config show` lists them{more}"
    return f"configuration key {key!r}: {first['msg']}, got {first['input']!r}{more}"
