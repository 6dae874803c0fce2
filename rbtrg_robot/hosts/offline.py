"""Run stages again on a log: no Zenoh, one process, deterministic. Same log, same code, same bytes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from rbtrg_robot import topics as t
from rbtrg_robot.config import ConfigError, load, of_log
from rbtrg_robot.hosts.lockstep import build_stages
from rbtrg_robot.hosts.sync import SyncHost
from rbtrg_robot.log.file import CONFIG, METADATA, LogWriter, first_of, read_run
from rbtrg_robot.processes import PROCESSES
from rbtrg_robot.topics import Topic
from rbtrg_robot.wire.messages import stamp_in


def rerun(
    log: Path,
    names: list[str],
    out: Path,
    *,
    file: Path | None = None,
    sets: Sequence[str] = (),
    progress: Callable[[float], None] = lambda _seconds: None,
    say: Callable[[str], None] = lambda _text: None,
) -> dict[str, int]:
    """Feed `log` through the named stages; write inputs and new outputs to `out`.

    The stages get the configuration the log was made with, changed by `file` (YAML) and `sets` (a.b=c). What they
    publish replaces what the log holds on those topics. `progress(seconds)` hears how much of the source clock is done,
    `say` what the operator should know. Returns messages per topic.
    Raises ConfigError for a name that is no stage or a configuration that does not hold, LogError.
    """
    possible = [p.name for p in PROCESSES if p.hosted]
    for name in names:
        if name not in possible:
            raise ConfigError(f"--rerun {name}: choose from {', '.join(possible)}")
    contents = first_of(log)
    base, unknown = of_log(contents.attachments.get(CONFIG, b""))
    if unknown:
        say(f"the log is of another version; left out of its configuration: {', '.join(unknown)}")
    config = load(file, sets, base=base)
    metadata = contents.metadata.get(METADATA, {}) | {"rerun": ",".join(names)}
    stages = build_stages(config, names)
    for stage, _period in stages.values():
        stage.warm_up()
    replaced = {topic for stage, _ in stages.values() for topic in stage.outputs}
    counts: dict[str, int] = {}
    sequence: dict[Topic, int] = {}
    with LogWriter(out, metadata, {CONFIG: config.to_yaml().encode()}) as writer:

        def sink(topic: Topic, payload: bytes, now: int) -> None:
            if topic.recorded:
                counts[topic.name] = counts.get(topic.name, 0) + 1
                sequence[topic] = sequence.get(topic, 0) + 1
                stamp = stamp_in(payload, topic.type) or now
                writer.write(topic, payload, now, stamp, sequence[topic])

        host = SyncHost(stages, sink)
        first: int | None = None
        for entry in read_run(log):
            topic = t.BY_NAME.get(entry.topic) or t.RENAMED.get(entry.topic)
            if topic is None or topic in replaced or topic is t.HEARTBEAT or entry.type != topic.type:
                continue
            if topic is t.CLOCK:
                now = stamp_in(entry.data, topic.type)
            else:
                now = host.now if config.simulated else entry.log_time
            if first is None and now:
                first = now
            host.inject_bytes(topic, entry.data)
            if now != host.now:
                host.tick(now)
                progress((now - (first or now)) / 1e9)
        host.close()
    return counts
