"""`topic`."""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from rbtrg_robot.scope import NAMED, ROBOT
from rbtrg_robot.terminal import say, say_text

Robot = Annotated[str, typer.Option("--robot", envvar=NAMED, help="Name of the robot.")]
LogFile = Annotated[Path | None, typer.Option("--log", help="A log instead of the running stack.")]
Name = Annotated[str, typer.Argument(help="Of a topic.")]
Seconds = Annotated[float, typer.Option(help="How long to listen; else until Ctrl-C.")]

topic_app = typer.Typer(help="Look at topics, live or in a log.", no_args_is_help=True)


def register(app: typer.Typer) -> None:
    """Add the commands."""
    app.add_typer(topic_app, name="topic")


def _topic(name: str) -> Any:
    from rbtrg_robot import topics as t
    from rbtrg_robot.config import ConfigError

    found = t.BY_NAME.get(name if name.startswith("/") else f"/{name}")
    if found is None:
        raise ConfigError(f"there is no topic {name!r}; `rbtrg-robot topic list` shows them")
    return found


def _in_log(name: str, log: Path) -> str:
    """The name of a topic of a log, ours or not. Raises ConfigError."""
    from rbtrg_robot.config import ConfigError
    from rbtrg_robot.importer.bag import Bag

    held = {source.topic for source in Bag(log).sources}
    full = name if name in held or name.startswith("/") else f"/{name}"
    if full not in held:
        raise ConfigError(f"{full} is not in {log}; `rbtrg-robot topic list --log {log}` shows what is")
    return full


@topic_app.command("list")
def topic_list(log: LogFile = None) -> None:
    """All topics: type, rate, who publishes; or what a log holds."""
    from rbtrg_robot import topics as t

    if log is not None:
        from rbtrg_robot.importer.bag import Bag

        counts: Counter[tuple[str, str]] = Counter()
        for source in Bag(log).sources:  # of each file of a run
            counts[source.topic, source.type or source.encoding or "-"] += source.count
        for (name, kind), count in sorted(counts.items()):
            say(f"{name:28s} {kind:38s} {count:8d} messages")
        return
    for x in t.TOPICS:
        rate = f"{x.rate:g} Hz" if x.rate else "event"
        say(f"{x.name:28s} {x.type:38s} {rate:>7s} {x.owner or '-':10s} {x.doc}")


@topic_app.command("hz")
def topic_hz(name: Name, log: LogFile = None, seconds: Seconds = math.inf, robot: Robot = ROBOT) -> None:
    """Rate of a topic, a line every second."""
    for count, _, span in _counts(name, log, seconds, robot):
        say(f"{count / span:.2f} Hz")


@topic_app.command("bw")
def topic_bw(name: Name, log: LogFile = None, seconds: Seconds = math.inf, robot: Robot = ROBOT) -> None:
    """Bandwidth of a topic, a line every second."""
    for _, size, span in _counts(name, log, seconds, robot):
        say(f"{size / span / 1000:.1f} kB/s")


def _counts(name: str, log: Path | None, seconds: float, robot: str) -> Iterator[tuple[int, int, float]]:
    """Messages, bytes and the seconds they came in: once of a log, every second of a running stack."""
    if log is not None:
        from rbtrg_robot.log.stats import summarize

        found = summarize(log).topics.get(_in_log(name, log))
        if found is None:
            return
        yield found.count, found.bytes, found.count / found.rate if found.rate else math.inf
        return
    from rbtrg_robot.cli.link import connect

    wanted = _topic(name)
    with connect(robot) as bus:
        bus.subscribe([replace(wanted, depth=10_000)])
        last = began = time.monotonic()
        count = size = 0
        while last - began < seconds:
            for received in bus.take(0.1):
                count += 1
                size += len(received.payload)
            now = time.monotonic()
            if now - last >= 1.0:
                if not count:
                    say(f"{wanted.name} is silent", error=True)
                yield count, size, now - last
                last, count, size = now, 0, 0


@topic_app.command("echo")
def topic_echo(
    name: Name,
    log: LogFile = None,
    count: Annotated[int, typer.Option("--count", "-n", help="Stop after this many; 0 = never.")] = 0,
    robot: Robot = ROBOT,
) -> None:
    """Print messages of a topic."""
    from rbtrg_robot.cli.show import as_text

    shown = 0
    if log is not None:
        from rbtrg_robot.importer.bag import Bag, Decoder

        topic, decoder = _in_log(name, log), Decoder()
        bag = Bag(log)
        for source, _log_time, _stamp, data in bag.messages([topic]):
            message = decoder.decode(source, data)
            what = f"{len(data)} bytes of {source.type or '?'}, encoding {source.encoding or 'not told'}: not read here"
            say_text(f"{what if message is None else as_text(message)}\n---")
            shown += 1
            if count and shown >= count:
                return
        for words in bag.damage:
            say(f"damage: {words}", error=True)
        return
    from rbtrg_robot.cli.link import connect

    wanted = _topic(name)

    with connect(robot) as bus:
        bus.subscribe([wanted])
        while not count or shown < count:
            for received in bus.take(0.2):
                message = bus.open(received)
                say_text(f"{'(no message)' if message is None else as_text(message)}\n---")
                shown += 1
                if count and shown >= count:
                    return
