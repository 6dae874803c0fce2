"""Tests of runs from a file: expectations over a log, over stages run on it again, or over simulated drives; every
combination of settings."""

from __future__ import annotations

import itertools
import json
import math
import time
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, model_validator

from hal.errors import OperatorError
from rbtrg_robot import topics as t
from rbtrg_robot import yaml_file
from rbtrg_robot.config import StackConfig, load
from rbtrg_robot.hosts.lockstep import Lockstep, LockstepTimeout
from rbtrg_robot.hosts.offline import Window, config_of, feed, fitting, stages_for
from rbtrg_robot.log.expect import Expectation, ExpectError, Judge, Verdict, understand
from rbtrg_robot.log.read import CONFIG, METADATA, LogContents, first_of, log_files, read_run
from rbtrg_robot.log.summary import overview
from rbtrg_robot.log.trajectory import FORMATS, Trajectory, of_run, read
from rbtrg_robot.log.write import LogWriter
from rbtrg_robot.topics import Topic
from rbtrg_robot.yaml_file import YamlError

MOST_CASES = 1000


class LogTestError(OperatorError):
    """A test file is wrong; the message names the place."""


class _Model(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, populate_by_name=True)


def _many(value: Any) -> Any:
    """One stands for a list of one."""
    return [value] if isinstance(value, str) else value


Names = Annotated[tuple[str, ...], BeforeValidator(_many)]


class Drive(_Model):
    """A simulated drive in lockstep."""

    scene: str = Field(description="built-in scene or terrain file")
    goals: tuple[str | tuple[float, float], ...] = Field(
        min_length=1, description="named goals of the scene, or x, y [m] in `map`, one after the other"
    )
    timeout: float = Field(120.0, gt=0, le=86400, description="a goal is given up after this long [s]")


class LogTest(_Model):
    """A test file. Paths are relative to it."""

    run: Names = Field((), description="logs or folders of runs")
    rerun: Names = Field((), description="stages that run on them again before they are judged")
    drive: Drive | None = None
    set: dict[str, Any] = Field({}, description="configuration of re-run or drive, `a.b: value`")
    sweep: dict[str, Annotated[tuple[Any, ...], Field(min_length=1)]] = Field(
        {}, description="values of keys; every combination is a case"
    )
    against: str = Field("", description="the right trajectory: a run, or a TUM or KITTI file")
    expect: tuple[str, ...] = Field(alias="assert", min_length=1, description="one line each")

    @model_validator(mode="after")
    def _something_to_judge(self) -> LogTest:
        if self.drive is not None and (self.run or self.rerun):
            raise ValueError("`drive` makes its own runs: not with `run` or `rerun`")
        if (self.sweep or self.set) and not (self.rerun or self.drive):
            raise ValueError("`set` and `sweep` change nothing without `rerun` or `drive`")
        if twice := self.sweep.keys() & self.set.keys():
            raise ValueError(f"{min(twice)} stands in `set` and in `sweep`")
        cases = math.prod(map(len, self.sweep.values())) * max(len(self.run), 1)
        if cases > MOST_CASES:
            raise ValueError(f"{cases} cases are more than {MOST_CASES}")
        return self


@dataclass(frozen=True, slots=True)
class Case:
    """One run that is judged."""

    name: str
    log: Path | None
    """None: a simulated drive."""
    config: StackConfig | None
    """None: the log is judged as it is."""


@dataclass(frozen=True, slots=True)
class Result:
    """What came of a case."""

    case: str
    verdicts: list[Verdict]
    notes: list[str]
    error: str
    """Why there was nothing to judge."""
    wall: float
    """[s] it took."""

    @property
    def holds(self) -> bool:
        """Every line does."""
        return not self.error and all(verdict.holds for verdict in self.verdicts)


