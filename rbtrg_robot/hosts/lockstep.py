"""Lockstep: the robot and every stage in one process, as fast as the machine goes, bit-reproducible.

Closed-loop benchmarks and most behaviour tests run here. The clock moves in 5 ms steps; all that follows from a
message happens before the next step.
"""

from __future__ import annotations

import uuid
from collections.abc import Callable, Iterator, Mapping
from importlib import import_module
from types import TracebackType
from typing import Any, Self

from hal.types import NS
from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.config import StackConfig
from rbtrg_robot.hosts.robot import build
from rbtrg_robot.hosts.sync import Sink, SyncHost
from rbtrg_robot.log.read import CONFIG
from rbtrg_robot.log.write import LogWriter
from rbtrg_robot.processes import BY_NAME, PROCESSES
from rbtrg_robot.stages.navigation.goal import GoalState, goal_request
from rbtrg_robot.stages.navigation.reasons import unlocated
from rbtrg_robot.stages.robot import STEP_PERIOD
from rbtrg_robot.stages.stage import Stage
from rbtrg_robot.topics import Qos, Topic
from rbtrg_robot.wire.messages import decode, header, stamp_in


class LockstepTimeout(AssertionError):
    """A condition did not come true in time; the message tells the state of the stack."""


def build_stages(config: StackConfig, names: list[str]) -> dict[str, tuple[Stage, float]]:
    """Stages of the table's processes, in table order."""
    stages: dict[str, tuple[Stage, float]] = {}
    for row in PROCESSES:
        if row.name in names and row.hosted:
            module, function = row.entry.split(":")
            stages[row.name] = (getattr(import_module(module), function)(config), row.period)
    return stages


def log_sink(writer: LogWriter, profile: str = "full") -> Sink:
    """Writes every message of a recording profile to a log, on the host's clock."""
    sequence: dict[Topic, int] = {}

    def write(topic: Topic, payload: bytes, now: int) -> None:
        if profile in topic.recorded.split():
            sequence[topic] = sequence.get(topic, 0) + 1
            stamp = stamp_in(payload, topic.type) or now
            writer.write(topic, payload, now, stamp, sequence[topic])

    return write


class Newest(Mapping[Topic, Any]):
    """Newest message of each topic, decoded when somebody asks for it."""

    def __init__(self) -> None:
        self._payloads: dict[Topic, bytes] = {}
        self._messages: dict[Topic, Any] = {}

    def put(self, topic: Topic, payload: bytes) -> None:
        """A newer message came."""
        self._payloads[topic] = payload
        self._messages.pop(topic, None)

    def __getitem__(self, topic: Topic) -> Any:
        if topic not in self._messages:
            self._messages[topic] = decode(self._payloads[topic], topic.kind)
        return self._messages[topic]

    def __iter__(self) -> Iterator[Topic]:
        return iter(self._payloads)

    def __len__(self) -> int:
        return len(self._payloads)


