"""`log step`."""

from __future__ import annotations

import os
import signal
import socket
from pathlib import Path
from typing import Annotated

import typer

from rbtrg_robot.cli.logs import LogFile, log_app
from rbtrg_robot.terminal import say

USUAL = ("odometry", "elevation", "planner")
"""Stages that run again where none is named: those that the log does for."""


def register(app: typer.Typer) -> None:
    """Add the command to `log`, which `logs` adds to the app."""
    del app
    log_app.command("step")(log_step)


def log_step(
    run: LogFile,
    stage: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="Run it again; may be repeated. Default: what the log does for."),
    ] = None,
    config: Annotated[Path | None, typer.Option(help="YAML over the log's configuration.")] = None,
    set_: Annotated[list[str] | None, typer.Option("--set", metavar="A.B=C", help="One key over it.")] = None,
) -> None:
    """Run stages again step by step, in the browser. Look into them at any instant. Ends with Ctrl-C."""
    from rbtrg_robot.console.server import serving
    from rbtrg_robot.hosts.offline import config_of, fitting
    from rbtrg_robot.log.read import LogError, log_files
    from rbtrg_robot.process.runfiles import console_address, console_file
    from rbtrg_robot.scope import Scope
    from rbtrg_robot.wire.bus import Bus

    log_files(run)
    told = config_of(run, config, set_ or [], say)
    names: list[str] = list(stage or ())
    if not names:
        wrong: LogError | None = None
        for name in USUAL:
            try:
                fitting(run, [*names, name], told)
                names.append(name)
            except LogError as error:
                wrong = error
        if not names and wrong is not None:
            raise wrong
    own = f"step_{os.getpid()}"
    folder = run if run.is_dir() else run.parent
    console = told.console.model_copy(update={"address": "127.0.0.1", "webhooks": ()})
    told = told.model_copy(update={"robot": own, "log_dir": str(folder), "console": console})
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    stopped: list[int] = []
    for sign in (signal.SIGINT, signal.SIGTERM):
        signal.signal(sign, lambda number, _frame: stopped.append(number))
    try:
        with (
            Bus(f"tcp/127.0.0.1:{port}", "step", Scope.of(0, own), router=True) as bus,
            serving(told, bus, (run, names)) as serve,
        ):
            say(f"{run}: {', '.join(names)}; open {console_address(own)}")
            while not stopped and serve.worker.is_alive():
                serve.turn(bus)
    finally:
        console_file(own).unlink(missing_ok=True)
