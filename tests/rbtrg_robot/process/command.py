"""Commands of `rbtrg-robot` beside a live stack: what starts, stops or moves as a process, what only asks in this
process."""

from __future__ import annotations

import contextlib
import io
import os
import subprocess
import sys
from pathlib import Path
from unittest import mock

from rbtrg_robot.cli.main import main

HERE = ("status", "mission", "resume")
"""Asked again and again: a process of its own costs most of a second of CPU time each."""
SPARSE = ("--set", "sim.lidar_step=8")
"""For `up`: every eighth firing is enough on flat ground, and leaves the processor to what else is tested."""


def command(folder: Path, *arguments: str, limit: float = 200.0) -> subprocess.CompletedProcess[str]:
    """The command in the runtime folder `folder`; a process gets `limit` [s]."""
    if arguments[0] not in HERE:
        return subprocess.run(
            [sys.executable, "-m", "rbtrg_robot.cli", *arguments],
            capture_output=True,
            text=True,
            env={**os.environ, "XDG_RUNTIME_DIR": str(folder)},
            timeout=limit,
            check=False,
        )
    code: object = 0
    out, err = io.StringIO(), io.StringIO()
    with (
        mock.patch.dict(os.environ, XDG_RUNTIME_DIR=str(folder), COLUMNS="200"),
        mock.patch.object(sys, "argv", ["rbtrg-robot", *arguments]),
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
    ):
        try:
            main()
        except SystemExit as ended:
            code = ended.code
    assert code is None or isinstance(code, int)
    return subprocess.CompletedProcess(arguments, code or 0, out.getvalue(), err.getvalue())
