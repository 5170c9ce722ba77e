"""``safety-harness selftest``: faults seeded into a sound system, and what caught each of them."""

from __future__ import annotations

import platform
import shlex
import time
from collections.abc import Callable
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path

from safety_harness.cli.console import AS_EXPECTED, BAD_INPUT, DIFFERS, INTERRUPTED, explain, result, say
from safety_harness.compiled import source_hash
from safety_harness.exceptions import InputError, OutputError, Place, SettingsError
from safety_harness.selftest.catalogue import EVERY
from safety_harness.selftest.document import SelfTestRun, write_document
from safety_harness.selftest.outcome import FaultOutcome, FaultState, tally_of
from safety_harness.selftest.page import write_page
from safety_harness.selftest.profile import profile_named
from safety_harness.selftest.table import (
    HARMLESS_HEAD,
    HEAD,
    bad,
    harmless_row,
    in_table,
    lines,
    row,
    summary,
)
from safety_harness.selftest.work import SelfTestPlan, outcomes, sound_remarks

PAGE, DATA = "selftest.html", "selftest.json"


def selftest(
    *,
    scenarios: Path = Path("scenarios"),
    profile: str = "quick",
    avoider: str | None = None,
    fault: str | None = None,
    out: Path = Path("reports/selftest"),
    jobs: int = 2,
) -> int:
    """Try every fault (those with ``fault`` in their name), print the kill table, write page and JSON.

    Exit code 0; 1: a fault survives that is no stated limit, a harmless change raises a false alarm, no fault
    applies, or it could not be carried through; 2: bad input; 130 after Ctrl-C.  What was tried is printed
    and written whatever happens, the JSON after each fault.
    """
    try:
        plan = SelfTestPlan(profile_named(profile), scenarios, avoider)
        numbers = _numbers(fault, jobs)
        say("reading and trying the sound system")
        suite = plan.suite()
        remarks = sound_remarks(suite)
    except InputError as error:
        explain(error)
        return BAD_INPUT
    except KeyboardInterrupt:
        say("interrupted before anything was tried")
        return INTERRUPTED
    for remark in remarks:
        say(remark)

    def about(seconds: float, interrupted: bool) -> SelfTestRun:
        return SelfTestRun(
            profile=plan.profile.name,
            avoider=avoider,
            scenarios=str(scenarios),
            episodes=len(suite.episodes),
            planned=len(numbers),
            seconds=round(seconds, 1),
            command=_command(scenarios, profile, avoider, fault, out, jobs),
            package_version=metadata.version("safety-harness"),
            source_hash=source_hash(),
            platform=f"Python {platform.python_version()}, {platform.system()} {platform.machine()}",
            generated_at=datetime.now(UTC),
            remarks=tuple(remarks),
            interrupted=interrupted,
        )

    session = _Session(numbers, out, about)
    try:
        session.run(plan, jobs)
        return session.finish()
    except OSError as error:
        explain(OutputError.of(out, error))
        return BAD_INPUT


def _numbers(words: str | None, jobs: int) -> list[int]:
    """Which of EVERY are asked for."""
    if jobs < 1:
        raise SettingsError(place=Place(field="--jobs"), expected="a number of at least 1", got=str(jobs))
    found = [n for n, one in enumerate(EVERY) if words is None or words.lower() in one.name.lower()]
    if not found:
        names = ", ".join(one.name for one in EVERY)
        raise SettingsError(
            place=Place(field="--fault"), expected=f"words of one of: {names}", got=repr(words)
        )
    return found


def _command(
    scenarios: Path, profile: str, avoider: str | None, fault: str | None, out: Path, jobs: int
) -> str:
    command = ["safety-harness", "selftest", "--profile", profile, "--scenarios", str(scenarios)]
    command += ["--avoider", avoider] if avoider is not None else []
    command += ["--fault", fault] if fault is not None else []
    return shlex.join([*command, "--out", str(out), "--jobs", str(jobs)])


@dataclass(eq=False)
class _Session:
    """The faults tried so far; each is written down when it is finished, whatever happens to the rest."""

    numbers: list[int]
    out: Path
    about: Callable[[float, bool], SelfTestRun]
    done: dict[str, FaultOutcome] = field(default_factory=dict)
    interrupted: bool = False
    broken: str = ""
    begun_s: float = field(default_factory=time.monotonic)

    @property
    def tried(self) -> list[FaultOutcome]:
        """In the order of the catalogue."""
        return [self.done[EVERY[n].name] for n in self.numbers if EVERY[n].name in self.done]

    def run(self, plan: SelfTestPlan, jobs: int) -> None:
        """Until all are tried, or Ctrl-C, or a defect.  OSError if nothing can be written."""
        found = outcomes(plan, self.numbers, jobs)
        try:
            while (one := next(found, None)) is not None:
                self.done[one.fault] = one
                say(f"[{len(self.done)}/{len(self.numbers)}] {one.part}: {one.fault}: {_words(one)}")
                self.write()
        except KeyboardInterrupt:
            self.interrupted = True
        except BrokenProcessPool:
            self.broken = "a process ended before its time (for its memory, or by hand)"
        except OSError:
            raise
        except Exception as error:  # what was tried must not be lost for it
            self.broken = f"{type(error).__name__}: {error}, a defect of safety-harness"

    def write(self) -> None:
        """JSON of what there is.  Raises OSError."""
        unfinished = len(self.done) < len(self.numbers)
        write_document(self.out / DATA, self.tried, self.about(time.monotonic() - self.begun_s, unfinished))

    def finish(self) -> int:
        """Print, write; returns the exit code.  Raises OSError."""
        tried = self.tried
        faults, harmless = in_table(tried)
        for head, rows in (
            (HEAD, [row(o) for o in faults]),
            (HARMLESS_HEAD, [harmless_row(o) for o in harmless]),
        ):
            for line in lines(head, rows):
                result(line)
            result("")
        result(summary(tally_of(tried)))
        self.write()
        unfinished = len(tried) < len(self.numbers)
        write_page(self.out / PAGE, tried, self.about(time.monotonic() - self.begun_s, unfinished))
        say(f"page: {self.out / PAGE} (for programs: {DATA})")
        if self.interrupted:
            say(f"interrupted: {len(tried)} of {len(self.numbers)} were tried")
            return INTERRUPTED
        if self.broken:
            say(f"error: {self.broken}; {len(tried)} of {len(self.numbers)} were tried")
            return DIFFERS
        if not any(one.applies for one in tried):
            say("error: nothing was tried: none of these faults applies to such an avoider")
            return DIFFERS
        return DIFFERS if bad(tried) else AS_EXPECTED


def _words(one: FaultOutcome) -> str:
    alarm, smallest = one.alarm, one.smallest
    if one.state is FaultState.CAUGHT and alarm and smallest:
        return f"caught down to {smallest.words}, by {alarm.claim} in {alarm.scenario}"
    return one.state.value
