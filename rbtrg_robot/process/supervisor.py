"""`up`: spawns every process, restarts what dies or hangs, hosts the Zenoh router, and knows how the stack is."""

from __future__ import annotations

import base64
import json
import logging
import math
import os
import signal
import time
from collections import deque
from collections.abc import Callable
from contextlib import nullcontext, suppress
from functools import partial
from pathlib import Path
from typing import Any

import psutil

from hal.errors import OperatorError, one_line
from hal.types import LYING
from rbtrg_robot import __version__
from rbtrg_robot import topics as t
from rbtrg_robot.access.certificates import lies_open
from rbtrg_robot.access.serve import keys_folder, security
from rbtrg_robot.config import StackConfig
from rbtrg_robot.hosts.memory import give_back
from rbtrg_robot.process.child import FATAL, PASSING
from rbtrg_robot.process.diagnostics import Diagnosis
from rbtrg_robot.process.events import ERROR, INFO, WARNING, Events
from rbtrg_robot.process.health import Health, expected_topics
from rbtrg_robot.process.kernels import REST, Compiling
from rbtrg_robot.process.latch import LatchFile
from rbtrg_robot.process.leftovers import last_words, shared_segments
from rbtrg_robot.process.mission_file import MissionFile
from rbtrg_robot.process.notify import Notifier
from rbtrg_robot.process.router import open_bus
from rbtrg_robot.process.runfiles import RunLock, console_address, take_interface
from rbtrg_robot.process.supervised import BACKOFF_TIMES, Child, end
from rbtrg_robot.process.zygote import Forked, Zygote, ZygoteError
from rbtrg_robot.processes import PROCESSES
from rbtrg_robot.topics import Topic
from rbtrg_robot.wire.bus import Reply
from rbtrg_robot.wire.clock import SourceClock
from rbtrg_robot.wire.messages import stamp_of
from rbtrg_robot.wire.session import stack_id

log = logging.getLogger(__name__)

START_LIMIT, START_IDLE, START_MOST = 180.0, 30.0, 1800.0
"""[s] until a process must be ready: a cold start compiles the kernels. On a slow or busy computer one that computes
gets longer: until it has been idle for so long, or has taken so long in all."""
HELD_UP = 2.0
"""A turn that took this long [s]: the supervisor was held up itself (stopped, swapped out), so what it has heard is
old, and after the lease sessions with its router have ended."""
REJOIN_TIME = 6.0
"""[s] in which processes are on its bus again then; Zenoh tries every 4 s at the longest. Until then nobody is ended
for silence."""
PLANNER = "planner"
COMPILES = (PLANNER, "guard", "elevation", "odometry", "robot")
"""Processes that compile kernels at a first start: the longest first, then the one whose kernels it needs next, the
robot last, for it waits for the others then."""
MOST_ASKED = 64
"""Most questions that wait for an answer; of more the oldest get none."""
LAST_WISH = 0.9
"""The recorder's own seconds after all others have ended."""


class StartFailed(OperatorError):
    """The stack did not come up; the message names the process and its last words."""


