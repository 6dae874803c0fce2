"""The first use of a command on a machine compiles kernels for a minute: it says so."""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable

LOOK_PERIOD = 1.0
"""[s] from look to look."""


def tell_once(say: Callable[[str], object], ended: threading.Event | None = None) -> threading.Thread:
    """A thread that says once, by `say`, that this command compiles kernels.

    It ends then, with the program, or when `ended` is set. Commands that never import numba pay nothing.
    """
    ended = ended or threading.Event()

    def watch() -> None:
        while "numba" not in sys.modules:
            if ended.wait(LOOK_PERIOD):
                return
        from rbtrg_robot.process.kernels import Compiling

        compiling = Compiling()
        while not compiling.done:
            if ended.wait(LOOK_PERIOD):
                return
        say("compiling kernels for this machine, once: this takes a minute or two")

    thread = threading.Thread(target=watch, name="first use", daemon=True)
    thread.start()
    return thread
