"""The robot process: a backend behind the gate, paced in real time. Not a hosted stage: it makes the time of the
others."""

from __future__ import annotations

import logging
import time
from collections import deque
from collections.abc import Callable
from typing import Any

from hal.contract import Backend, BackendError
from hal.named import named
from hal.safety.gate import SafetyGate
from hal.types import NS
from rbtrg_robot import topics as t
from rbtrg_robot.config import GUARD, StackConfig
from rbtrg_robot.hosts.memory import keep_what_is_loaded
from rbtrg_robot.processes import BY_NAME, PROCESSES
from rbtrg_robot.stages.robot import STEP_PERIOD, RobotStage
from rbtrg_robot.stages.stage import Outputs
from rbtrg_robot.topics import Topic
from rbtrg_robot.wire import messages
from rbtrg_robot.wire.bus import Bus
from rbtrg_robot.wire.clock import SourceClock
from rbtrg_robot.wire.convert import yaw_of
from rbtrg_robot.wire.heart import Heart
from rbtrg_robot.wire.messages import stamp_of

log = logging.getLogger(__name__)

START_LIMIT = 150.0
"""Longest wait [s] for the other processes before simulated time starts without them."""


def build(
    config: StackConfig,
    restored: dict[Topic, bytes] | None = None,
    clock: SourceClock | None = None,
    begin: int = 0,
) -> RobotStage:
    """From the stack's configuration. Raises BackendError, SceneError.

    A restarted simulator goes on where the last one died: `restored` holds its newest truth. A real robot's samples are
    stamped by `clock`; a simulator's begin at `begin` [ns].
    """
    watched = frozenset(p.name for p in PROCESSES if p.stops_motion and p.name not in config.absent)
    backend = _simulator(config, restored or {}, begin) if config.simulated else _hardware(config, clock)
    gate = SafetyGate(backend.capabilities, config.gate, config.fence(), guarded=GUARD in watched)
    return RobotStage(backend, gate, simulated=config.simulated, watched=watched, robot=config.facts)


def _simulator(config: StackConfig, restored: dict[Topic, bytes], begin: int) -> Backend:
    from hal.mujoco.backend import MujocoBackend

    start, start_time = config.origin, begin
    if t.TRUTH in restored:
        truth = messages.decode(restored[t.TRUTH], t.TRUTH.kind)
        place = truth.pose.pose
        start = (place.position.x, place.position.y, yaw_of(place.orientation))
        start_time = stamp_of(truth) // STEP_PERIOD * STEP_PERIOD
    return MujocoBackend(
        config.load_scene(),
        config.sim,
        robot=config.facts,
        controller=config.controller,
        policy_dir=config.policy_dir,
        lidars=config.lidars,
        seed=config.seed,
        start=start,
        start_time=start_time,
    )


def maker(backend: str) -> Callable[[StackConfig, SourceClock], object]:
    """Of a backend that is not ours, by its name. Raises NamedError."""
    make: Callable[[StackConfig, SourceClock], object] = named(
        backend, "backend", "rbtrg.backends", ("sim", "unitree")
    )
    return make


def _hardware(config: StackConfig, clock: SourceClock | None) -> Backend:
    clock = clock or SourceClock()
    if config.backend != "unitree":
        made = maker(config.backend)(config, clock)
        if not isinstance(made, Backend):
            raise BackendError(f"backend {config.backend} made {made!r}, which is no hal.contract.Backend")
        return made
    from hal.unitree.factory import make_backend

    backend: Backend = make_backend(
        config.interface,
        dry_run=config.dry_run,
        options=config.unitree_options(),
        clock=clock,
        controller=config.controller,
        policy=config.policy_dir,
    )
    return backend


CLOCK_BEGIN = 1_767_225_600 * NS
"""[ns] A simulated clock begins at 2026-01-01 00:00 UTC: programs of others take a stamp near 0 for none, and drop it.
"""


class Pace:
    """Keeps a simulator in real time, and measures how well it keeps up."""

    WINDOW = 2.0
    MOST_BEHIND = 0.1
    """[s] of lag that is caught up; more is given away, or the simulator would race after a stall."""

    def __init__(self, now: int) -> None:
        self._wall = time.monotonic()
        self._source = now
        self._history: deque[tuple[float, int]] = deque()

    def target(self) -> int:
        """Where the source clock should stand [ns]."""
        return self._source + int((time.monotonic() - self._wall) * NS)

    def at(self, now: int) -> float:
        """The source clock has reached `now`; returns the real-time factor over the last 2 s."""
        wall = time.monotonic()
        behind = self.target() - now
        if behind > self.MOST_BEHIND * NS:
            self._source -= behind
        self._history.append((wall, now))
        while wall - self._history[0][0] > self.WINDOW:
            self._history.popleft()
        (w0, n0), (w1, n1) = self._history[0], self._history[-1]
        return (n1 - n0) / NS / (w1 - w0) if w1 > w0 + 0.2 else 1.0


