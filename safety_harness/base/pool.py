"""Processes for work in independent pieces.  A campaign's own, which are replaced, are in ``processes``."""

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
    """Libraries that are imported from now on, here and in new processes, take one thread unless told so."""
    for name in THREADS:
        os.environ.setdefault(name, "1")


@contextmanager
def pool(jobs: int, begin: Callable[[], None] | None = None) -> Iterator[ProcessPoolExecutor]:
    """New processes of one thread each, which call ``begin`` first.

    Whatever is raised within ends them at once.  Ctrl-C is for the first process to answer.
    """
    one_thread_each()
    with ProcessPoolExecutor(jobs, mp_context=_Deaf(), initializer=_begin, initargs=(begin,)) as executor:
        try:
            yield executor
        except BaseException:
            executor.shutdown(wait=False, cancel_futures=True)
            for process in list((executor._processes or {}).values()):
                process.terminate()
            raise


class _DeafProcess(SpawnProcess):
    def start(self) -> None:
        """Out of Ctrl-C's way."""
        with deaf_children():
            super().start()


class _Deaf(SpawnContext):
    Process = _DeafProcess


def _begin(begin: Callable[[], None] | None) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if begin is not None:
        begin()