class Lockstep:
    """The whole stack on the simulated robot."""

    def __init__(
        self,
        config: StackConfig,
        log: LogWriter | None = None,
        placed: tuple[float, float, float] | None = None,
    ) -> None:
        """Stages named in `config.absent` are left out. `placed`: x, y [m], yaw [rad] where the simulator puts the
        robot; None: the configured start."""
        names = [p.name for p in PROCESSES if p.hosted and p.name not in config.absent]
        self.robot = build(config if placed is None else config.model_copy(update={"origin": placed}))
        stages: dict[str, tuple[Stage, float]] = {"robot": (self.robot, STEP_PERIOD / NS)}
        stages |= build_stages(config, names)
        self._log = log
        self.config = config
        self._kept: dict[Topic, bytes] = {}
        """Newest messages that a restarted process is handed."""
        self.host = SyncHost(stages, log_sink(log, config.recorder.profile) if log else None)
        self.newest = Newest()
        self.statuses: list[Any] = []
        self.host.listen(self._note, _NOTED | _KEPT)
        self.robot.warm_up()  # the others load a kernel when they need it: nothing waits meanwhile
        for name in names:
            self.robot.alive(name, True)

    def kill(self, name: str) -> None:
        """The process dies; the robot notices as it would live."""
        self.host.kill(name)
        self.robot.alive(name, False)

    def restart(self, name: str) -> None:
        """A killed process comes back, with what the supervisor and the latched topics hand to it."""
        stage, _ = build_stages(self.config, [name])[name]
        latched = [topic for topic in stage.inputs if topic.qos is Qos.LATCHED]
        handed = dict.fromkeys([*BY_NAME[name].restores, *latched])
        kept = {topic: self._kept[topic] for topic in handed if topic in self._kept}
        self.host.revive(name, stage, kept)
        self.robot.alive(name, True)

    @staticmethod
    def open_log(config: StackConfig, path: Any) -> LogWriter:
        """A log for this host: no wall clock, no machine in it, so the same run gives the same bytes."""
        metadata = config.metadata() | {"host": "lockstep"}
        pack_sweeps = config.recorder.profile == "standard"
        return LogWriter(path, metadata, {CONFIG: config.to_yaml().encode()}, pack_sweeps=pack_sweeps)

    def _note(self, topic: Topic, payload: bytes, _now: int) -> None:
        if topic in _KEPT:
            self._kept[topic] = payload
        if topic in _NOTED:
            self.newest.put(topic, payload)
            if topic is t.GOAL_STATUS:
                self.statuses.append(self.newest[topic])

    @property
    def now(self) -> int:
        """Simulated clock [ns]."""
        return self.host.now

    @property
    def seconds(self) -> float:
        """Simulated clock [s]."""
        return self.host.now / NS

    def step(self) -> None:
        """5 ms."""
        self.host.tick(self.host.now + STEP_PERIOD)

    def run(self, seconds: float) -> None:
        """That long."""
        for _ in range(round(seconds * NS / STEP_PERIOD)):
            self.step()

    def run_until(self, condition: Callable[[], bool], timeout: float, what: str = "the condition") -> None:
        """Until `condition()`, at most `timeout` simulated seconds. Raises LockstepTimeout."""
        end = self.seconds + timeout
        while not condition():
            if self.seconds >= end:
                status = self.newest.get(t.GOAL_STATUS)
                stands = (
                    f"goal {status.state} {status.reason} {status.detail}" if status else "no goal status"
                )
                raise LockstepTimeout(f"{what} did not come in {timeout} s: {stands}")
            self.step()

    def wait_ready(self, timeout: float = 15.0) -> None:
        """Robot stands, odometry is good, a map exists, and the robot knows where it is in a prior one."""

        def ready() -> bool:
            state, health = self.newest.get(t.ROBOT_STATE), self.newest.get(t.ODOM_HEALTH)
            status = self.newest.get(t.MAP_STATUS)
            return bool(
                state
                and state.phase in ("ready", "moving")
                and health
                and health.health == "good"
                and status
                and status.trusted_cells > 0
                and unlocated(status) is None
            )

        self.run_until(ready, timeout, "readiness")

    def send_goal(
        self, x: float, y: float, yaw: float | None = None, timeout: float = 0.0, *, accept_risk: bool = False
    ) -> str:
        """Returns the goal's id. `accept_risk`: however likely its way fails."""
        goal_id = f"goal-{uuid.uuid5(uuid.NAMESPACE_OID, f'{self.now}/{x}/{y}').hex[:12]}"
        self.host.inject(
            t.GOAL_REQUEST,
            goal_request(self.now, goal_id, x, y, yaw, timeout=timeout, accept_risk=accept_risk),
        )
        return goal_id

    def command(self, mode: str, cause: str = "") -> None:
        """Stop, resume, ...; `resume` releases what is latched now."""
        latch = self.newest[t.ROBOT_STATE].latch
        request = msg.RobotCommand(header=header(self.now, ""), mode=mode, cause=cause, latch=latch)
        self.host.inject(t.ROBOT_COMMAND, request)

    def finish_goal(self, timeout: float) -> Any:
        """Run until the newest goal ended; its last status."""

        def ended() -> bool:
            status = self.newest.get(t.GOAL_STATUS)
            return status is not None and GoalState(status.state).terminal

        self.run_until(ended, timeout, "the end of the goal")
        return self.newest[t.GOAL_STATUS]

    def close(self) -> None:
        """Close stages and log."""
        self.host.close()
        if self._log is not None:
            self._log.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


_KEPT: frozenset[Topic] = frozenset(
    (*(topic for row in PROCESSES for topic in row.restores), *(x for x in t.TOPICS if x.qos is Qos.LATCHED))
)
_NOTED: frozenset[Topic] = frozenset(
    {
        t.GOAL_STATUS,
        t.ROBOT_STATE,
        t.ODOM,
        t.ODOM_HEALTH,
        t.MAP_STATUS,
        t.TRUTH,
        t.TRACKER_STATE,
        t.PLAN,
        t.CMD_VEL,
    }
)
