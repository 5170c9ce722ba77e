"""One self-test from its faults to its files: each fault is written down when it is finished."""

from __future__ import annotations

import platform
import time
from collections.abc import Callable
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path

from safety_harness.compiled import source_hash
from safety_harness.exceptions import Place, SettingsError
from safety_harness.selftest.catalogue import EVERY
from safety_harness.selftest.document import SelfTestRun, write_document
from safety_harness.selftest.outcome import FaultOutcome
from safety_harness.selftest.page import write_page
from safety_harness.selftest.work import SelfTestPlan, outcomes, sound_remarks

PAGE, DATA = "selftest.html", "selftest.json"


@dataclass(eq=False)
class SelfTestSession:
    """The faults tried so far, of those with the ``numbers`` in EVERY.

    ``remarks`` are of the sound system, which is tried when this is made; ``broken`` says why the faults
    could not be carried through.  InputError for scenarios that cannot be used.
    """

    plan: SelfTestPlan
    numbers: list[int]
    out: Path
    command: str
    done: dict[str, FaultOutcome] = field(default_factory=dict)
    interrupted: bool = False
    broken: str = ""

    def __post_init__(self) -> None:
        suite = self.plan.suite()
        self.remarks, self._episodes = tuple(sound_remarks(suite)), len(suite.episodes)
        self._begun_s = time.monotonic()

    @property
    def tried(self) -> list[FaultOutcome]:
        """In the order of the catalogue."""
        return [self.done[EVERY[n].name] for n in self.numbers if EVERY[n].name in self.done]

    def run(self, jobs: int, on_fault: Callable[[FaultOutcome], None]) -> None:
        """Until all are tried, or Ctrl-C, or a defect.  OSError if nothing can be written."""
        found = outcomes(self.plan, self.numbers, jobs)
        try:
            while (one := next(found, None)) is not None:
                self.done[one.fault] = one
                on_fault(one)
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
        write_document(self.out / DATA, self.tried, self._about())

    def write_page(self) -> None:
        """The page.  Raises OSError."""
        write_page(self.out / PAGE, self.tried, self._about())

    def _about(self) -> SelfTestRun:
        return SelfTestRun(
            profile=self.plan.profile.name,
            avoider=self.plan.avoider,
            scenarios=str(self.plan.folder),
            episodes=self._episodes,
            planned=len(self.numbers),
            seconds=round(time.monotonic() - self._begun_s, 1),
            command=self.command,
            package_version=metadata.version("safety-harness"),
            source_hash=source_hash(),
            platform=f"Python {platform.python_version()}, {platform.system()} {platform.machine()}",
            generated_at=datetime.now(UTC),
            remarks=self.remarks,
            interrupted=len(self.done) < len(self.numbers),
        )


def numbers_of(words: str | None) -> list[int]:
    """Which of EVERY have these words in their name; SettingsError for none."""
    found = [n for n, one in enumerate(EVERY) if words is None or words.lower() in one.name.lower()]
    if not found:
        names = ", ".join(one.name for one in EVERY)
        raise SettingsError(
            place=Place(field="--fault"), expected=f"words of one of: {names}", got=repr(words)
        )
    return found
