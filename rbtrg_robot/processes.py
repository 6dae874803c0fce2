"""Every process, one row each. The supervisor, `status` and tests read this table."""

from __future__ import annotations

from dataclasses import dataclass

from rbtrg_robot import topics as t
from rbtrg_robot.topics import Topic


@dataclass(frozen=True, slots=True)
class Process:
    """One row."""

    name: str
    entry: str
    """`module:build` with `build(config) -> Stage`, or `module:main` with a main loop of its own."""
    period: float
    """Seconds of the source clock between two ticks."""
    hang: float
    """A process that has not beaten for this long [s] hangs and is killed. Longer where one step on a large map takes
    long."""
    farewell: float
    """[s] it has to end when told to, before it is killed. A real robot stops and lies down in this time."""
    stops_motion: bool
    """The robot process stops the robot when this one's liveliness token goes."""
    loss: str
    """What losing this process means for motion."""
    restores: tuple[Topic, ...]
    """Newest messages of these topics are handed to a restarted process before anything else."""

    nice: int = 0
    """How far it stands back for the others, nice(2)."""

    @property
    def hosted(self) -> bool:
        """It is a stage; otherwise it brings its own main loop."""
        return self.entry.endswith(":build")


# fmt: off
PROCESSES: tuple[Process, ...] = (
    # name         entry                                            period  hang  farewell  stops_motion  what its loss
    # means for motion                                                  restores
    Process("robot",     "rbtrg_robot.hosts.robot:main",                  0.005,   3.0,      3.5, False,        "no robot: nothing moves; hardware stops by its own watchdog",                  (t.ROBOT_STATE, t.TRUTH, t.AREAS)),
    Process("odometry",  "rbtrg_robot.stages.odometry:build",             0.1,     3.0,      1.6, True,         "no pose: robot stops at once",                                                 (t.ODOM, t.CLOUD, t.TF_STATIC)),
    Process("elevation", "rbtrg_robot.stages.elevation:build",            0.1,    15.0,      1.6, True,         "blind: robot stops at once",                                                   (t.MAP_STATUS, t.AREAS)),
    Process("planner",   "rbtrg_robot.stages.planner:build",              0.1,    30.0,      1.6, False,        "no new routes, the present one is not watched: the navigator halts after 2 s", ()),
    Process("navigator", "rbtrg_robot.stages.navigation.navigator:build", 0.1,     3.0,      1.6, True,         "nobody owns the goal: robot stops at once",                                    (t.GOAL_STATUS,)),
    Process("mission",   "rbtrg_robot.stages.mission.executor:build",      0.1,     3.0,      1.6, False,        "the robot ends the present goal and stands",                                   (t.MAP_STATUS, t.MISSION_ORDER, t.MISSION_STATE)),
    Process("tracker",   "rbtrg_robot.stages.tracker:build",              0.02,    3.0,      1.6, True,         "no commands: robot stops at once",                                             ()),
    Process("guard",     "rbtrg_robot.stages.guard:build",                0.05,    3.0,      1.6, True,         "nobody watches the body's way: robot stops at once",                           ()),
    Process("loops",     "rbtrg_robot.stages.loops:build",                0.1,    60.0,      1.6, False,        "none; loops wait until it is back",                                             (t.MAP_STATUS,), 19),
    Process("camera",    "rbtrg_robot.hosts.camera:main",                 0.1,    60.0,      1.6, False,        "none; nobody sees a picture",                                                  ()),
    Process("recorder",  "rbtrg_robot.log.recorder:main",                 1.0,     3.0,      1.6, False,        "none; up to 1 s of log is lost",                                               ()),
    Process("console",   "rbtrg_robot.console.server:main",               0.05,    5.0,      1.6, False,        "none; pages see nothing until it is back, and hands let go",                   ()),
)
# fmt: on
BY_NAME = {p.name: p for p in PROCESSES}
SUPERVISOR = "supervisor"
"""The process that starts the others."""
