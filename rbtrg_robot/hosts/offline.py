"""Run stages again on a log: no Zenoh, one process, deterministic. Same log, same code, same bytes."""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from hal.types import NS
from rbtrg_robot import topics as t
from rbtrg_robot.config import ConfigError, StackConfig, load, of_log
from rbtrg_robot.hosts.follow import Follower
from rbtrg_robot.hosts.journal import LAST_STAMP, Step, read_journals
from rbtrg_robot.hosts.lockstep import build_stages
from rbtrg_robot.hosts.sync import SyncHost
from rbtrg_robot.log.read import CONFIG, METADATA, Entry, LogError, first_of, read_run
from rbtrg_robot.log.summary import overview
from rbtrg_robot.log.write import LogWriter
from rbtrg_robot.processes import PROCESSES
from rbtrg_robot.stages.stage import Stage, warm
from rbtrg_robot.topics import Qos, Topic
from rbtrg_robot.wire.convert import LayoutError, lidar_scan
from rbtrg_robot.wire.messages import MessageError, decode, stamp_in

Stages = dict[str, tuple[Stage, float]]
Progress = Callable[[float], None]
Write = Callable[[Topic, bytes, int, int, int], None]
"""Called with topic, wire bytes, time of the log, stamp [ns] and number of a message."""


def rerun(
    log: Path,
    names: list[str],
    out: Path,
    *,
    file: Path | None = None,
    sets: Sequence[str] = (),
    start_offset: float = 0.0,
    duration: float = math.inf,
    progress: Progress = lambda _seconds: None,
    say: Callable[[str], None] = lambda _text: None,
) -> dict[str, int]:
    """Feed `log` through the named stages; write inputs and new outputs to `out`, what they publish instead of what the
    log holds on those topics. Only `duration` [s] of the log from `start_offset` [s] on is fed, after what was latched
    before. See `config_of`, `stages_for` and `feed`. Returns messages per topic.
    """
    counts: Counter[str] = Counter()
    config = config_of(log, file, sets, say)
    metadata = first_of(log).metadata.get(METADATA, {}) | {"rerun": ",".join(names)}
    stages = stages_for(log, names, config)
    within = Window(overview(log).begin, start_offset, duration)
    with LogWriter(out, metadata, {CONFIG: config.to_yaml().encode()}) as writer:

        def write(topic: Topic, payload: bytes, now: int, stamp: int, sequence: int) -> None:
            if topic.recorded:
                counts[topic.name] += 1
                writer.write(topic, payload, now, stamp, sequence)

        feed(log, stages, config, write, within, progress, say)
    return dict(counts)


def config_of(
    log: Path, file: Path | None, sets: Sequence[str], say: Callable[[str], None] = lambda _text: None
) -> StackConfig:
    """The configuration the log was made with, changed by `file` (YAML) and `sets` (a.b=c). Raises ConfigError,
    LogError."""
    base, unknown = of_log(first_of(log).attachments.get(CONFIG, b""))
    if unknown:
        say(f"the log is of another version; left out of its configuration: {', '.join(unknown)}")
    return load(file, sets, base=base)


def stages_for(log: Path, names: list[str], config: StackConfig) -> Stages:
    """The named stages, warm. Raises ConfigError for a name that is no stage or a configuration that does not hold,
    LogError where the log lacks what one needs.
    """
    fitting(log, names, config)
    stages = build_stages(config, names)
    for stage, _period in stages.values():
        warm(stage)
    return stages


def feed(
    log: Path,
    stages: Stages,
    config: StackConfig,
    write: Write,
    within: Window,
    progress: Progress = lambda _seconds: None,
    say: Callable[[str], None] = lambda _text: None,
) -> None:
    """Feed a part of `log` through stages; `write` hears inputs and outputs, `progress(seconds)` how much of the source
    clock is done, `say` what the operator should know. Raises LogError.
    """
    held = overview(log).topics
    # From a later start on, stages begin anew: their messages have other numbers than the journals say.
    journals = t.JOURNAL.name in held and not within.later
    steps, restarted = read_journals(within.entries(read_run(log, raw=True)) if journals else ())
    live = stages.keys() <= steps.keys()
    replaced = {
        topic
        for stage, _ in stages.values()
        for topic in stage.outputs
        if topic.owner in stages or not live  # where others publish too, a live log has all that was said
    }
    for name in sorted(restarted & stages.keys()):
        say(f"{name} was restarted in this log: its re-run ends there")

    def inputs() -> Iterator[tuple[Topic, Entry]]:
        for entry in within.entries(read_run(log)):
            topic = t.BY_NAME.get(entry.topic) or t.RENAMED.get(entry.topic)
            if (
                topic is not None
                and topic not in replaced
                and topic is not t.HEARTBEAT
                and (live or topic is not t.JOURNAL)  # in the order of the log, messages get new numbers
                and entry.type == topic.type
            ):
                yield topic, entry

    if live:
        _follow(stages, steps, inputs(), write, progress, say)
    else:
        # without a clock in it, its own times are all there is
        clocked = config.simulated and t.CLOCK.name in held
        _feed(stages, inputs(), write, progress, simulated=clocked)


