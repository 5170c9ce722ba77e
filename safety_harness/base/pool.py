"""Processes for work in independent pieces; campaigns have their own, replaceable ones in ``processes``."""

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

    This covers libraries that are imported later, here and in new processes.
    """
    for name in THREADS:
        os.environ.setdefault(name, "1")


@contextmanager
def pool(jobs: int, begin: Callable[[], None] | None = None) -> Iterator[ProcessPoolExecutor]:
    """Yield an executor of new processes with one thread each; each calls ``begin`` first.

    Any exception within the context ends them at once.  The first process answers Ctrl-C.

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
        """Start out of Ctrl-C's way."""
        with deaf_children():
            super().start()


class InterruptImmuneContext(SpawnContext):
    """The context that starts such processes."""

    Process = InterruptImmuneProcess


def _begin(begin: Callable[[], None] | None) -> None:
    """Ignore Ctrl-C, then prepare the process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if begin is not None:
        begin()
