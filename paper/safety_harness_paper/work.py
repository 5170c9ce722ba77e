"""Measurements that are kept: each is a task, done once, and found again by what made it.

A task's key is a hash over its function, its arguments, the keys of the tasks it needs and the source of
every file of this package and of the harness that its function's module imports, directly or not (but for
this file and ``scale``, which decide what is done and not what comes out): a result of other code or other
numbers is never taken for this one.  Its folder holds what it left (a network, a checkpoint) and, as the last
thing written, ``result.json``.  So an interruption costs what was under way, and a training not even that: it
goes on from its checkpoint.
"""

from __future__ import annotations

import hashlib
import inspect
import json
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field
from functools import cached_property, lru_cache, partial
from pathlib import Path
from typing import Any

from safety_harness.base.compiled import sources_of
from safety_harness.base.exceptions import InputError, OutputError
from safety_harness.base.pool import pool
from safety_harness.base.whole_file import write_whole

RESULT = "result.json"
HEARTBEAT_S = 60.0  # of a step that takes long

Json = dict[str, Any]


@dataclass(frozen=True)
class Done:
    """A finished task: where it left its files, and its result."""

    folder: Path
    result: Json


@dataclass(frozen=True)
class Task:
    """``function(folder, *needs, **arguments)`` -> JSON; a function of a module, as processes share it.

    ``seconds`` is about what it takes on one core, for progress; ``alone``: its times are what is measured.
    """

    label: str
    function: Callable[..., Json]
    arguments: tuple[tuple[str, Any], ...] = ()
    needs: tuple[Task, ...] = ()
    seconds: float = 1.0
    alone: bool = field(default=False, compare=False)

    @cached_property
    def key(self) -> str:
        """Sixteen hex digits that stand for everything that the result depends on."""
        digest = hashlib.sha256()
        module = Path(inspect.getfile(self.function))
        digest.update(f"{self.function.__module__}.{self.function.__qualname__}".encode())
        digest.update(_source(module).encode())
        digest.update(repr(self.arguments).encode())
        for need in self.needs:
            digest.update(need.key.encode())
        return digest.hexdigest()[:16]

    @property
    def folder_name(self) -> str:
        """Readable, and different for different keys."""
        words = "".join(c if c.isalnum() else "-" for c in self.label.lower()).strip("-")
        return f"{words}-{self.key}"


@lru_cache
def _source(module: Path) -> str:
    here = Path(__file__)
    digest = hashlib.sha256()
    for path in sorted(sources_of(module, without=frozenset({here, here.with_name("scale.py")}))):
        digest.update(path.read_bytes())
    return digest.hexdigest()


def in_order(tasks: Iterable[Task]) -> list[Task]:
    """Every task once, each after what it needs."""
    ordered: dict[Task, None] = {}

    def add(task: Task) -> None:
        for need in task.needs:
            add(need)
        ordered.setdefault(task)

    for task in tasks:
        add(task)
    return list(ordered)


