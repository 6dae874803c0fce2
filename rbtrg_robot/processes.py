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
    """`module:function`; `function(config) -> Stage`, or for a process of its own kind `function(config, bus)`."""
    period: float
    """Seconds of the source clock between two ticks."""
    cpu: float
    """Budget: percent of one core."""
    memory: int
    """Budget [MB] of resident memory."""
    loss: str
    """What losing this process means for motion."""
    stops_motion: bool = False
    """The robot process stops the robot when this one's liveliness token goes."""
    restores: tuple[Topic, ...] = ()
    """Newest messages of these topics are handed to a restarted process before anything else."""
    hang: float = 3.0
    """A process that has not beaten for this long [s] hangs and is killed. Longer where one step on a large map takes long."""
    farewell: float = 1.6
    """[s] it has to end when told to, before it is killed."""
    hosted: bool = True
    """False: brings its own main loop instead of a stage."""


PROCESSES: tuple[Process, ...] = (
    Process(
        "robot",
        "rbtrg_robot.hosts.robot:main",
        0.005,
        cpu=90,
        memory=700,
        loss="no robot: nothing moves; hardware stops by its own watchdog",
        restores=(t.ROBOT_STATE, t.TRUTH),
        farewell=3.5,  # a real robot stops and lies down
        hosted=False,
    ),
    Process(
        "odometry",
        "rbtrg_robot.stages.odometry:build",
        0.1,
        cpu=50,
        memory=500,
        loss="no pose: robot stops at once",
        stops_motion=True,
        restores=(t.ODOM, t.CLOUD),
    ),
    Process(
        "elevation",
        "rbtrg_robot.stages.elevation:build",
        0.1,
        cpu=30,
        memory=500,
        loss="blind: robot stops at once",
        stops_motion=True,
        restores=(t.MAP_STATUS,),
        hang=15.0,
    ),
    Process(
        "planner",
        "rbtrg_robot.stages.planner:build",
        0.1,
        cpu=60,
        memory=700,
        loss="no new routes, the present one is not watched: the navigator halts after 2 s",
        hang=30.0,
    ),
    Process(
        "navigator",
        "rbtrg_robot.stages.navigation.navigator:build",
        0.1,
        cpu=10,
        memory=250,
        loss="nobody owns the goal: robot stops at once",
        stops_motion=True,
        restores=(t.GOAL_STATUS,),
    ),
    Process(
        "tracker",
        "rbtrg_robot.stages.tracker:build",
        0.02,
        cpu=20,
        memory=250,
        loss="no commands: robot stops at once",
        stops_motion=True,
    ),
    Process(
        "recorder",
        "rbtrg_robot.log.recorder:main",
        1.0,
        cpu=30,
        memory=300,
        loss="none; up to 1 s of log is lost",
        hosted=False,
    ),
)
BY_NAME = {p.name: p for p in PROCESSES}
