"""Processes for work in independent pieces; campaigns use the replaceable processes of ``processes``."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing.context import SpawnContext, SpawnProcess

from safety_harness.base.interrupts import deaf_children

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


def one_thread_each() -> None:
    """Limit numerical libraries to one thread, unless the environment already sets a number.

    The limit also applies to libraries that are imported later, here and in new processes.
    """
    for name in THREADS:
        os.environ.setdefault(name, "1")


@contextmanager
def pool(jobs: int, begin: Callable[[], None] | None = None) -> Iterator[ProcessPoolExecutor]:
    """Yield an executor of new processes with one thread each, which call ``begin`` first.

    Any exception within the context ends the processes at once.  Only the process of the caller reacts to
    Ctrl-C.

    Args:
        jobs: The number of processes.
        begin: Prepares a process; None: no preparation.

    """
    one_thread_each()
    with ProcessPoolExecutor(
        jobs, mp_context=InterruptImmuneContext(), initializer=_begin, initargs=(begin,)
    ) as executor:
        try:
            yield executor
        except BaseException:
            executor.shutdown(wait=False, cancel_futures=True)
            for process in list((executor._processes or {}).values()):
                process.terminate()
            raise


class InterruptImmuneProcess(SpawnProcess):
    """A process that ignores Ctrl-C from its start."""

    def start(self) -> None:
        """Start the process while Ctrl-C is blocked."""
        with deaf_children():
            super().start()


class InterruptImmuneContext(SpawnContext):
    """The context whose processes ignore Ctrl-C from their start."""

    Process = InterruptImmuneProcess


def _begin(begin: Callable[[], None] | None) -> None:
    """Ignore Ctrl-C in this process, and then prepare the process with ``begin``."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if begin is not None:
        begin()
