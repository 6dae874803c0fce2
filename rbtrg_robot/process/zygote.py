"""A process that imports what all processes need once, then forks each of them on request.

Seven interpreters that each import numpy, numba and pydantic take seven times 1.2 s of CPU; a fork takes milliseconds
and shares the memory. `up` shares it as well: it imports, then forks the zygote. The forked process becomes a child of
the *supervisor* (it is a subreaper, PR_SET_CHILD_SUBREAPER in prctl(2)), so that waiting for it and its parent-death
signal work as if the supervisor had started it itself.

Why not the forkserver of `multiprocessing`: its processes remain children of the forkserver (tried with Python 3.11).
When that is killed, each of them is reported as ended with status 255 while it goes on; when it is stopped,
`Process.start` never returns and the end of a process is not seen. Here a zygote that is killed or stopped is replaced,
and what it forked is watched all the time.
"""

from __future__ import annotations

import contextlib
import ctypes
import gc
import importlib
import json
import logging
import os
import select
import signal
import socket
import subprocess
import sys
import time
import traceback
from pathlib import Path
from typing import Any, BinaryIO, NoReturn

from hal.errors import OperatorError
from rbtrg_robot.terminal import say

log = logging.getLogger(__name__)

PR_SET_PDEATHSIG, PR_SET_NAME, PR_SET_CHILD_SUBREAPER = 1, 15, 36
M_ARENA_MAX = -8
"""mallopt(3) of glibc."""
PRELOAD = (
    "zenoh",
    "rbtrg_robot.config",
    "rbtrg_robot.hosts.live",
    "rbtrg_robot.stages.planner",
)
"""Nothing here may start a thread: a fork copies only the one that calls it."""
START_LIMIT = 60.0
"""Longest wait [s] for the first answer, which comes after the imports."""
ANSWER_LIMIT = 5.0
"""Longest wait [s] for the others. A fork takes milliseconds; the supervisor watches nothing meanwhile."""
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
    """The supervisor's end."""

    def __init__(self, *, share: bool = False) -> None:
        """`share`: import here and fork, so that this process shares its memory with the others. It must not have
        imported numpy, nor have a second thread. Otherwise a new interpreter imports while the caller goes on."""
        prctl(PR_SET_CHILD_SUBREAPER, 1)
        if share:
            for name, value in ONE_THREAD.items():
                os.environ.setdefault(name, value)
            preload()
        self._start(share=share)

    def _start(self, *, share: bool = False) -> None:
        self._socket, theirs = socket.socketpair()
        self._socket.settimeout(START_LIMIT)
        self._asked = 0.0
        with theirs:
            self._process = _shared(theirs, self._socket) if share else _alone(theirs)

    @property
    def pid(self) -> int:
        """Of the process that forks."""
        return self._process.pid

    def fork(self, specification: dict[str, Any], log_path: Path) -> Forked:
        """Start one process (see `rbtrg_robot.process.child`), output to `log_path`. Bounded in time. Raises
        ZygoteError."""
        request = json.dumps({"specification": specification, "log_path": str(log_path)}).encode() + b"\n"
        pid = self._ask(request)
        if not pid:  # it was killed or stopped; the processes it forked live on
            self.__exit__()
            with contextlib.suppress(OSError):  # no memory, no process number
                self._start()
                pid = self._ask(request)
        if not pid:
            raise ZygoteError(
                "cannot start processes: the one that forks them ended or is stopped, see the lines above"
            )
        self._socket.settimeout(ANSWER_LIMIT)
        return Forked(int(pid))

    def _ask(self, request: bytes) -> bytes:
        """The answer; empty when there is nobody to give it in time."""
        try:
            self._socket.sendall(request)
            with self._socket.makefile("rb") as answers:
                if self._asked:
                    answers.readline()
                    self._asked = 0.0
                return answers.readline()
        except OSError:  # closed at the other end, or TimeoutError
            return b""

    def _answers(self) -> bool:
        """Whether it lives and says so within ANSWER_LIMIT; START_LIMIT as long as it imports. Waits for nothing."""
        if self._process.poll() is not None:
            return False
        limit = self._socket.gettimeout() or ANSWER_LIMIT
        try:
            if not self._asked:
                self._socket.sendall(b"\n")
                self._asked = time.monotonic()
            elif select.select([self._socket], [], [], 0.0)[0]:
                self._asked = 0.0
                self._socket.settimeout(ANSWER_LIMIT)
                return bool(self._socket.recv(1))
            return not self._asked or time.monotonic() - self._asked < limit
        except OSError:  # closed at the other end
            return False

    def mend(self) -> bool:
        """Replace it if it has ended or hangs, before somebody must wait for the imports of a new one. Returns whether
        it was; call it again."""
        if self._answers():
            return False
        self.__exit__()
        try:
            self._start()
        except OSError as error:
            log.warning("the process that starts the others cannot be started: %s", error.strerror)
            return False
        return True

    def reap(self, known: set[int]) -> None:
        """Collect ended processes that nobody waits for: what a killed process leaves becomes a child of this
        subreaper.

        On hardware that is the guardian of a killed robot process. `known`: processes that somebody polls.
        """
        with contextlib.suppress(ChildProcessError):  # there is no child at all
            # An ended process among `known` hides those behind it until it has been polled.
            while (
                ended := os.waitid(os.P_ALL, 0, os.WEXITED | os.WNOHANG | os.WNOWAIT)
            ) is not None and ended.si_pid not in known | {self.pid}:
                os.waitpid(ended.si_pid, 0)

    def __enter__(self) -> Zygote:
        return self

    def __exit__(self, *_: object) -> None:
        """End it; what it forked lives on."""
        self._socket.close()
        self._process.kill()
        self._process.wait()