class Window:
    """MuJoCo's viewer on the running simulation. A closed window stays closed; the robot goes on."""

    PERIOD = 0.04

    def __init__(self, backend: Any) -> None:
        """Raises RenderError where there is no display."""
        from hal.mujoco.view.render import launch_viewer

        self._handle = launch_viewer(backend.simulation.model, backend.simulation.data)
        self._due = 0.0

    def show(self) -> None:
        """Call once per turn; draws 25 times a second."""
        now = time.monotonic()
        if now >= self._due and self._handle.is_running():
            self._due = now + self.PERIOD
            self._handle.sync()

    def close(self) -> None:
        """Take the window away."""
        self._handle.close()


def main(config: StackConfig, bus: Bus, stopping: Callable[[], bool], restored: dict[Topic, bytes]) -> None:
    """The process: paced in real time."""
    heart = Heart(bus, BY_NAME["robot"].name)
    heart.beat("starting")
    stage = build(config, restored, bus.clock, CLOCK_BEGIN)
    window: Window | None = None
    now = stage.start_time if config.simulated else bus.clock()
    told = False
    """To end, and not by an error: after one, the next process takes the robot as it stands, on a stair or a ramp."""
    try:
        if not config.simulated:
            keep_what_is_loaded()  # a real robot is held from then on: nothing may take long between its first words
        stage.warm_up()
        if config.simulated:
            keep_what_is_loaded()  # the making of its model took much
        changes: deque[tuple[str, bool]] = deque()

        def changed(process: str, alive: bool) -> None:
            changes.append((process, alive))
            bus.wake()

        bus.watch_processes(changed)
        for topic in stage.outputs:
            bus.advertise(topic)
        bus.subscribe(stage.inputs)
        for topic, payload in restored.items():
            stage.on(topic, messages.decode(payload, topic.kind))
        if config.simulated and t.TRUTH not in restored:
            _wait_for_all(bus, heart, config, stopping)
        window = Window(stage.backend) if config.viewer else None
        pace = Pace(now)
        while not stopping():
            heart.beat()
            ahead = (now + STEP_PERIOD - pace.target()) / NS if config.simulated else STEP_PERIOD / NS
            inbox = bus.take(min(max(ahead, 0.0), 0.005))
            if not config.simulated:
                stage.now = bus.clock()
            while changes:
                stage.alive(*changes.popleft())
            for received in inbox:
                message = bus.open(received)
                if message is not None:  # a broken command is no command
                    stage.on(received.topic, message, received.sender)
            if not config.simulated:
                now = bus.clock()
                publish(bus, stage.tick(now), now)
                continue
            target = pace.target()
            while now + STEP_PERIOD <= target and not stopping():
                now += STEP_PERIOD
                publish(bus, stage.tick(now), now)
                stage.realtime_factor = pace.at(now)
                if bus.waiting:
                    break
            if window is not None:
                window.show()
        told = True
    finally:
        if window is not None:
            window.close()
        stage.close(lie_down=told)


def _wait_for_all(bus: Bus, heart: Heart, config: StackConfig, stopping: Callable[[], bool]) -> None:
    """Simulated time starts when every process listens: nobody misses the first messages, so a re-run sees the same."""
    missing = {p.name for p in PROCESSES if p.name not in ("robot", *config.absent)}
    bus.subscribe([t.HEARTBEAT])
    deadline = time.monotonic() + START_LIMIT
    while missing and not stopping() and time.monotonic() < deadline:
        heart.beat("starting", f"waiting for {', '.join(sorted(missing))}")
        for received in bus.take(0.1):
            if received.topic is t.HEARTBEAT:
                beat = bus.open(received)
                if beat is not None and beat.state == "ready":
                    missing.discard(beat.process)


def publish(bus: Bus, outputs: Outputs, now: int) -> None:
    """Send what a tick gave."""
    for topic, message in outputs:
        bus.publish(topic, message, stamp_of(message) or now)
