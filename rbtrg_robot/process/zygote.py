"""A process that imports what all processes need once, then forks each of them on request.

Seven interpreters that each import numpy, numba and pydantic take seven times 1.2 s of CPU; a fork takes milliseconds
and shares the memory. The forked process becomes a child of the *supervisor* (it is a subreaper, PR_SET_CHILD_SUBREAPER in
prctl(2)), so that waiting for it and its parent-death signal work as if the supervisor had started it itself.
"""

from __future__ import annotations

import ctypes
import importlib
import json
import logging
import os
import select
import signal
import socket
import subprocess
import sys
from pathlib import Path
from typing import Any

from hal.errors import OperatorError

PR_SET_PDEATHSIG, PR_SET_NAME, PR_SET_CHILD_SUBREAPER = 1, 15, 36
PRELOAD = (
    "zenoh",
    "rbtrg_robot.config",
    "rbtrg_robot.hosts.live",
    "rbtrg_robot.stages.planner",
)
"""Nothing here may start a thread: a fork copies only the one that calls it."""
ONE_THREAD = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}


def prctl(option: int, argument: Any) -> None:
    """prctl(2); raises OSError."""
    if ctypes.CDLL(None, use_errno=True).prctl(option, argument, 0, 0, 0):
        raise OSError(ctypes.get_errno(), "prctl")


class Forked:
    """A forked process, a child of this one. The interface is that of `subprocess.Popen`."""

    def __init__(self, pid: int) -> None:
        self.pid = pid
        self.returncode: int | None = None
        """Exit status, or minus the signal that ended it; None while it runs."""
        self._descriptor = os.pidfd_open(pid)

    def poll(self) -> int | None:
        """`returncode`, brought up to date."""
        if self.returncode is None:
            pid, status = os.waitpid(self.pid, os.WNOHANG)
            if pid:
                self.returncode = os.waitstatus_to_exitcode(status)
                os.close(self._descriptor)
        return self.returncode

    def wait(self, timeout: float | None = None) -> int:
        """Until it has ended; `timeout` in s. Raises subprocess.TimeoutExpired."""
        if self.returncode is None:
            ended, _, _ = select.select([self._descriptor], [], [], timeout)
            if not ended:
                raise subprocess.TimeoutExpired(f"pid {self.pid}", timeout or 0.0)
        code = self.poll()
        assert code is not None  # its descriptor was readable
        return code

    def terminate(self) -> None:
        """SIGTERM, unless it has ended."""
        self._send(signal.SIGTERM)

    def kill(self) -> None:
        """SIGKILL, unless it has ended."""
        self._send(signal.SIGKILL)

    def _send(self, sign: signal.Signals) -> None:
        if self.poll() is None:
            signal.pidfd_send_signal(self._descriptor, sign)


class ZygoteError(OperatorError):
    """The process that forks the others does not answer."""


class Zygote:
    """The supervisor's end. Make it first thing: it imports while the caller goes on."""

    def __init__(self) -> None:
        prctl(PR_SET_CHILD_SUBREAPER, 1)
        self._start()

    def _start(self) -> None:
        self._socket, theirs = socket.socketpair()
        with theirs:
            self._popen = subprocess.Popen(
                [sys.executable, "-m", "rbtrg_robot.process.zygote", str(theirs.fileno()), str(os.getpid())],
                stdin=subprocess.DEVNULL,
                env={**ONE_THREAD, **os.environ},
                pass_fds=[theirs.fileno()],
                process_group=0,  # Ctrl-C reaches the supervisor only, which ends all in order
            )

    @property
    def pid(self) -> int:
        """Of the process that forks."""
        return self._popen.pid

    def fork(self, specification: dict[str, Any], log_path: Path) -> Forked:
        """Start one process (see `rbtrg_robot.process.child`), output to `log_path`. Raises ZygoteError, OSError."""
        log_path.touch()  # an unwritable folder fails here, with its name
        request = json.dumps({"specification": specification, "log_path": str(log_path)}).encode() + b"\n"
        pid = self._ask(request)
        if not pid:  # it was killed; the processes it forked live on
            self.__exit__()
            self._start()
            pid = self._ask(request)
        if not pid:
            raise ZygoteError("cannot start processes: the one that forks them ended, see the lines above")
        return Forked(int(pid))

    def _ask(self, request: bytes) -> bytes:
        """The answer; empty when there is nobody to give it."""
        try:
            self._socket.sendall(request)
            with self._socket.makefile("rb") as answers:
                return answers.readline()
        except OSError:  # closed at the other end
            return b""

    def __enter__(self) -> Zygote:
        return self

    def __exit__(self, *_: object) -> None:
        """End it; what it forked lives on."""
        self._socket.close()
        self._popen.kill()
        self._popen.wait()


def serve(link: socket.socket, supervisor: int) -> dict[str, Any] | None:
    """Fork on request. Returns a specification in each forked process, None in the zygote itself at its end."""
    requests = link.makefile("rb")
    while line := requests.readline():
        request = json.loads(line)
        pid_read, pid_write = os.pipe()
        go_read, go_write = os.pipe()
        between = os.fork()
        if not between:
            if os.fork():
                os._exit(0)  # which hands the new process over to the supervisor
            requests.close()
            link.close()
            os.close(go_write)
            os.close(pid_read)
            os.read(go_read, 1)  # until the handover is done
            os.close(go_read)
            _settle(request, supervisor)
            os.write(pid_write, f"{os.getpid()}\n".encode())
            os.close(pid_write)
            return dict(request["specification"])
        os.close(go_read)
        os.close(pid_write)
        os.waitpid(between, 0)
        os.close(go_write)
        pid = os.read(pid_read, 32)
        os.close(pid_read)
        if not pid:  # it failed and said why
            return None
        link.sendall(pid)
    return None


def _settle(request: dict[str, Any], supervisor: int) -> None:
    """Process group, name, output and fate of a forked process."""
    name = request["specification"]["process"]
    os.setpgid(0, 0)
    prctl(PR_SET_NAME, f"rbtrg-{name}".encode())
    output = os.open(request["log_path"], os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
    os.dup2(output, 1)
    os.dup2(output, 2)
    os.close(output)
    # These two end in order (stop the robot, index the log); the others have nothing to lose.
    prctl(PR_SET_PDEATHSIG, signal.SIGTERM if name in ("robot", "recorder") else signal.SIGKILL)
    if os.getppid() != supervisor:  # it ended before the line above
        os._exit(0)


def main() -> int:
    """Entry: the descriptor of the link and the supervisor's pid are the arguments."""
    link, supervisor = socket.socket(fileno=int(sys.argv[1])), int(sys.argv[2])
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    for module in PRELOAD:
        importlib.import_module(module)
    specification = serve(link, supervisor)
    if specification is None:
        return 0
    from rbtrg_robot.process import child

    code = child.run(specification)
    logging.shutdown()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)  # all is closed: to take the compiled kernels apart costs every process half a second


if __name__ == "__main__":
    sys.exit(main())
