"""A second process that compiles what a first run needs last, while the run compiles from the beginning."""

from __future__ import annotations

import atexit
import os
import subprocess
import sys
from contextlib import suppress
from dataclasses import dataclass
from threading import Thread

from safety_harness.base.compiling import Compilation

PROGRAM = "import sys; sys.path[:] = {path}; from safety_harness.report.compile_ahead import main; main()"

# The claim is the one whose machine code takes longest.
BRIEF_RUN = """
scenario: a brief run of each part
duration: 40 ms
tcp start:
  offset: [30 mm, -60 mm, 60 mm]
avoider: mc-dropout
hands:
  - hand: right hand
    starts at: [840 mm, -350 mm, 300 mm]
    elbow towards: [1600 mm, -1200 mm, 300 mm]
    moves: [{wait: 1 s}]
claims:
  hand distance never below 1 mm: holds
"""


@dataclass
class SecondProcess:
    """A watcher that starts the second process when this process compiles the first function of many.

    It starts none with a single processor, or where the cache has the code of a control cycle.  The process
    ends with this one.
    """

    _checked: bool = False

    def __call__(self, now: Compilation) -> None:
        """Start the process at the first call, if it can help; this method is one of the ``watchers``."""
        if not self._checked:
            self._checked = True
            if len(os.sched_getaffinity(0)) > 1 and sys.executable and not now.unwritable and _is_cold():
                _start()


def _is_cold() -> bool:
    """Return whether the cache lacks the code of a control cycle, which a run needs after much else."""
    from safety_harness.base.compiled import PACKAGE, cache_folder, installed_folder

    cycle = PACKAGE / "cell" / "controller" / "cycle.py"
    return not installed_folder(cycle).is_dir() and not any(cache_folder(cycle).rglob("*.nbc"))


def _start() -> subprocess.Popen[bytes] | None:
    """Start the second process, which ends with this one; None if the system refuses."""
    with suppress(OSError):
        process = subprocess.Popen(
            [sys.executable, "-c", PROGRAM.format(path=sys.path)],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        atexit.register(_end, process)
        return process
    return None


def _end(process: subprocess.Popen[bytes]) -> None:
    """End the second process."""
    process.kill()
    process.communicate()


def main() -> None:
    """Compile in this process what a brief run calls, the last call first, until the first process ends."""
    Thread(target=_end_with_parent, daemon=True).start()
    parent = os.getppid()
    from safety_harness.base.compile_lock import hold
    from safety_harness.base.compiled import cache_root, calls_of
    from safety_harness.report.run_job import run
    from safety_harness.scenario.read import parse_scenario

    if not hold(cache_root() / "second-process.lock", wait=False):
        return  # one second process is enough, as the first processes share its work
    for function, types in reversed(calls_of(lambda: run(parse_scenario(BRIEF_RUN)))):
        if os.getppid() != parent:  # another process may keep our input open
            return
        with suppress(Exception):
            function.compile(types)


def _end_with_parent() -> None:
    """End this process when its input ends, as it does with the process that started it."""
    os.read(0, 1)
    os._exit(0)
