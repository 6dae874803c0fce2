"""Every topic, one row each: name, type, nominal rate, QoS, inbox depth, publishing process, contents, exceptions.

Publishers, subscribers, recorder, health monitor, `topic list` and the docs read this table; nothing else spells a
topic name. Frames and units are those of the message definitions; `map` and `odom` are metres, z up (REP 105).
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from fnmatch import fnmatch
from typing import Generic, TypeGuard, TypeVar

from hal.types import LidarName
from rbtrg_robot import msg


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


class Role(StrEnum):
    """Who comes from another computer with a certificate."""

    OBSERVER = "observer"
    """Sees everything and may stop the robot."""
    OPERATOR = "operator"
    """May do what an observer may, and command the robot."""


STACK = "the stack"
"""Owner of what each of its processes publishes."""

M = TypeVar("M", bound=msg.Message)


@dataclass(frozen=True, slots=True, eq=False)
class Topic(Generic[M]):
    """One row."""

    name: str
    kind: type[M]
    """Class of its messages."""
    rate: float
    """Nominal, Hz of the source clock; 0 = on event."""
    qos: Qos
    depth: int
    """How many undelivered messages a consumer keeps; the oldest go first. 1 = latest wins."""
    owner: str
    """The process that publishes it; STACK: each does; empty where operators do."""
    doc: str
    recorded: str = "full standard lean"
    """Profiles of the recorder (`recorder.profile`) that write it; empty: none does."""
    safe_to_replay: bool = True
    """False for what makes a robot move: replay never publishes it."""
    publish_by: Role | None = None
    """Who from outside may publish it, and whoever is above; None: only processes on the robot's computer."""
    thinned: bool = False
    """The recorder leaves most out, and adds those of before a stop or a refusal late: gaps and an odd order in a log
    are no loss."""
    shared: bool = False
    """ROS tools publish it as well, such as robot_state_publisher or drivers: what they say is left out without a word.
    """

    @property
    def type(self) -> str:
        """`package/msg/Name` of its messages."""
        return self.kind.__msgtype__

    @property
    def alone(self) -> bool:
        """One process publishes it: its messages are numbered without gaps, and their stamps do not go back."""
        return self.owner not in ("", STACK)

    def carried(self, message: object, topic: Topic) -> TypeGuard[M]:
        """Whether `message`, which came on `topic`, came on this one; mypy knows its type then."""
        return topic is self

    def __repr__(self) -> str:
        return self.name


