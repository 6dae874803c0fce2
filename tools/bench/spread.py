"""Independent trials of a bench, in this process or on a dask cluster."""

from __future__ import annotations

import logging
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import ExitStack, contextmanager, suppress
from itertools import islice
from multiprocessing import resource_tracker
from typing import TYPE_CHECKING, Any

from hal.errors import OperatorError

if TYPE_CHECKING:
    from distributed import Future

TRIALS_AHEAD = 64
"""Trials handed to the cluster at a time: their arguments need not all be in its memory."""
Result = dict[str, Any]


class TrialsFailed(OperatorError):
    """Some trials raised or killed their workers again and again. All others are done."""


class SchedulerLost(OperatorError):
    """The cluster's scheduler is gone, and with it what its workers were at. Nothing that was yielded is lost."""


@contextmanager
def shielded() -> Iterator[None]:
    """Ctrl-C waits until the end. Processes that are started in here never hear it: this one ends them, and they write
    no traceback."""
    resource_tracker.ensure_running()  # it lets the signal through as it starts
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def spread(
    function: Callable[..., Result], trials: Sequence[tuple[Any, ...]], workers: int, scheduler: str = ""
) -> Iterator[Result]:
    """`function(*trial)` of every trial, in the order in which they finish.

    `workers`: processes on this machine, 0 for this process; `scheduler`: address of a cluster to use instead. A trial
    whose worker
    dies is given to another worker. What a trial raises is raised when all others are done (TrialsFailed), in this
    process at once.
    A scheduler that dies and is not back at its address within dask's time to connect (30 s) ends it (SchedulerLost).
    """
    if not trials:
        return
    if workers == 0 and not scheduler:
        for trial in trials:
            yield function(*trial)
        return
    from distributed import Client, LocalCluster, as_completed

    failed: list[str] = []
    with ExitStack() as stack:
        with shielded():
            place = (
                scheduler
                or stack.enter_context(
                    LocalCluster(
                        n_workers=workers,
                        threads_per_worker=1,
                        host="127.0.0.1",
                        dashboard_address="127.0.0.1:0",  # of several benches each has its own
                        silence_logs=logging.CRITICAL,  # what fails is raised here; workers that are ended write pages
                    )
                )
            )
        client = stack.enter_context(Client(place))
        left = iter(trials)
        first = [client.submit(function, *t, pure=False) for t in islice(left, TRIALS_AHEAD)]
        queue = as_completed(first)
        for future in queue:
            result = _outcome(future, scheduler)
            if isinstance(result, BaseException):
                failed.append(f"{type(result).__name__}: {result}")
            else:
                yield result
            future.release()
            following = next(left, None)
            if following is not None:
                queue.add(client.submit(function, *following, pure=False))
    if failed:
        raise TrialsFailed(f"{len(failed)} of {len(trials)} trials failed, the first with {failed[0]}")


def _outcome(future: Future[Result], scheduler: str) -> Result | BaseException:
    """What a finished trial gave or raised; SchedulerLost where nobody knows any more."""
    from distributed.comm.core import CommClosedError

    outcome: Result | BaseException | None = None
    with suppress(CommClosedError, CancelledError):  # the scheduler died while it was asked
        if future.status == "finished":
            outcome = future.result()
        elif future.status == "error":
            outcome = future.exception()
    if outcome is None:
        raise SchedulerLost(
            f"the scheduler {scheduler} is gone: start it and its workers, then give the same command again; "
            "what is done is kept"
        )
    return outcome
