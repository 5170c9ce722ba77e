"""Processes for work that consists of independent pieces.

Campaigns use the replaceable processes of ``processes`` instead.
"""

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

    The limit also applies to libraries that are imported later, in this process and in new processes.
    """
    for name in THREADS:
        os.environ.setdefault(name, "1")


@contextmanager
def pool(jobs: int, begin: Callable[[], None] | None = None) -> Iterator[ProcessPoolExecutor]:
    """Yield an executor of new processes, each limited to one thread.

    A process calls ``begin`` before its first task.  Any exception within the context ends the processes at
    once.  Ctrl-C interrupts only the caller's process, and the new processes ignore it.

    Args:
        jobs: The number of processes.
        begin: A function that prepares a process.  None means that no preparation is needed.

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
    """A process that ignores Ctrl-C as soon as it starts."""

    def start(self) -> None:
        """Start the process while Ctrl-C is blocked."""
        with deaf_children():
            super().start()


class InterruptImmuneContext(SpawnContext):
    """A multiprocessing context whose processes ignore Ctrl-C as soon as they start."""

    Process = InterruptImmuneProcess


def _begin(begin: Callable[[], None] | None) -> None:
    """Ignore Ctrl-C in this process from now on, and then call ``begin`` to prepare the process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if begin is not None:
        begin()