# fmt: off
#                      name                      message             rate qos          depth owner       what it carries
CLOCK          = Topic("/clock",                 msg.Clock,          100, Qos.SENSOR,    1, "robot",     "simulated time; absent on hardware")
IMU            = Topic("/imu/data",              msg.Imu,            200, Qos.SENSOR,  400, "robot",     "gyro [rad/s] and specific force, base_link axes")
JOINTS         = Topic("/joint_states",          msg.JointState,      50, Qos.SENSOR,  100, "robot",     "16 motors in SDK order")
POINTS         = Topic("/lidar/main/points",     msg.PointCloud2,     10, Qos.SENSOR,    4, "robot",     "one sweep, frame lidar_main, per-point time", recorded="full standard")
HEAD_POINTS    = Topic("/lidar/head/points",     msg.PointCloud2,     10, Qos.SENSOR,    4, "robot",     "the same of the LiDAR in the head, where there is one", recorded="full standard")
WHEELS         = Topic("/wheels/odom",           msg.Odometry,          0, Qos.SENSOR,  100, "",          "speed that the wheels of another robot tell, base_link: in imported logs", recorded="full standard")
CAMERA         = Topic("/camera/front/image/compressed", msg.CompressedImage, 0, Qos.SENSOR, 1, "camera", "JPEG, frame camera_front, stamped at the exposure; while somebody looks, and once a second while it is recorded", recorded="full standard", thinned=True)
CAMERA_INFO    = Topic("/camera/front/camera_info", msg.CameraInfo,    0, Qos.LATCHED,   1, "camera",    "its intrinsics", recorded="full standard")
CAMERA_REQUEST = Topic("/camera/request",        msg.String,           0, Qos.STATE,     1, "",          "somebody looks: frames for the next 2 s", recorded="")
PHOTO          = Topic("/camera/front/photo",    msg.CompressedImage,  0, Qos.STATE,     4, "camera",    "a frame that a mission or a person wanted kept")
PHOTO_REQUEST  = Topic("/camera/front/photo/request", msg.String,      0, Qos.STATE,     2, "",          "the next frame is kept as a photo", publish_by=Role.OPERATOR)
ROBOT_STATE    = Topic("/robot/state",           msg.RobotState,      10, Qos.LATCHED,   1, "robot",     "phase, e-stop, gate, battery")
TOUCHED        = Topic("/robot/touched",         msg.PoseStamped,      0, Qos.STATE,     8, "robot",     "what the robot touched and the map does not explain: its place in `map`, along the motion, at the height of base_link")
ROBOT_COMMAND  = Topic("/robot/command",         msg.RobotCommand,     0, Qos.COMMAND,   8, "",          "stand, sit, stop, resume", safe_to_replay=False, publish_by=Role.OPERATOR)
ROBOT_STOP     = Topic("/robot/stop",            msg.RobotCommand,     0, Qos.COMMAND,   8, "",          "the emergency stop, whatever mode it names; everybody may", safe_to_replay=False, publish_by=Role.OBSERVER)
TELEOP         = Topic("/teleop/cmd_vel",        msg.TwistStamped,     0, Qos.COMMAND,   1, "",          "body velocity by hand; takes the motion from the stack until `resume`", safe_to_replay=False, publish_by=Role.OPERATOR)
TELEOP_TRUNK   = Topic("/teleop/trunk",         msg.TrunkCommand,     0, Qos.COMMAND,   1, "",          "tilt of the trunk by hand while the robot stands; takes the motion as well", safe_to_replay=False, publish_by=Role.OPERATOR)
CMD_VEL        = Topic("/cmd_vel",               msg.TwistStamped,    50, Qos.COMMAND,   1, "tracker",   "body velocity, base_link", safe_to_replay=False)
TRUNK          = Topic("/cmd_trunk",             msg.TrunkCommand,     0, Qos.COMMAND,   1, "tracker",   "tilt of the trunk while the robot stands: it looks at the ground", safe_to_replay=False)
TRUTH          = Topic("/ground_truth/odom",     msg.Odometry,        50, Qos.SENSOR,    1, "robot",     "simulator's truth, for evaluation only")
ODOM           = Topic("/odom",                  msg.Odometry,        10, Qos.STATE,    20, "odometry",  "odom <- base_link at the end of each scan")
POSE           = Topic("/odom/fast",             msg.Odometry,       200, Qos.SENSOR,    1, "odometry",  "IMU-propagated odom <- base_link, for control", recorded="full")
WHEEL_ODOM     = Topic("/odom/wheel",            msg.Odometry,        50, Qos.SENSOR,    1, "odometry",  "wheel and leg odometry alone", recorded="full lean")
ODOM_HEALTH    = Topic("/odom/health",           msg.OdometryHealth,  10, Qos.STATE,     1, "odometry",  "good, degraded, lost, and why")
CLOUD          = Topic("/cloud/main",            msg.PointCloud2,     10, Qos.SENSOR,    4, "odometry",  "sweep deskewed to the stamp of /odom, base_link", recorded="full")
HEAD_CLOUD     = Topic("/cloud/head",            msg.PointCloud2,     10, Qos.SENSOR,    4, "odometry",  "the same of the LiDAR in the head; empty where none came", recorded="full")
TF             = Topic("/tf",                    msg.TFMessage,       50, Qos.STATE,    50, "odometry",  "map <- odom <- base_link", shared=True)
TF_STATIC      = Topic("/tf_static",             msg.TFMessage,        0, Qos.LATCHED,   1, "odometry",  "base_link <- lidar_main, lidar_head, imu", shared=True)
DESCRIPTION    = Topic("/robot_description",     msg.String,           0, Qos.LATCHED,   1, "odometry",  "the robot's URDF", shared=True)
MAP_UPDATE     = Topic("/elevation_map/update",  msg.GridMap,          0, Qos.STATE,   512, "elevation", "changed blocks of the elevation map", recorded="full lean")
MAP_WINDOW     = Topic("/elevation_map/window",  msg.GridMap,         10, Qos.SENSOR,    1, "elevation", "elevation map around the robot, after every scan", recorded="full")
MAP_COST       = Topic("/elevation_map/cost",    msg.OccupancyGrid,    0, Qos.STATE,     1, "elevation", "slope and step of 20 x 20 m around the robot as a share of what it drives over, 100 at a limit, -1 not trusted; 2 Hz while somebody listens", recorded="")
MAP_FULL       = Topic("/elevation_map",         msg.GridMap,          0, Qos.STATE,     8, "elevation", "whole elevation map, on request; a large one in blocks", recorded="full")
MAP_PARTS      = Topic("/elevation_map/part",    msg.MapPart,          0, Qos.STATE,    64, "elevation", "the same to be saved, or for a planner that lost something: parts that tell how many they are", recorded="")
MAP_CLOUD      = Topic("/elevation_map/cloud",   msg.PointCloud2,      0, Qos.STATE,     2, "elevation", "what the map keeps of walls, one point per 0.25 m, on request, before the whole map", recorded="full")
MAP_MIRROR     = Topic("/elevation_map/mirror",  msg.MapPart,          0, Qos.STATE,    32, "planner",   "the planner's copy of the map, in parts, for a restarted elevation process", recorded="")
MAP_REQUEST    = Topic("/elevation_map/request", msg.MapRequest,       0, Qos.STATE,     4, "",          "full, parts: send the whole map and its cloud; clear: forget what the robot touched", publish_by=Role.OPERATOR)
MAP_PRIOR      = Topic("/elevation_map/prior",   msg.MapPrior,         0, Qos.STATE,     1, "",          "a prior map to begin anew with, while the robot stands", recorded="full standard", safe_to_replay=False, publish_by=Role.OPERATOR)
MAP_CLOSED     = Topic("/elevation_map/closed",  msg.MapPrior,         0, Qos.STATE,     1, "loops",     "the map of this run with its loops closed, and where `odom` lies in it", recorded="full standard", safe_to_replay=False)
MAP_STATUS     = Topic("/elevation_map/status",  msg.MapStatus,        2, Qos.STATE,    64, "elevation", "size and age of the map; a new epoch, before its blocks")
AREAS          = Topic("/areas",                 msg.Areas,            0, Qos.LATCHED,   1, "elevation", "areas that were drawn: where the robot stays inside, and what it keeps out of", safe_to_replay=False)
AREAS_REQUEST  = Topic("/areas/request",         msg.Areas,            0, Qos.STATE,     2, "",          "all areas that are to count from now on, beside those of the configuration", safe_to_replay=False, publish_by=Role.OPERATOR)
GOAL_REQUEST   = Topic("/goal/request",          msg.GoalRequest,      0, Qos.STATE,     8, "",          "a goal or its cancellation", safe_to_replay=False, publish_by=Role.OPERATOR)
GOAL_POSE      = Topic("/goal_pose",             msg.PoseStamped,      0, Qos.STATE,     4, "",          "a goal from RViz", safe_to_replay=False, publish_by=Role.OPERATOR)
INITIAL_POSE   = Topic("/initialpose",           msg.PoseWithCovarianceStamped, 0, Qos.STATE, 1, "",      "where the robot stands in `map`, from RViz, Foxglove or the console; taken while it stands", safe_to_replay=False, publish_by=Role.OPERATOR)
DOCK_POSE      = Topic("/dock/pose",             msg.PoseStamped,      0, Qos.STATE,     4, "",          "where base_link is when the robot is docked, from a reader of fiducials: in map, odom or base_link", safe_to_replay=False, publish_by=Role.OPERATOR)
GOAL_STATUS    = Topic("/goal/status",           msg.GoalStatus,       2, Qos.LATCHED,  16, "navigator", "lifecycle of the newest goal")
MISSION_REQUEST = Topic("/mission/request",      msg.MissionRequest,   0, Qos.STATE,     8, "",          "run, pause, resume, skip, stop a mission; answer its question", safe_to_replay=False, publish_by=Role.OPERATOR)
MISSION_ORDER  = Topic("/mission/order",         msg.MissionOrder,     0, Qos.LATCHED,   1, "mission",   "the newest mission that was accepted", safe_to_replay=False)
MISSION_STATE  = Topic("/mission/state",         msg.MissionState,     1, Qos.LATCHED,   8, "mission",   "how far it is, and why not further")
PRESENCE       = Topic("/operator/presence",     msg.Presence,         0, Qos.STATE,     4, "",          "an operator watches", safe_to_replay=False, publish_by=Role.OPERATOR)
PLAN_REQUEST   = Topic("/plan/request",          msg.PlanRequest,      0, Qos.STATE,     4, "navigator", "navigator asks for a route")
PLAN           = Topic("/plan",                  msg.Plan,             0, Qos.STATE,     4, "planner",   "route, path and their risks")
ROUTE          = Topic("/plan/path",             msg.Path,             0, Qos.LATCHED,   1, "planner",   "the path, for RViz and Foxglove")
ROUTE_STATUS   = Topic("/plan/status",           msg.RouteStatus,      2, Qos.STATE,     1, "planner",   "route still good? graph size")
ROUTE_QUESTION = Topic("/plan/question",         msg.RouteQuestion,    0, Qos.STATE,     2, "",          "how would a route to a place go? nothing moves", publish_by=Role.OPERATOR)
ROUTE_REPORT   = Topic("/plan/report",           msg.RouteReport,      0, Qos.LATCHED,   4, "planner",   "the route that is driven, or the answer to a question, and why", recorded="full standard")
EXPLORE_QUESTION = Topic("/explore/question",    msg.ExploreQuestion,  0, Qos.STATE,     2, "mission",   "from where is to be seen what nobody saw yet? nothing moves")
VIEWPOINTS     = Topic("/explore/viewpoints",    msg.Viewpoints,       0, Qos.STATE,     2, "planner",   "places to look from, in their order, and how much was seen")
PATH_COMMAND   = Topic("/track/path",            msg.PathCommand,      0, Qos.STATE,     4, "navigator", "path to drive; empty = stand", safe_to_replay=False)
TRACKER_STATE  = Topic("/track/state",           msg.TrackerState,    10, Qos.STATE,     1, "tracker",   "what the tracker does, or why not")
MOTION_LIMITS  = Topic("/guard/limits",          msg.MotionLimits,    20, Qos.COMMAND,   1, "guard",     "speeds at which the body still stops before what is in its way", safe_to_replay=False)
EVENTS         = Topic("/events",                msg.Event,            0, Qos.STATE,    64, "supervisor", "what happened: stops, restarts, refusals, touches, goals, maps, and who did it; the supervisor also answers `events` with the newest 200")
HEARTBEAT      = Topic("/heartbeat",             msg.Heartbeat,        2, Qos.STATE,    64, STACK,       "each process, in real time")
JOURNAL        = Topic("/journal",               msg.Journal,          0, Qos.STATE,   512, STACK,       "what each process took from the bus, in order: a re-run does the same", recorded="full standard")
DIAGNOSTICS    = Topic("/diagnostics",           msg.DiagnosticArray,  0, Qos.STATE,     8, STACK,       "1 Hz: from the supervisor what `status` knows, from the robot process its backend's figures", shared=True)
# fmt: on

TOPICS: tuple[Topic, ...] = tuple(v for v in dict(globals()).values() if isinstance(v, Topic))
BY_NAME: dict[str, Topic] = {t.name: t for t in TOPICS}
SWEEPS: dict[LidarName, Topic[msg.PointCloud2]] = {"main": POINTS, "head": HEAD_POINTS}
CLOUDS: dict[LidarName, Topic[msg.PointCloud2]] = {"main": CLOUD, "head": HEAD_CLOUD}
"""Of each LiDAR: as measured, and deskewed."""
BACKEND_FIGURES = "rbtrg: backend"
"""Name of the entry in /diagnostics that comes from the robot process."""
RENAMED = {"/lidar/points": POINTS, "/cloud": CLOUD}
"""Names in logs of robots that carried one LiDAR."""


def matching(patterns: list[str]) -> list[Topic]:
    """Topics whose name fits any of the globs, in table order."""
    return [t for t in TOPICS if any(fnmatch(t.name, p) for p in patterns)]