def _alone(link: socket.socket) -> subprocess.Popen[bytes]:
    """A zygote in an interpreter of its own."""
    return subprocess.Popen(
        [sys.executable, "-m", "rbtrg_robot.process.zygote", str(link.fileno()), str(os.getpid())],
        stdin=subprocess.DEVNULL,
        env={**ONE_THREAD, **os.environ},
        pass_fds=[link.fileno()],
        process_group=0,  # Ctrl-C reaches the supervisor only, which ends all in order
    )


def _shared(link: socket.socket, ours: socket.socket) -> Forked:
    """A zygote with the imports of this process."""
    supervisor = os.getpid()
    sys.stdout.flush()
    sys.stderr.flush()
    if pid := os.fork():
        return Forked(pid)
    ours.close()
    os.setpgid(0, 0)
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    work(link, supervisor)


def serve(link: socket.socket, supervisor: int) -> dict[str, Any] | None:
    """Fork on request. Returns a specification in each forked process, None in the zygote itself at its end."""
    requests = link.makefile("rb")
    while line := _next(requests):
        if not line.strip():  # whether somebody is here
            with contextlib.suppress(BrokenPipeError):  # the next read is the end
                link.sendall(line)
            continue
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
            _go_on(go_read)  # the supervisor is its parent
            _settle(request, supervisor)
            with contextlib.suppress(BrokenPipeError):
                os.write(pid_write, f"{os.getpid()}\n".encode())
            os.close(pid_write)
            _go_on(go_read)  # the supervisor knows of it
            os.close(go_read)
            return dict(request["specification"])
        os.close(go_read)
        os.close(pid_write)
        os.waitpid(between, 0)
        with contextlib.suppress(BrokenPipeError):  # it was killed already; who waits for it will see that
            os.write(go_write, b".")
            pid = os.read(pid_read, 32)
            if not pid:
                return None
            link.sendall(pid)
            os.write(go_write, b".")
        os.close(pid_read)
        os.close(go_write)
    return None


def _next(requests: BinaryIO) -> bytes:
    """One line; empty at the end, also of a link that was closed before its last answer was read."""
    try:
        return requests.readline()
    except ConnectionResetError:
        return b""


def _go_on(signal_read: int) -> None:
    """Wait for the zygote's word. A process whose zygote ended before announcing it ends too, or it would run twice."""
    if not os.read(signal_read, 1):
        os._exit(0)


def _settle(request: dict[str, Any], supervisor: int) -> None:
    """Process group, name, output and fate of a forked process."""
    name = request["specification"]["process"]
    os.setpgid(0, 0)
    prctl(PR_SET_NAME, f"rbtrg-{name}".encode())
    log_path = Path(request["log_path"])
    try:
        # Somebody removed it while the stack ran.
        log_path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        output = os.open(log_path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o600)
        os.dup2(output, 1)
        os.dup2(output, 2)
        os.close(output)
    except OSError as error:  # to run is more than to be logged
        say(f"{name}: cannot write {log_path}: {error.strerror}; its output comes here", error=True)
    # These two end in order (stop the robot, index the log); the others have nothing to lose.
    prctl(PR_SET_PDEATHSIG, signal.SIGTERM if name in ("robot", "recorder") else signal.SIGKILL)
    if os.getppid() != supervisor:  # it ended before the line above
        os._exit(0)


def preload() -> None:
    """What every process needs. The first kernel that is loaded makes numba import half of itself and scipy's linear
    algebra: 0.6 s of CPU time, in each process at each start, before it is ready."""
    for module in PRELOAD:
        importlib.import_module(module)
    from numba.core.registry import cpu_target

    cpu_target.typing_context.refresh()
    cpu_target.target_context.refresh()
    # Eight threads of Zenoh in each process would take memory from eight places, and leave room in each.
    if mallopt := getattr(ctypes.CDLL(None), "mallopt", None):
        mallopt(M_ARENA_MAX, 2)
    # A collection writes to every object that it looks at: each forked process would have its own copy of all of them.
    gc.collect()
    gc.freeze()


def work(link: socket.socket, supervisor: int) -> NoReturn:
    """The life of a zygote, and of what it forks. Never returns: the stack below may be the supervisor's."""
    code = 1
    try:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
        specification = serve(link, supervisor)
        if specification is None:
            os._exit(0)
        from rbtrg_robot.process import child

        code = child.run(specification)
    except BaseException:  # noqa: BLE001  there is nobody above
        traceback.print_exc()
    logging.shutdown()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)  # all is closed: to take the compiled kernels apart costs every process half a second


def main() -> NoReturn:
    """Entry: the descriptor of the link and the supervisor's pid are the arguments."""
    link, supervisor = socket.socket(fileno=int(sys.argv[1])), int(sys.argv[2])
    prctl(PR_SET_PDEATHSIG, signal.SIGKILL)  # it may end while this one imports
    preload()
    work(link, supervisor)


if __name__ == "__main__":
    main()
