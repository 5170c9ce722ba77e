"""Speed up the first run with a second process, which compiles the run's functions in reverse order.

Meanwhile, the run itself compiles them in their normal order.
"""

from __future__ import annotations

import atexit
import json
import os
import subprocess
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from itertools import chain
from pathlib import Path
from select import select
from threading import Thread
from typing import TYPE_CHECKING

from safety_harness.base.compiling import Compilation
from safety_harness.base.exceptions import SafetyHarnessError

if TYPE_CHECKING:
    from safety_harness.report.run_result import RunResult

PROGRAM = "import sys; sys.path[:] = {path}; from safety_harness.report.compile_ahead import main; main()"

# The claim is the one whose machine code takes longest.
_SHORT = """
scenario: a brief run of each part
duration: 40 ms
tcp start:
  offset: [30 mm, -60 mm, 60 mm]
claims:
  hand distance never below 1 mm: holds
"""
_PLACE = """
    starts at: [840 mm, -350 mm, 300 mm]
    elbow towards: [1600 mm, -1200 mm, 300 mm]
    moves: [{wait: 1 s}]
"""
BRIEF_RUN = f"""{_SHORT}
avoider: mc-dropout
hands:
  - hand: right hand{_PLACE}
"""
# Machine code depends on the number of joints, and on whether there are more than two hands.
SEVEN_JOINTS = f"""{_SHORT}
avoider: opposite pose
robot: shipped:panda
settings:
  cell:
    desired tcp position: [500 mm, 0 mm, 250 mm]
    preferred joint position: [0 deg, 0 deg, 0 deg, -135 deg, 0 deg, 130 deg, 45 deg]
object:
  position: [500 mm, 45 mm, -300 mm]
hands:
  - hand: right hand{_PLACE}
"""
THREE_HANDS = f"""{_SHORT}
avoider: opposite pose
hands:
  - hand: right hand{_PLACE}
  - hand: left hand{_PLACE}
  - hand: second right hand{_PLACE}
"""


@dataclass
class SecondProcess:
    """A watcher that starts the second process at the first compilation in this process.

    The watcher starts no process if the cache already has the code of a control cycle. On a computer with a
    single processor, the second process compiles no functions and only lists the functions that a run needs.
    The second process ends when this process ends.
    """

    _checked: bool = False
    _process: subprocess.Popen[str] | None = None
    _needed: list[Path] | None = None  # the cache files that a brief run needs; None until they are known

    def __call__(self, now: Compilation) -> None:
        """Start the second process at the first compilation, unless the cache cannot be written.

        The list ``watchers`` contains this object, so that each compilation calls this method.
        """
        if not now.unwritable:
            self.start_if_cold()

    def start_if_cold(self) -> None:
        """Start the process at the first call, unless the cache already has the code of a control cycle."""
        if not self._checked:
            self._checked = True
            if sys.executable and _is_cold():
                self._process = _start()

    def finished_part(self) -> tuple[int, int] | None:
        """Return how many functions of a brief run are in the cache, and how many functions the run needs.

        The result is None if the functions are not known yet.
        """
        if self._process is not None and self._needed is None:
            self._needed = _needed_by(self._process)
        if self._needed is None:
            return None
        return sum(file.exists() for file in self._needed), len(self._needed)


def _needed_by(process: subprocess.Popen[str]) -> list[Path] | None:
    """Return the files that the second process lists in its first line, or None if the line is incomplete."""
    assert process.stdout is not None
    # Do not wait: the progress display asks again later.
    ready, _, _ = select([process.stdout], [], [], 0.0)
    line = process.stdout.readline() if ready else ""
    whole = line.endswith("\n")  # the process may have ended within the line
    return [Path(file) for file in json.loads(line)] if whole else None


def _is_cold() -> bool:
    """Return whether the cache lacks the code of a control cycle.

    A run compiles this code late, after most other functions.
    """
    from safety_harness.base.compiled import PACKAGE, cache_folder, installed_folder

    cycle = PACKAGE / "cell" / "controller" / "cycle.py"
    return not installed_folder(cycle).is_dir() and not any(cache_folder(cycle).rglob("*.nbc"))


def _start() -> subprocess.Popen[str] | None:
    """Start and return the second process, or return None if the system refuses to start it.

    The second process ends when this process ends.
    """
    with suppress(OSError):
        process = subprocess.Popen(
            [sys.executable, "-c", PROGRAM.format(path=sys.path)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
        )
        atexit.register(_end, process)
        return process
    return None


def _end(process: subprocess.Popen[str]) -> None:
    """End the second process."""
    process.kill()
    process.wait()


def main() -> None:
    """Print the cache files of a brief run, then compile the functions of this run and of further runs.

    The process ends when its parent process ends. The functions of each run are compiled in reverse order of
    their calls, because the parent process compiles them in their normal order.
    """
    Thread(target=_end_with_parent, daemon=True).start()
    parent = os.getppid()
    from safety_harness.base.compile_lock import hold
    from safety_harness.base.compiled import cache_root
    from safety_harness.base.interpreted import cache_indexes, calls_of

    results: list[RunResult] = []
    calls = calls_of(lambda: results.append(_run(BRIEF_RUN)))
    needed = [str(file) for file in cache_indexes(function for function, _ in calls)]
    sys.stdout.write(json.dumps(needed) + "\n")
    sys.stdout.flush()
    one_is_enough = not hold(cache_root() / "second-process.lock", wait=False)  # it works for all processes
    if one_is_enough or len(os.sched_getaffinity(0)) == 1:
        return
    further: tuple[Callable[[], object], ...] = (
        partial(_judge_all, results),
        partial(_run, SEVEN_JOINTS),
        partial(_run, THREE_HANDS),
    )
    for part in chain([calls], map(calls_of, further)):
        for function, types in reversed(part):
            if os.getppid() != parent:  # another process may keep our input open
                return
            with suppress(Exception):
                function.compile(types)


def _run(text: str) -> RunResult:
    """Run a scenario that is given as text."""
    from safety_harness.report.run_job import run
    from safety_harness.scenario.read import parse_scenario

    return run(parse_scenario(text))


def _judge_all(results: Sequence[RunResult]) -> None:
    """Judge the runs of some results by all claims of the catalogue."""
    from safety_harness.claims.properties.catalogue import CATALOGUE

    for judged in (run for result in results for run in result.runs):
        for entry in CATALOGUE:
            with suppress(SafetyHarnessError):
                entry.prop.evaluate(judged.trace)


def _end_with_parent() -> None:
    """End this process when its input closes, which happens when the parent process ends."""
    os.read(0, 1)
    os._exit(0)
