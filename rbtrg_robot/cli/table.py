"""The status table, and the screen of `up`: one table in a terminal, plain lines otherwise."""

from __future__ import annotations

import contextlib
import time
from types import TracebackType
from typing import Any, Self

from rich.console import Console, Group
from rich.live import Live
from rich.table import Table
from rich.text import Text

from rbtrg_robot.orders.words import goal_line, mission_line, robot_line
from rbtrg_robot.terminal import plain, plain_all, say

REFRESH_PERIOD = 0.5
TELL_PERIOD = 15.0
"""[s] between two words on a start where no screen shows it all the time."""
VERDICTS = {True: Text("ok", style="green"), False: Text("bad", style="red"), None: Text("-")}
"""Of a topic's rate; None before it can be told."""


def render(status: dict[str, Any], *, topics: bool = False) -> Group:
    """Processes, robot and what is wrong (or all topics)."""
    status = plain_all(status)
    processes = Table(box=None, pad_edge=False)
    for title in ("process", "pid", "state", "restarts", "CPU %", "MB", "beat"):
        processes.add_column(title, justify="left" if title in ("process", "state") else "right")
    for row in status["processes"]:
        good = row["state"] == "ready"
        age = row["heartbeat_age"]
        processes.add_row(
            Text(row["process"]),
            str(row["pid"] or "-"),
            Text(row["state"], style="green" if good else "yellow"),
            str(row["restarts"]),
            f"{row['cpu']:.0f}",
            f"{row['memory_mb']:.0f}",
            "-" if age is None else f"{age:.1f} s",
        )
    told = [
        Text(f"{row['process']}: {row['detail']}", "yellow")
        for row in status["processes"]
        if row.get("detail")
    ]
    parts: list[Any] = [processes, *told, Text(robot_line(status["robot"])), Text(goal_line(status["robot"]))]
    if waits := _waits(status):
        parts.insert(0, Text(waits, "yellow"))
    if words := mission_line(status["robot"]):
        parts.append(Text(words))
    parts += [
        Text(f"what to do: {remedy}", "yellow") for remedy in status["robot"].get("advice", {}).values()
    ]
    if backend := status["robot"].get("backend"):
        parts.append(Text("backend: " + ", ".join(f"{name} {value}" for name, value in backend.items())))
    refused = {row["process"]: row["refused"] for row in status["processes"]}
    refused["supervisor"] = status["refused"]
    if any(refused.values()):
        counts = ", ".join(f"{name} {count}" for name, count in refused.items() if count)
        parts.append(Text(f"messages refused: {counts}", style="yellow"))
    shown = [row for row in status["topics"] if row["nominal"] and (topics or row["ok"] is False)]
    if shown:
        table = Table(box=None, pad_edge=False)
        for title in ("topic", "rate", "nominal", "age", ""):
            table.add_column(title, justify="left" if title == "topic" else "right")
        for row in shown:
            age = row["age"]
            table.add_row(
                Text(row["topic"]),
                f"{row['rate']:.1f}",
                f"{row['nominal']:g}",
                "-" if age is None else f"{age:.2f} s",
                VERDICTS[row["ok"]],
            )
        parts.append(table)
    return Group(*parts)


def _waits(status: dict[str, Any]) -> str:
    """What a start waits for; empty once the stack was ready."""
    lacks = status.get("lacks")
    return "; ".join(filter(None, (status.get("compiling"), lacks and f"not ready: {lacks}")))


def plain_console() -> Console:
    """A file or a pipe is as wide as a line is long."""
    console = Console()
    return console if console.is_terminal else Console(width=10_000)


def fleet(statuses: dict[str, dict[str, Any] | None]) -> Table:
    """One row for each robot of this computer; None where its supervisor does not answer."""
    table = Table(box=None, pad_edge=False)
    for title in ("robot", "processes", "state"):
        table.add_column(title)
    for name, status in statuses.items():
        if status is None:
            table.add_row(Text(plain(name)), "-", Text("the supervisor does not answer", style="red"))
            continue
        rows = status["processes"]
        ready = sum(row["state"] == "ready" for row in rows)
        style = "green" if ready == len(rows) else "yellow"
        lines = [robot_line(status["robot"]), goal_line(status["robot"]), mission_line(status["robot"])]
        told = "\n".join(plain(line) for line in lines if line)
        table.add_row(Text(plain(name)), Text(f"{ready}/{len(rows)} ready", style=style), Text(told))
    return table


class Screen:
    """What `up` shows. A terminal that is gone and a file on a full disk take no words: the robot drives on without
    them."""

    def __init__(self) -> None:
        self._console = Console()
        self._live = Live(console=self._console, auto_refresh=False, transient=True)
        self._rich = self._console.is_terminal
        self._due = 0.0 if self._rich else time.monotonic() + TELL_PERIOD

    def say(self, line: str) -> None:
        """An event."""
        with contextlib.suppress(OSError):
            if self._rich:
                self._console.print(Text.assemble((time.strftime("%H:%M:%S "), "dim"), plain(line)))
            else:
                say(line)

    def show(self, status: dict[str, Any]) -> None:
        """The table, twice a second; elsewhere now and then what the start waits for."""
        now = time.monotonic()
        if now < self._due:
            return
        if self._rich:
            self._due = now + REFRESH_PERIOD
            with contextlib.suppress(OSError):
                self._live.update(render(status), refresh=True)
        elif waits := _waits(status):
            self._due = now + TELL_PERIOD
            self.say(waits)

    def __enter__(self) -> Self:
        if self._rich:
            self._live.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with contextlib.suppress(OSError):
            self._live.stop()
