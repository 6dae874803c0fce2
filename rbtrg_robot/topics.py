"""Every topic, one row each: name, type, nominal rate, QoS, inbox depth, recorded or not.

Publishers, subscribers, recorder, health monitor, `topic list` and the docs read this table; nothing else spells a
topic name. Frames and units are those of the message definitions; `map` and `odom` are metres, z up (REP 105).
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from fnmatch import fnmatch


class Qos(StrEnum):
    """How a topic travels. Nothing blocks a publisher: a slow consumer loses old messages, never delays new ones."""

    SENSOR = "sensor"
    """Best effort."""
    STATE = "state"
    """Reliable, volatile."""
    LATCHED = "latched"
    """Reliable, and a late joiner gets the newest message."""
    COMMAND = "command"
    """Real-time priority, sent at once."""


@dataclass(frozen=True, slots=True)
class Topic:
    """One row. `rate` is nominal [Hz of the source clock], 0 = on event."""

    name: str
    type: str
    rate: float
    qos: Qos
    owner: str
    """The process that publishes it; empty where operators or several processes do."""
    doc: str
    depth: int = 1
    """How many undelivered messages a consumer keeps; the oldest go first. 1 = latest wins."""
    recorded: bool = True
    safe_to_replay: bool = True
    """False for what makes a robot move: replay never publishes it."""

    def __repr__(self) -> str:
        return self.name


CLOCK = Topic(
    "/clock", "rosgraph_msgs/msg/Clock", 100, Qos.SENSOR, "robot", "simulated time; absent on hardware"
)
IMU = Topic(
    "/imu/data",
    "sensor_msgs/msg/Imu",
    200,
    Qos.SENSOR,
    "robot",
    "gyro [rad/s] and specific force, base_link axes",
    400,
)
JOINTS = Topic(
    "/joint_states", "sensor_msgs/msg/JointState", 50, Qos.SENSOR, "robot", "16 motors in SDK order", 100
)
POINTS = Topic(
    "/lidar/points",
    "sensor_msgs/msg/PointCloud2",
    10,
    Qos.SENSOR,
    "robot",
    "one sweep, frame lidar, per-point time",
    4,
)
ROBOT_STATE = Topic(
    "/robot/state", "rbtrg_msgs/msg/RobotState", 10, Qos.LATCHED, "robot", "phase, e-stop, gate, battery"
)
ROBOT_COMMAND = Topic(
    "/robot/command",
    "rbtrg_msgs/msg/RobotCommand",
    0,
    Qos.COMMAND,
    "",
    "stand, sit, stop, resume",
    8,
    safe_to_replay=False,
)
CMD_VEL = Topic(
    "/cmd_vel",
    "geometry_msgs/msg/TwistStamped",
    50,
    Qos.COMMAND,
    "tracker",
    "body velocity, base_link",
    safe_to_replay=False,
)
TRUTH = Topic(
    "/ground_truth/odom",
    "nav_msgs/msg/Odometry",
    50,
    Qos.SENSOR,
    "robot",
    "simulator's truth, for evaluation only",
)
ODOM = Topic(
    "/odom",
    "nav_msgs/msg/Odometry",
    10,
    Qos.STATE,
    "odometry",
    "odom <- base_link at the end of each scan",
    20,
)
POSE = Topic(
    "/odom/fast",
    "nav_msgs/msg/Odometry",
    200,
    Qos.SENSOR,
    "odometry",
    "IMU-propagated odom <- base_link, for control",
)
WHEEL_ODOM = Topic(
    "/odom/wheel", "nav_msgs/msg/Odometry", 50, Qos.SENSOR, "odometry", "wheel and leg odometry alone"
)
ODOM_HEALTH = Topic(
    "/odom/health",
    "rbtrg_msgs/msg/OdometryHealth",
    10,
    Qos.STATE,
    "odometry",
    "good, degraded, lost, and why",
)
CLOUD = Topic(
    "/cloud",
    "sensor_msgs/msg/PointCloud2",
    10,
    Qos.SENSOR,
    "odometry",
    "sweep deskewed to its end, base_link",
    4,
)
TF = Topic("/tf", "tf2_msgs/msg/TFMessage", 50, Qos.STATE, "odometry", "map <- odom <- base_link", 50)
TF_STATIC = Topic(
    "/tf_static", "tf2_msgs/msg/TFMessage", 0, Qos.LATCHED, "odometry", "base_link <- lidar, imu"
)
MAP_UPDATE = Topic(
    "/elevation_map/update",
    "grid_map_msgs/msg/GridMap",
    0,
    Qos.STATE,
    "elevation",
    "changed blocks of the elevation map",
    512,
)
MAP_WINDOW = Topic(
    "/elevation_map/window",
    "grid_map_msgs/msg/GridMap",
    10,
    Qos.SENSOR,
    "elevation",
    "elevation map around the robot, after every scan",
)
MAP_FULL = Topic(
    "/elevation_map",
    "grid_map_msgs/msg/GridMap",
    0,
    Qos.STATE,
    "elevation",
    "whole elevation map, on request",
    2,
    recorded=False,
)
MAP_MIRROR = Topic(
    "/elevation_map/mirror",
    "grid_map_msgs/msg/GridMap",
    0,
    Qos.STATE,
    "planner",
    "the planner's copy of the map, for an elevation process that was started again",
    2,
    recorded=False,
)
MAP_REQUEST = Topic(
    "/elevation_map/request", "rbtrg_msgs/msg/MapRequest", 0, Qos.STATE, "", "full or save", 4
)
MAP_STATUS = Topic(
    "/elevation_map/status", "rbtrg_msgs/msg/MapStatus", 2, Qos.STATE, "elevation", "size and age of the map"
)
GOAL_REQUEST = Topic(
    "/goal/request",
    "rbtrg_msgs/msg/GoalRequest",
    0,
    Qos.STATE,
    "",
    "a goal or its cancellation",
    8,
    safe_to_replay=False,
)
GOAL_POSE = Topic(
    "/goal_pose",
    "geometry_msgs/msg/PoseStamped",
    0,
    Qos.STATE,
    "",
    "a goal from RViz",
    4,
    safe_to_replay=False,
)
GOAL_STATUS = Topic(
    "/goal/status",
    "rbtrg_msgs/msg/GoalStatus",
    2,
    Qos.LATCHED,
    "navigator",
    "lifecycle of the newest goal",
    16,
)
PLAN_REQUEST = Topic(
    "/plan/request", "rbtrg_msgs/msg/PlanRequest", 0, Qos.STATE, "navigator", "navigator asks for a route", 4
)
PLAN = Topic("/plan", "rbtrg_msgs/msg/Plan", 0, Qos.STATE, "planner", "route, path and their risks", 4)
ROUTE = Topic("/plan/path", "nav_msgs/msg/Path", 0, Qos.LATCHED, "planner", "the path, for RViz and Foxglove")
ROUTE_STATUS = Topic(
    "/plan/status", "rbtrg_msgs/msg/RouteStatus", 2, Qos.STATE, "planner", "route still good? graph size"
)
PATH_COMMAND = Topic(
    "/track/path",
    "rbtrg_msgs/msg/PathCommand",
    0,
    Qos.STATE,
    "navigator",
    "path to drive; empty = stand",
    4,
    safe_to_replay=False,
)
TRACKER_STATE = Topic(
    "/track/state",
    "rbtrg_msgs/msg/TrackerState",
    10,
    Qos.STATE,
    "tracker",
    "what the tracker does, or why not",
)
HEARTBEAT = Topic("/heartbeat", "rbtrg_msgs/msg/Heartbeat", 2, Qos.STATE, "", "each process, wall clock", 64)

TOPICS: tuple[Topic, ...] = tuple(v for v in dict(globals()).values() if isinstance(v, Topic))
BY_NAME = {t.name: t for t in TOPICS}


def matching(patterns: list[str]) -> list[Topic]:
    """Topics whose name fits any of the globs, in table order."""
    return [t for t in TOPICS if any(fnmatch(t.name, p) for p in patterns)]
