"""Everything this package raises on purpose: one tree, and every error carries its data.

``SafetyHarnessError`` is the root.  Two branches matter to a caller:

* ``InputError``: the user can mend it.  It says where (file, line, field), what was expected
  and what came; the command line prints it without a traceback and ends with exit code 2.
* ``SimulationError``: the run itself could not be carried on.  It is never counted as safe.
"""

from __future__ import annotations

import difflib
import re
import traceback
from collections.abc import Iterable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Self


class SafetyHarnessError(Exception):
    """The root of every error that this package raises on purpose."""


MOST_CHARACTERS = 1_500  # of what came, in a message
MOST_WORDS = 1_000  # characters of a user's


def on_one_line(text: str) -> str:
    """A text that may be a stranger's, without what would break a line or command a terminal."""
    return text if text.isprintable() else "".join(c if c.isprintable() else "?" for c in text)


def printable(text: str) -> str:
    """A user's words on one line, at most ``MOST_WORDS`` characters, without the addresses of objects."""
    return on_one_line(re.sub(r"0x[0-9a-fA-F]+", "0x...", " ".join(text[:MOST_WORDS].split())))


def described(error: BaseException, file: str | None = None) -> str:
    """What a user's code raised, on one line: "ZeroDivisionError: division by zero (mine.py:12)".

    ``file`` is the user's file, as in the traceback; the line is the deepest one within it.
    Addresses of objects are left out, so that a run says the same when it is repeated.
    """
    try:
        text = str(error)
    except Exception:  # a user's own exception may fail to say what it is
        text = ""
    what = printable(text)
    lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == file]
    if isinstance(error, SyntaxError) and error.filename == file:
        lines, what = [error.lineno], printable(error.msg)  # its own text names the place, once more
    where = f" ({Path(file).name}:{lines[-1]})" if file and lines else ""
    return type(error).__name__ + (f": {what}" if what else "") + where


@dataclass(frozen=True)
class Place:
    """Where in the user's input something stands; unknown parts are ``None``.

    A field alone is an option or argument of a command or a function.
    """

    file: Path | None = None
    line: int | None = None
    field: str | None = None

    def __str__(self) -> str:
        if self.file is None and self.line is None and self.field:
            return on_one_line(self.field)
        where = str(self.file) if self.file is not None else "<input>"
        if self.line is not None:
            where += f":{self.line}"
        return on_one_line(where + (f": {self.field}" if self.field else ""))


class InputError(SafetyHarnessError):
    """The user's input cannot be used as it stands.

    Parameters: ``expected`` and ``got`` complete the sentences "expected ..." and "got ...";
    ``hint`` is one more line of help (a near-miss suggestion, the list of what is allowed).  Each is
    put on one line, and ``got`` is cut where it is longer than anybody reads.
    """

    def __init__(self, *, place: Place, expected: str, got: str, hint: str = "") -> None:
        self.place = place
        self.expected = on_one_line(expected)
        self.got = on_one_line(got if len(got) <= MOST_CHARACTERS else got[:MOST_CHARACTERS] + "...")
        self.hint = on_one_line(hint)
        text = f"{place}: expected {self.expected}; got {self.got}"
        super().__init__(text + (f" ({self.hint})" if self.hint else ""))

    @classmethod
    def of_option(cls, option: str, expected: str, got: str, hint: str = "") -> Self:
        """The error of an option or argument of a command or a function."""
        return cls(place=Place(field=option), expected=expected, got=got, hint=hint)

    @classmethod
    def of_file(cls, file: Path | None, expected: str, got: str, hint: str = "") -> Self:
        """The error of a file as a whole."""
        return cls(place=Place(file=file), expected=expected, got=got, hint=hint)

    def __reduce__(self) -> tuple[partial[InputError], tuple[()]]:
        """On its way between processes: exceptions with keywords are not pickled by themselves."""
        make = partial(type(self), place=self.place, expected=self.expected, got=self.got, hint=self.hint)
        return make, ()


def near_miss(word: str, allowed: Iterable[str], *, most: int = 1, all_of_them: str = "") -> str:
    """``did you mean "..."?`` with at most ``most`` of ``allowed`` that resemble ``word``, else nothing.

    ``all_of_them`` is the command that lists what is allowed: it is told whatever resembles.
    """
    by_lower = {name.lower(): name for name in allowed}
    close = difflib.get_close_matches(word.lower(), by_lower, n=most, cutoff=0.5)
    names = " or ".join(f'"{by_lower[name]}"' for name in close)
    meant = f"did you mean {names}?" if word and close else ""
    return f"{meant} all of them: {all_of_them}".strip() if all_of_them else meant