class Window:
    """Part of a log."""

    def __init__(self, begin: int, offset: float = 0.0, duration: float = math.inf) -> None:
        """`begin`: first message [ns of the log]; the part begins `offset` [s] later and lasts `duration` [s]. Raises
        ConfigError."""
        if not (offset >= 0.0 and duration > 0.0 and math.isfinite(offset)):
            raise ConfigError(
                f"--start-offset must be 0 or more and --duration positive, got {offset} and {duration}"
            )
        self.later = offset > 0.0
        """What lies before it is left out."""
        self._first = begin + round(offset * NS)
        self._end = self._first + round(min(duration, 1e9) * NS)

    def entries(self, entries: Iterable[Entry]) -> Iterator[Entry]:
        """Those of the part, after what was latched before it. Nothing behind it is read."""
        latched: dict[str, Entry] = {}
        for entry in entries:
            if entry.log_time > self._end:
                return
            if entry.log_time >= self._first:
                yield from latched.values()
                latched = {}
                yield entry
            elif (topic := t.BY_NAME.get(entry.topic)) is not None and topic.qos is Qos.LATCHED:
                latched[entry.topic] = replace(entry, log_time=self._first)


def _needs(config: StackConfig) -> dict[str, tuple[tuple[Topic, ...], ...]]:
    """What each stage cannot do without: of each group one topic."""
    sweeps, clouds = tuple(t.SWEEPS.values()), tuple(t.CLOUDS.values())
    odometry = {"": ((t.IMU,), sweeps), "imu": (sweeps,), "lidar": ((t.IMU,), (t.JOINTS, t.WHEELS))}
    return {
        "odometry": odometry[config.odometry.without],
        "elevation": ((t.ODOM,), clouds),
        "planner": ((t.MAP_UPDATE,),),
        "guard": ((t.MAP_WINDOW,),),
        "tracker": ((t.PATH_COMMAND,),),
    }


def fitting(log: Path, names: list[str], config: StackConfig) -> None:
    """Raises ConfigError for a name that is no stage, LogError where the log lacks what a stage needs, and no stage of
    the re-run makes it; or holds it in another layout."""
    possible = [p.name for p in PROCESSES if p.hosted]
    for name in names:
        if name not in possible:
            raise ConfigError(f"no stage {name!r}: choose from {', '.join(possible)}")
    held = overview(log).topics
    ours = {
        topic
        for name, of in held.items()
        if (topic := t.BY_NAME.get(name) or t.RENAMED.get(name)) and of.count
    }
    made = {topic for topic in t.TOPICS if topic.owner in names}
    needs = _needs(config)
    for name in names:
        for group in needs.get(name, ()):
            if any(topic in ours | made for topic in group):
                continue
            what = " or ".join(topic.name for topic in group)
            fits = sorted(n for n, of in held.items() if of.type == group[0].type and n not in t.BY_NAME)
            lead = (
                f"; it holds {', '.join(fits)} of that type: `rbtrg-robot import` makes a run of it"
                if fits
                else ""
            )
            if not fits and not ours:
                lead = "; none of its topics is ours: `rbtrg-robot import` makes a run of a foreign bag"
            raise LogError(f"{log} holds no {what} ({group[0].type}), which {name} needs{lead}")
    if "odometry" in names:
        wanted = set(t.SWEEPS.values()) & ours
        for entry in read_run(log):
            if (topic := t.BY_NAME.get(entry.topic) or t.RENAMED.get(entry.topic)) in wanted:
                try:
                    lidar_scan(decode(entry.data, t.POINTS.kind))
                except MessageError:
                    continue  # one broken message is none of another layout
                except LayoutError as error:
                    raise LogError(
                        f"{entry.topic} of {log} is not as we record it: {error}; `rbtrg-robot import` reads it"
                    ) from error
                wanted.discard(topic)
            if not wanted:
                break


def _feed(
    stages: Stages,
    inputs: Iterable[tuple[Topic, Entry]],
    write: Write,
    progress: Progress,
    *,
    simulated: bool,
) -> None:
    """A log of lockstep: the order of the log is the order of the stages."""
    sequence: Counter[Topic] = Counter()

    def sink(topic: Topic, payload: bytes, now: int) -> None:
        sequence[topic] += 1
        write(topic, payload, now, stamp_in(payload, topic.type) or now, sequence[topic])

    host = SyncHost(stages, sink)
    first: int | None = None
    for topic, entry in inputs:
        try:
            if topic is t.CLOCK:
                now = stamp_in(entry.data, topic.type)
            else:
                now = host.now if simulated else entry.log_time
            if not 0 <= now < LAST_STAMP:
                continue
            if first is None and now:
                first = now
            moved = now != host.now
            if not simulated:
                host.now = now  # what follows is dated by it
            host.inject_bytes(topic, entry.data)
        except MessageError:  # a process refuses it, too
            continue
        if moved:
            host.tick(now)
            progress((now - (first or now)) / 1e9)
    host.close()


def _follow(
    stages: Stages,
    steps: dict[str, deque[Step]],
    inputs: Iterable[tuple[Topic, Entry]],
    write: Write,
    progress: Progress,
    say: Callable[[str], None],
) -> None:
    """A log of live processes: each stage takes what its journal says."""

    def made(topic: Topic, payload: bytes, now: int, stamp: int, sequence: int) -> None:
        write(topic, payload, now, stamp_in(payload, topic.type) or stamp, sequence)

    follower = Follower(stages, steps, made)
    first: int | None = None
    for topic, entry in inputs:
        first = entry.log_time if first is None else first
        write(topic, entry.data, entry.log_time, entry.publish_time, entry.sequence)
        follower.offer(topic, entry.data, entry.sequence, entry.publish_time, entry.log_time)
        progress((entry.log_time - first) / 1e9)
    follower.finish()
    for name, count in follower.missing.items():
        say(f"{count} messages that {name} took are not in the log: from there on its re-run may differ")