@dataclass
class Workshop:
    """Does tasks in up to ``jobs`` processes and keeps their results below ``folder``.

    ``failed`` are those that raised, or that need one which did, and why: the others are done all the same.
    """

    folder: Path
    jobs: int
    say: Callable[[str], None]
    tell: Callable[[str], None] | None = None  # where it is, which a log needs few of; None: as ``say``
    failed: dict[Task, str] = field(default_factory=dict)
    _begun_s: float = field(default_factory=time.monotonic)
    _measured_s: float = 0.0  # of the tasks done in this session, by their own estimates

    def run(self, tasks: Sequence[Task]) -> dict[Task, Done]:
        """The results of ``tasks`` and of all that they need; KeyboardInterrupt passes through.

        OutputError if the folder cannot be written.
        """
        ordered = in_order(tasks)
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise OutputError.from_os_error(self.folder, error) from error
        done = {task: found for task in ordered if (found := self.kept(task)) is not None}
        left = [task for task in ordered if task not in done]
        if done:
            self.say(f"{len(done)} of {len(ordered)} steps are there already")
        if self.jobs <= 1:
            for task in left:
                self._finish(task, partial(self._here, task, done), done, left)
        else:
            shared = [task for task in left if not task.alone]
            self._in_processes(shared, done, left)
            self._in_processes([task for task in left if task.alone], done, left, at_once=1)
        return done

    def kept(self, task: Task) -> Done | None:
        """The result of an earlier session, if there is one that can be read."""
        folder = self.folder / task.folder_name
        try:
            found = json.loads((folder / RESULT).read_text("utf-8"))
        except (OSError, ValueError, RecursionError):
            return None
        return Done(folder, found) if isinstance(found, dict) else None

    def _here(self, task: Task, done: Mapping[Task, Done]) -> Done:
        return _do(task, self._done_needs(task, done), self.folder)

    def _done_needs(self, task: Task, done: Mapping[Task, Done]) -> tuple[Done, ...]:
        return tuple(done[need] for need in task.needs)

    def _finish(
        self, task: Task, result: Callable[[], Done], done: dict[Task, Done], left: Sequence[Task]
    ) -> None:
        lost = next((need for need in task.needs if need in self.failed), None)
        if lost is not None:
            self.failed[task] = f"it needs {lost.label!r}, which failed"
            return
        try:
            done[task] = result()
        except (OutputError, BrokenProcessPool):
            raise
        except Exception as error:  # what one step costs must not cost the others
            what = str(error) if isinstance(error, InputError) else f"{type(error).__name__}: {error}"
            self.failed[task] = what
            self.say(f"error: {task.label}: {what}")
            return
        self._measured_s += task.seconds
        rest_s = sum(one.seconds for one in left if one not in done and one not in self.failed)
        minutes = rest_s * (time.monotonic() - self._begun_s) / max(self._measured_s, 1e-9) / 60.0
        finished = sum(one in done for one in left)
        share = 1.0 - rest_s / max(sum(one.seconds for one in left), 1e-9)
        self._tell(f"[{finished}/{len(left)}] {task.label}; {100 * share:.0f} %, some {minutes:.0f} min left")

    def _tell(self, words: str) -> None:
        (self.tell or self.say)(words)

    def _in_processes(
        self, tasks: Sequence[Task], done: dict[Task, Done], left: Sequence[Task], at_once: int | None = None
    ) -> None:
        """Each as soon as what it needs is there, in the given order otherwise."""
        if not tasks:
            return
        jobs = at_once or self.jobs
        waiting, running = list(tasks), dict[Future[Done], Task]()
        with pool(jobs) as processes:
            try:
                while waiting or running:
                    for task in list(waiting):
                        if len(running) >= jobs:
                            break
                        if any(need in self.failed for need in task.needs):
                            waiting.remove(task)
                            self._finish(task, _never, done, left)
                        elif all(need in done for need in task.needs):
                            needs = self._done_needs(task, done)
                            running[processes.submit(_do, task, needs, self.folder)] = task
                            waiting.remove(task)
                    if not running:
                        continue
                    finished = wait(running, timeout=HEARTBEAT_S, return_when=FIRST_COMPLETED).done
                    if not finished:
                        self._tell("under way: " + ", ".join(task.label for task in running.values()))
                    for future in finished:
                        self._finish(running[future], future.result, done, left)
                        del running[future]
            except BrokenProcessPool:  # one was killed: for its memory, or by hand
                for task in (*running.values(), *waiting):
                    self.failed.setdefault(task, "a process ended before its time; ask for the same again")


def _never() -> Done:
    raise AssertionError("a task that needs a failed one is not asked")


def _do(task: Task, needs: tuple[Done, ...], root: Path) -> Done:
    """Do one task and keep its result; OutputError where it cannot be written."""
    folder = root / task.folder_name
    try:
        folder.mkdir(parents=True, exist_ok=True)
        found = task.function(folder, *needs, **dict(task.arguments))
        text = json.dumps(found, allow_nan=False)
        write_whole(folder / RESULT, text + "\n")
    except OSError as error:
        raise OutputError.from_os_error(folder, error) from error
    return Done(folder, json.loads(text))