_MADE_BY = {  # of what a caller hands on: where it comes from
    "Scenario": "read_scenario(path) reads one",
    "ScenarioSpace": "read_space(path) reads one",
    "Trace": "load_trace(path) reads one, run_trial(admitted) makes one",
    "Admitted": "admit(scenario) makes one",
}


def refuse_other_type(argument: str, value: object, *kinds: type, expected: str = "", hint: str = "") -> None:
    """InputError unless the ``argument`` of a function is of one of the ``kinds``, ``expected`` in words."""
    if not isinstance(value, kinds):
        name, got = kinds[0].__name__, f"{type(value).__name__} {value!r}"
        got = got if len(got) <= 80 else got[:77] + "..."
        raise InputError.of_option(argument, expected or f"a {name}", got, hint or _MADE_BY.get(name, ""))


def no_truth_value(asked: str) -> InputError:
    """The error for ``assert judge(trace)`` and its like, which would pass whatever came out."""
    hint = "assert_holds(claim, trace), or evaluation.verdict is Verdict.HOLDS"
    return InputError.of_option("truth value", "a question that a verdict answers", asked, hint)


def explanation(error: BaseException) -> str:
    """The error for people: where, what was expected, what came and the hint, each on a line of its own.

    That a package is missing is one line.
    """
    if not isinstance(error, InputError) or isinstance(error, MissingPackageError):
        return str(error)
    lines = [str(error.place), f"  expected {error.expected}", f"  got      {error.got}"]
    return "\n".join([*lines, f"  hint     {error.hint}"] if error.hint else lines)


class ScenarioError(InputError):
    """A scenario file is malformed, or a value in it is impossible."""


class RecordingError(InputError):
    """A recorded motion cannot be used: no time column, a gap or a jump too large, no samples."""


class LogError(InputError):
    """The log of a cell cannot be used as it stands: out of order, faster than it can be, damaged, ..."""


class StreamError(InputError):
    """A line of a stream that a monitor cannot use, or not all of it."""


class InadmissibleError(InputError):
    """A well-formed scenario that cannot be tried: start out of reach, object out of view, ..."""


class FormulaError(InputError):
    """A temporal formula cannot be written, or asked of a scenario, like that."""


class SettingsError(InputError):
    """A setting has an impossible value."""


class TraceError(InputError):
    """A stored trace is missing, truncated, of another version or not a trace at all."""


class OutputError(InputError):
    """A folder or file that results should go to cannot be written."""

    @classmethod
    def of(cls, path: Path, error: OSError) -> OutputError:
        """What the operating system said of ``path``."""
        return cls(place=Place(file=path), expected="a place that can be written", got=str(error))


class ModelError(InputError):
    """A model file is missing, damaged, incomplete or of a kind that this version does not run."""


class DatasetError(InputError):
    """A data set cannot be made as asked, or a stored one is missing, damaged or of another version."""


class StatisticsError(InputError):
    """A sample that no estimate can be made of, or a plan that cannot show what it is to show."""


class LedgerError(InputError):
    """A campaign's ledger is missing, damaged, in use, of another version or another plan's."""


class RegionError(InputError):
    """A box without an inside, or a shell of which nothing is left."""


class InstallationError(InputError):
    """What is installed does not do: two packages own one module, or the engine of a world is missing."""


class MissingPackageError(InstallationError):
    """A package that is an extra is not installed: ``place`` says what needs it, ``hint`` how to get it."""

    def __init__(self, *, place: Place, expected: str, got: str, hint: str = "") -> None:
        super().__init__(place=place, expected=expected, got=got, hint=hint)
        self.args = (f"{place}: needs {self.expected}, which is not installed: {self.hint}",)


class AvoiderError(SafetyHarnessError):
    """An avoider could not propose a repulsive position (no direction, NaN, wrong shape)."""


class SearchOrderError(SafetyHarnessError):
    """A searcher was asked and told out of turn, or proposed what is no point of the cube."""


class FlakyAvoiderError(AvoiderError):
    """An avoider answered the same question, with the same seed, in two ways."""


class SimulationError(SafetyHarnessError):
    """A world could not be built or stepped."""


class ControllerError(SimulationError):
    """A user's controller raised, returned what is no action, or is none: the run has failed."""


class NoAnswerError(SimulationError):
    """An avoider hangs: no answer within the wall limit.  The run has failed, and has no verdict."""

    def __init__(self, name: str, limit_s: float) -> None:
        super().__init__(f"the avoider {name!r} gave no answer within {limit_s:g} s of wall time")


class CampaignError(SafetyHarnessError):
    """A campaign cannot go on: its workers cannot be started, or the cluster is gone."""


class ArmModelError(SafetyHarnessError):
    """The robot description is missing or is not the kind of arm that this package knows."""