class Suite:
    """The cases of a file, checked before the first of them runs."""

    def __init__(self, file: Path, runs: tuple[Path, ...] = ()) -> None:
        """`runs` take the place of those of the file. Raises LogTestError, ConfigError, LogError."""
        self._file = file
        self.test = _load(file)
        if runs and self.test.drive is not None:
            raise LogTestError(f"{file} drives by itself: name no run with it")
        beside = file.parent
        logs: list[Path | None] = [*(runs or [beside / run for run in self.test.run])]
        if self.test.drive is not None:
            logs = [None]
        if not logs:
            raise LogTestError(f"{file} names no `run`: `rbtrg-robot log test {file} RUN`, or a `drive`")
        self._expectations: list[Expectation] = []
        for number, text in enumerate(self.test.expect, 1):
            try:
                self._expectations.append(understand(text))
            except ExpectError as error:
                raise LogTestError(f"{file}: assert {number}: {error}") from error
        self._reference = self._right(beside)
        self.cases = [
            self._case(log, values, len(logs) > 1)
            for log in logs
            for values in itertools.product(*self.test.sweep.values())
        ]

    def _right(self, beside: Path) -> Trajectory | None:
        if not self.test.against:
            return None
        path = beside / self.test.against
        return read(path) if path.is_file() and path.suffix.lower() in FORMATS else of_run(path)

    def _case(self, log: Path | None, values: tuple[Any, ...], named: bool) -> Case:
        swept = dict(zip(self.test.sweep, values, strict=True))
        words = [log.name] if named and log is not None else []
        words += [f"{key}={json.dumps(value).strip(chr(34))}" for key, value in swept.items()]
        name = " ".join(words) or (log.name if log is not None else self._file.stem)
        sets = [f"{key}={json.dumps(value, default=str)}" for key, value in (self.test.set | swept).items()]
        if self.test.drive is not None:
            config = load(None, sets, scene=self._scene(self.test.drive.scene))
            known = config.load_scene().goals
            for goal in self.test.drive.goals:
                if isinstance(goal, str) and goal not in known:
                    raise LogTestError(
                        f"{self._file}: {config.scene} has no goal {goal!r}; it has {', '.join(known)}"
                    )
            return Case(name, None, config)
        assert log is not None
        if not self.test.rerun:
            log_files(log)  # says now that there is none
            return Case(name, log, None)
        config = config_of(log, None, sets)
        fitting(log, list(self.test.rerun), config)
        return Case(name, log, config)

    def _scene(self, scene: str) -> str:
        beside = self._file.parent / scene
        return str(beside) if beside.is_file() else scene

    def run(self, keep: Path | None = None) -> Iterator[Result]:
        """Every case, one after the other; `keep`: folder for the logs of re-runs and drives."""
        for number, case in enumerate(self.cases, 1):
            began = time.monotonic()
            judge = Judge(self._expectations, self._reference)
            notes: list[str] = []
            error = ""
            try:
                if case.log is None:
                    self._drive(case, judge, notes, _kept(keep, number, case))
                elif case.config is None:
                    _read(case.log, judge, notes)
                else:
                    self._rerun(case.log, case.config, judge, notes, _kept(keep, number, case))
            except (OperatorError, LockstepTimeout) as failed:
                error = str(failed)
            if judge.broken:
                notes.append(f"{judge.broken} messages could not be read")
            verdicts = [] if error else judge.verdicts()
            yield Result(case.name, verdicts, notes, error, time.monotonic() - began)

    def _rerun(
        self, log: Path, config: StackConfig, judge: Judge, notes: list[str], out: Path | None
    ) -> None:
        names = list(self.test.rerun)
        stages = stages_for(log, names, config)
        within = Window(overview(log).begin)
        first: int | None = None
        with ExitStack() as stack:
            metadata = first_of(log).metadata.get(METADATA, {}) | {"rerun": ",".join(names)}
            kept = (
                stack.enter_context(LogWriter(out, metadata, {CONFIG: config.to_yaml().encode()}))
                if out is not None
                else None
            )

            def write(topic: Topic, payload: bytes, now: int, stamp: int, sequence: int) -> None:
                nonlocal first
                first = now if first is None else first
                judge.take(topic, payload, (now - first) / 1e9)
                if kept is not None and topic.recorded:
                    kept.write(topic, payload, now, stamp, sequence)

            feed(log, stages, config, write, within, say=notes.append)

    def _drive(self, case: Case, judge: Judge, notes: list[str], out: Path | None) -> None:
        config, drive = case.config, self.test.drive
        assert config is not None
        assert drive is not None
        log = Lockstep.open_log(config, out) if out is not None else None
        with Lockstep(config, log) as stack:
            stack.host.listen(lambda topic, payload, now: judge.take(topic, payload, now / 1e9), judge.topics)
            stack.wait_ready()
            goals = config.load_scene().goals
            for goal in drive.goals:
                x, y, yaw = goals[goal] if isinstance(goal, str) else (*goal, None)
                stack.send_goal(x, y, yaw)
                stack.step()
                try:
                    stack.finish_goal(drive.timeout)
                except LockstepTimeout as late:
                    notes.append(f"goal {goal}: {late}")


def _kept(folder: Path | None, number: int, case: Case) -> Path | None:
    if folder is None:
        return None
    plain = "".join(c if c.isalnum() or c in "._=-" else "_" for c in case.name)[:100]
    return folder / f"{number:03d}_{plain}.mcap"


def _read(log: Path, judge: Judge, notes: list[str]) -> None:
    """A log as it is."""
    contents = LogContents()
    first: int | None = None
    for entry in read_run(log, contents):
        first = entry.log_time if first is None else first
        topic = t.BY_NAME.get(entry.topic)
        if topic is not None and entry.type == topic.type:
            judge.take(topic, entry.data, (entry.log_time - first) / 1e9)
    if contents.damage:
        notes.append(f"the log ends {contents.damage}: what came later is not judged")


def _load(file: Path) -> LogTest:
    try:
        values = yaml_file.read(file)
    except OSError as error:
        raise LogTestError(f"cannot read {file}: {error.strerror}") from error
    except YamlError as error:
        raise LogTestError(f"{file} is not YAML: {error}") from error
    if not isinstance(values, dict):
        raise LogTestError(f"{file} is no test: it must hold `key: value` lines, `assert` among them")
    try:
        return LogTest.model_validate(values)
    except ValidationError as error:
        raise LogTestError(f"{file}: {_explain(error)}") from error


def _explain(error: ValidationError) -> str:
    first = min(error.errors(), key=lambda one: one["type"] != "extra_forbidden")
    place = ".".join(str(part) for part in first["loc"])
    more = f" (and {error.error_count() - 1} more)" if error.error_count() > 1 else ""
    if first["type"] == "extra_forbidden":
        known = ", ".join(f.alias or name for name, f in LogTest.model_fields.items())
        return f"there is no key {place!r}; a test has {known}{more}"
    words = first["msg"].removeprefix("Value error, ")
    return f"{place}: {words}{more}" if place else f"{words}{more}"
