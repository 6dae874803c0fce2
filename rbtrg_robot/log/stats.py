"""Statistics of a log: counts, rates, gaps, losses."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from rbtrg_robot.log.read import METADATA, Entry, LogContents, is_being_written, log_files, read_log
from rbtrg_robot.topics import BY_NAME


@dataclass(slots=True)
class TopicStatistics:
    """One topic of a log; times in seconds of the source clock."""

    type: str
    count: int = 0
    bytes: int = 0
    first: int = 0
    last: int = 0
    longest_gap: float = 0.0
    sequence: int = 0
    missing: int = 0
    """Messages the publisher sent but the log does not hold."""
    backwards: int = 0

    @property
    def rate(self) -> float:
        """Mean rate [Hz]."""
        span = (self.last - self.first) / 1e9
        return (self.count - 1) / span if span > 0 else 0.0

    def add(self, entry: Entry) -> None:
        """Take one message into account."""
        stamp = entry.publish_time
        if self.count:
            gap = (stamp - self.last) / 1e9
            self.longest_gap = max(self.longest_gap, gap)
            known = BY_NAME.get(entry.topic)
            whole = known is None or not known.thinned
            self.backwards += whole and gap < 0
            # Where several publish, their sequences interleave.
            if whole and known is not None and known.alone and entry.sequence > self.sequence + 1:
                self.missing += entry.sequence - self.sequence - 1
        else:
            self.first = stamp
        self.sequence = entry.sequence
        self.last = max(self.last, stamp) if self.count else stamp
        self.count += 1
        self.bytes += len(entry.data)


@dataclass(slots=True)
class LogSummary:
    """A run in figures."""

    files: list[str]
    metadata: dict[str, str]
    topics: dict[str, TopicStatistics]
    damage: list[str]
    unfinished: list[str]
    """Files that are being written: their end is no damage."""
    wall_seconds: float

    def problems(self) -> list[str]:
        """Problems for `log check`."""
        found = list(self.damage)
        for name, s in sorted(self.topics.items()):
            topic = BY_NAME.get(name)
            if s.missing:
                found.append(f"{name}: {s.missing} of {s.count + s.missing} messages are missing")
            if s.backwards and (topic is None or topic.alone):
                found.append(f"{name}: stamps go backwards {s.backwards} times")
            if topic and topic.rate and name != "/heartbeat" and s.longest_gap > max(10 / topic.rate, 0.5):
                found.append(f"{name}: silent for {s.longest_gap:.2f} s (nominal {topic.rate:g} Hz)")
            if topic and topic.type != s.type:
                found.append(f"{name}: type {s.type}, expected {topic.type}")
        return found


def summarize(path: Path) -> LogSummary:
    """One pass over a run. Raises LogError."""
    topics: dict[str, TopicStatistics] = {}
    damage: list[str] = []
    unfinished: list[str] = []
    metadata: dict[str, str] = {}
    first = last = 0
    files = log_files(path)
    for file in files:
        contents = LogContents()
        for entry, _schema, _channel in read_log(file, contents):
            topics.setdefault(entry.topic, TopicStatistics(entry.type)).add(entry)
            first = first or entry.log_time
            last = max(last, entry.log_time)
        if is_being_written(file):
            unfinished.append(file.name)
        elif contents.damage:
            damage.append(f"{file.name} ends {contents.damage}; `rbtrg-robot log recover` repairs it")
        elif not contents.indexed:
            damage.append(f"{file.name} has no index")
        metadata = metadata or contents.metadata.get(METADATA, {})
    return LogSummary([f.name for f in files], metadata, topics, damage, unfinished, (last - first) / 1e9)