class Supervisor:
    """Lives in the main thread: the parent-death signal of the others fires when this thread ends."""

    def __init__(self, config: StackConfig, zygote: Zygote, say: Callable[[str], None]) -> None:
        self._config = config
        self._zygote = zygote
        self._say = say
        rows = [p for p in PROCESSES if p.name not in config.absent]
        self._children = {row.name: Child(row) for row in rows}
        lidars = [lidar.name for lidar in config.lidars]
        self._expected = expected_topics(rows, simulated=config.simulated, lidars=lidars)
        self._clock = SourceClock()
        self._stack = stack_id()
        self._health = Health(config.simulated, self._clock, lidars)
        self._kept: dict[Topic, bytes] = {}
        self._asked: deque[tuple[str, Reply]] = deque(maxlen=MOST_ASKED)
        """Questions of others, not yet answered."""
        self._ready = False
        self._lacks = ""
        """Why it is not ready."""
        self._compiling, self._compiled = Compiling(), ""
        self._rest: Forked | None = None
        """The process that compiles what no first goal needs."""
        self._console_told = "console" not in self._children
        self._were_well: set[Topic] = set()
        """Topics that have been so since the start."""
        self._usage_due = 0.0
        self._looked = math.inf
        self._deaf_until = 0.0
        self._events = Events(say, config.gate.min_battery, lambda: self._health.source_now, self._clock)
        self._latch = LatchFile(config.robot)
        self._mission = MissionFile(config.robot)
        self._notifier = Notifier()
        self._diagnosis = Diagnosis(config.robot)
        self._diagnosis_due = 0.0
        self.began = time.monotonic()

    @property
    def given_up(self) -> list[str]:
        """Processes that ended with what a restart cannot mend. The stack stays up without them, for looking and for
        `stop`."""
        return [name for name, child in self._children.items() if child.fatal]

    # --- life -------------------------------------------------------------------------------------------------

    def run(self, stopping: Callable[[], bool], on_turn: Callable[[dict[str, Any]], None]) -> None:
        """Bring the stack up and keep it up until `stopping()`. Raises StartFailed, BusError, AlreadyRunning,
        RobotTaken."""
        config = self._config
        real = config.backend != "sim"
        domain = config.unitree.dds_domain(config.interface)
        held = take_interface(config.interface or config.backend, domain) if real else nullcontext()
        with held:
            self._run(stopping, on_turn)

    def _run(self, stopping: Callable[[], bool], on_turn: Callable[[dict[str, Any]], None]) -> None:
        lock = RunLock(self._config.robot)
        if latched := self._latch.read():
            self._kept[t.ROBOT_STATE] = latched
            self._events.happened(
                "stop",
                "the emergency stop of before is still latched: `rbtrg-robot resume` releases it",
                ERROR,
            )
        if left := self._mission.read():
            self._kept |= left
            self._events.happened(
                "mission", "a mission of before is paused: see `rbtrg-robot mission status`"
            )
        try:
            ours: dict[str, Any] = {
                "clock": self._clock,
                "stack": self._stack,
                "absent": self._config.absent,
            }
            served = security(self._config)
            with open_bus(self._config, security=served, **ours) as bus:
                if self._config.network.listen:
                    self._say(f"listening on {', '.join(self._config.network.listen)}")
                    if open_key := lies_open(keys_folder(self._config)):
                        self._say(open_key)
                self._write_state(lock)
                restored = {topic for child in self._children.values() for topic in child.row.restores}
                self._bus = bus
                bus.subscribe({*Health.WATCHED, *Events.HEARS, *restored})
                bus.advertise(t.EVENTS)
                for name in ("status", "events"):
                    bus.serve(name, partial(self._ask, name))
                try:
                    self._let_begin()
                    for child in self._children.values():
                        if child.due < math.inf:
                            self._spawn(child)
                    while not stopping():
                        on_turn(self._turn(lock))
                finally:
                    self._notifier.stopping()
                    self._stop_all()
        finally:
            lock.release()

    def _turn(self, lock: RunLock) -> dict[str, Any]:
        """What `status --json` prints after it."""
        # Before the inbox: whoever asks is told all that came before the question, a stop above all.
        asked = [self._asked.popleft() for _ in range(len(self._asked))]
        for received in self._bus.take(0.0 if asked else 0.1):
            message = self._bus.open(received)
            if message is None:  # nothing that comes over the bus may end the stack
                continue
            if any(received.topic in c.row.restores for c in self._children.values()):
                self._kept[received.topic] = received.payload
            if t.MISSION_STATE.carried(message, received.topic):
                self._mission.write(self._kept, message)
            if received.topic in Health.WATCHED:
                self._health.take(received.topic, message)
            self._events.take(received.topic, message)
            if t.ROBOT_STATE.carried(message, received.topic):
                self._latch.follow(received.payload, latched=message.estop)
        self._mend()
        self._measure()
        for event in self._events.due():
            self._bus.publish(t.EVENTS, event, stamp_of(event))
        self._notifier.alive()
        if not self._console_told and self._health.is_ready("console"):
            self._console_told = True
            place = console_address(self._config.robot, token=not self._notifier.wanted)
            self._say(f"console: {place}")
        if not self._ready:
            self._look(lock)
        self._notifier.status(self._summary())
        status = self.status()
        if time.monotonic() >= self._diagnosis_due:
            self._diagnosis_due = time.monotonic() + 1.0
            now = self._health.source_now
            self._bus.publish(t.DIAGNOSTICS, self._diagnosis.message(status, now), now)
        for name, reply in asked:
            reply(json.dumps(status if name == "status" else self._events.newest()).encode())
        return status

    def _ask(self, name: str, reply: Reply) -> None:
        """Somebody asks; in Zenoh's thread."""
        self._asked.append((name, reply))
        self._bus.wake()

    def _look(self, lock: RunLock) -> None:
        """Whether the stack is ready, or why not."""
        before, self._lacks = self._lacks, self._missing()
        self._ready = not self._lacks
        if self._ready:
            self._compiled = ""
            self._events.happened("stack", f"ready after {time.monotonic() - self.began:.1f} s")
            state = self._health.newest.get(t.ROBOT_STATE)
            if state is not None and state.phase in LYING:
                self._say(f"the robot is {state.phase}: `rbtrg-robot posture stand` before the first goal")
        if self._ready or self._lacks != before:
            self._write_state(lock)  # after the word: who waits for the state prints what was said
        if self._ready:
            give_back()
            self._notifier.ready()
            if self._compiling.cold:
                with suppress(ZygoteError, OSError):  # it is compiled when it is needed
                    self._rest = self._fork(REST, {})

    def _write_state(self, lock: RunLock) -> None:
        lock.write_state(
            robot=self._config.robot,
            endpoint=self._config.endpoint,
            port=self._config.port,
            domain=self._config.domain,
            backend=self._config.backend,
            scene=self._config.scene,
            scene_options=self._config.scene_options,
            log_dir=self._config.log_dir if self._config.record else "",
            ready=self._ready,
            stalled="" if self._late() else self._lacks,
            processes=list(self._children),
        )

    def _late(self) -> list[str]:
        """Processes that do not run yet."""
        return [n for n, child in self._children.items() if not (child.alive and self._health.is_ready(n))]

    def _missing(self) -> str:
        """What is not as it should be, the first cause of it; empty where all is. A planner that looks at a large prior
        map for seconds before anybody asks it counts as well if it was before."""
        bad = set(self._health.unhealthy_topics(self._expected))
        self._were_well |= {topic for topic in self._expected if topic.name not in bad}
        if late := self._late():
            return f"{', '.join(late)} {'has' if len(late) == 1 else 'have'} not started"
        if "robot" in self._children:
            state = self._health.newest.get(t.ROBOT_STATE)
            if state is None:
                return "the backend tells no state of the robot"
            if state.phase not in ("ready", "moving", "stopped", *LYING):
                return f"the robot is {state.phase}: {state.cause}".removesuffix(": ")
        at_work = self._were_well if self._health.busy(PLANNER) else set()
        lacking = [
            topic
            for topic in self._expected
            if topic.name in bad and not (topic.owner == PLANNER and topic in at_work)
        ]
        sensed = [topic for topic in lacking if topic.owner == "robot"]  # the others are made of these
        told = (
            f"{topic.name} {self._health.topic_row(topic)['rate']:.0f} of {topic.rate:.0f} Hz"
            for topic in sensed or lacking
        )
        return ("the robot's backend is too slow or silent: " if sensed else "") + ", ".join(told)

    # --- processes --------------------------------------------------------------------------------------------

    def _let_begin(self) -> None:
        """Where kernels must be compiled, each of COMPILES takes a core for that: the planner has one to itself, who
        finds none free waits."""
        these = [self._children[name] for name in COMPILES if name in self._children]
        free = len(os.sched_getaffinity(0)) if self._compiling.cold else len(these)
        free -= sum(child.started > 0.0 and not self._health.is_ready(child.row.name) for child in these)
        for number, child in enumerate(child for child in these if not child.started):
            child.due = 0.0 if number < free else math.inf

    def _spawn(self, child: Child) -> None:
        name = child.row.name
        restored = {
            topic.name: base64.b64encode(self._kept[topic]).decode()
            for topic in child.row.restores
            if topic in self._kept
        }
        child.log_path = self._log_path(name)
        child.forked = self._fork(name, restored)
        child.started = child.busy = time.monotonic()
        child.usage = psutil.Process(child.forked.pid)
        child.usage.cpu_percent()

    def _log_path(self, name: str) -> Path:
        return Path(self._config.log_dir) / f"{name}.log"

    def _fork(self, name: str, restored: dict[str, str]) -> Forked:
        specification = {
            "process": name,
            "config": self._config.model_dump(mode="json"),
            "clock": self._clock.offset,
            "stack": self._stack,
            "restored": restored,
            "hurry": self._compiling.cold and not self._ready,
        }
        return self._zygote.fork(specification, self._log_path(name))

    def _spawn_again(self, child: Child) -> None:
        """While the computer has no room for it, the others go on without it: what it means for motion is told at its
        end."""
        try:
            self._spawn(child)
        except (ZygoteError, OSError) as error:
            if not self._ready:
                raise
            if str(error) != child.words:
                self._process(f"{child.row.name} cannot be started ({one_line(error)}); trying again")
            child.words, child.due = str(error), time.monotonic() + BACKOFF_TIMES[-1]

    def _mend(self) -> None:
        now = time.monotonic()
        if now - self._looked > HELD_UP:
            self._deaf_until = now + REJOIN_TIME
            self._process(f"the supervisor was held up for {now - self._looked:.1f} s")
        self._looked = now
        if not self._ready:
            self._let_begin()
        for child in self._children.values():
            name = child.row.name
            if child.fatal:
                continue
            if child.forked is None:
                if now >= child.due:
                    self._spawn_again(child)
                continue
            code = child.forked.poll()
            if code is None:
                self._end_if_hung(child, now)
                continue
            self._health.forget(name)
            child.forked = None
            words = last_words(child.log_path)
            told = code in (FATAL, PASSING)
            if not self._ready and (told or child.in_a_row >= 2):
                raise StartFailed(
                    f"{name} failed to start: {words or f'exit status {code}'} ({child.log_path})"
                )
            if code == FATAL:
                child.fatal = words
                self._process(f"{name} gave up: {words}")
                continue
            wait = child.ended(now)
            how = f"signal {signal.Signals(-code).name}" if code < 0 else f"exit status {code}"
            why = words if code == PASSING else how
            if code != PASSING or why != child.words:  # a robot that is away for an hour is said once
                self._process(f"{name} ended ({why}); restarting in {wait:.1f} s: {child.row.loss}")
            child.words = why

    def _process(self, text: str, severity: int = ERROR) -> None:
        self._events.happened("process", text, severity)

    def _end_if_hung(self, child: Child, now: float) -> None:
        name = child.row.name
        age = self._health.beat_age(name)
        if age is None or not self._health.is_ready(name):
            waited, idle = now - child.started, now - child.busy
            # A robot that waits for others which compile is idle, and beats.
            beats = age is not None and age < child.row.hang
            silent = waited > START_LIMIT and ((idle > START_IDLE and not beats) or waited > START_MOST)
        else:
            silent = age > child.row.hang and now > self._deaf_until
            if child.words:
                self._process(f"{name} runs again", INFO)
                child.words = ""
        if silent and child.forked is not None:
            self._process(f"{name} hangs; killing it")
            child.forked.kill()
            child.forked.wait()

    def _stop_all(self) -> None:
        """The robot's side first, the recorder last so that the log holds the end."""
        children = [c for c in self._children.values() if c.forked is not None]
        recorder = [c for c in children if c.row.name == "recorder"]
        others = [c for c in children if c.row.name != "recorder"]
        segments = {path for c in children if c.usage is not None for path in shared_segments(c.usage)}
        end({c.forked: c.row.farewell for c in others if c.forked})
        end({c.forked: LAST_WISH for c in recorder if c.forked})
        # Zenoh removes what a process leaves only when the next one starts.
        for path in segments:
            path.unlink(missing_ok=True)

    # --- knowledge --------------------------------------------------------------------------------------------

    def _measure(self) -> None:
        now = time.monotonic()
        if now < self._usage_due:
            return
        self._usage_due = now + 1.0
        if not self._ready:
            self._compiled = self._compiling.words()
        if self._zygote.mend():
            self._process(
                "the process that starts the others ended; there is a new one, and the robot drives on",
                WARNING,
            )
        self._events.strangers(self._bus.intrusion())
        if self._rest is not None and self._rest.poll() is not None:
            self._rest = None
        polled = [self._rest, *(child.forked for child in self._children.values())]
        self._zygote.reap({forked.pid for forked in polled if forked is not None})
        for child in self._children.values():
            child.measure()

    def _summary(self) -> str:
        """One line for the service manager."""
        missing = [name for name, child in self._children.items() if not child.alive and not child.fatal]
        state = self._health.newest.get(t.ROBOT_STATE)
        words = ["ready" if self._ready else "starting"]
        words += [f"gave up: {', '.join(self.given_up)}"] if self.given_up else []
        words += [f"restarting: {', '.join(missing)}"] if missing and self._ready else []
        words += [f"robot {state.phase}"] if state is not None else []
        return "; ".join(words)

    def status(self) -> dict[str, Any]:
        """What `status --json` prints."""
        return {
            "version": __version__,
            "pid": os.getpid(),
            "ready": self._ready,
            "compiling": self._compiled,
            "lacks": self._lacks,
            "refused": self._bus.refused,
            "uptime": round(time.monotonic() - self.began, 1),
            "log_dir": self._config.log_dir if self._config.record else "",
            "processes": [child.status(self._health) for child in self._children.values()],
            "topics": [self._health.topic_row(topic) for topic in t.TOPICS],
            "robot": self._health.robot_row(),
        }
