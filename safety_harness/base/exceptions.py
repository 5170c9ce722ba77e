"""All exceptions that this package raises on purpose; they form one tree, and each carries its data.

``SafetyHarnessError`` is the root.  Two branches matter to a caller:

* ``InputError``: the user can correct the cause.  It states the place (file, line, field), the expectation
  and the actual input.  The command line prints it without a traceback and ends with exit code 2.
* ``SimulationError``: the run could not continue.  It is never counted as safe.
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


MOST_CHARACTERS = 1_500  # of ``got``, in a message
MOST_WORDS = 1_000  # characters of a user's text


def on_one_line(text: str) -> str:
    """Return a text with "?" for each character that breaks a line or controls a terminal."""
    return text if text.isprintable() else "".join(c if c.isprintable() else "?" for c in text)


def printable(text: str) -> str:
    """Return a user's text on one line, without addresses of objects, cut at ``MOST_WORDS`` characters."""
    return on_one_line(re.sub(r"0x[0-9a-fA-F]+", "0x...", " ".join(text[:MOST_WORDS].split())))


def described(error: BaseException, file: str | None = None) -> str:
    """Return an exception of a user's code on one line: "NameError: name 'x' is not defined (mine.py:12)".

    The text contains no addresses of objects, so that a repeated run produces the same text.

    Args:
        error: The exception.
        file: The user's file as in the traceback; the text states the deepest line in it.  None: no line.

    """
    try:
        text = str(error)
    except Exception:  # a user's exception may fail to describe itself
        text = ""
    message = printable(text)
    lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == file]
    if isinstance(error, SyntaxError) and error.filename == file:
        lines, message = [error.lineno], printable(error.msg)  # its own text would repeat the place
    place = f" ({Path(file).name}:{lines[-1]})" if file and lines else ""
    return type(error).__name__ + (f": {message}" if message else "") + place


@dataclass(frozen=True)
class Place:
    """A place in the user's input; unknown parts are ``None``.

    A place with only a field is an option or argument of a command or a function.
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
    """The user's input cannot be used without a correction.

    Every text is put on one line, and ``got`` is cut at 1,500 characters.

    Args:
        place: The place of the input.
        expected: Completes the sentence "expected ...".
        got: Completes the sentence "got ...".
        hint: One more line of help: a near miss, or the list of allowed values.

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
        """Return the error of an option or argument of a command or a function.

        Args:
            option: The name of the option.
            expected: Completes "expected ...".
            got: Completes "got ...".
            hint: One more line of help.

        """
        return cls(place=Place(field=option), expected=expected, got=got, hint=hint)

    @classmethod
    def of_file(cls, file: Path | None, expected: str, got: str, hint: str = "") -> Self:
        """Return the error of a whole file.

        Args:
            file: The file; None: an input without a file.
            expected: Completes "expected ...".
            got: Completes "got ...".
            hint: One more line of help.

        """
        return cls(place=Place(file=file), expected=expected, got=got, hint=hint)

    def __reduce__(self) -> tuple[partial[InputError], tuple[()]]:
        """Return the parts for pickling, because pickle cannot call a constructor with keywords."""
        make = partial(type(self), place=self.place, expected=self.expected, got=self.got, hint=self.hint)
        return make, ()


def near_miss(text: str, allowed: Iterable[str], *, most: int = 1, all_of_them: str = "") -> str:
    """Return ``did you mean "..."?`` with the allowed names that resemble a text; empty if there are none.

    Args:
        text: The name that the user wrote.
        allowed: The names that the input may have.
        most: The largest number of names in the result.
        all_of_them: The command that lists all allowed names; the result always ends with it.

    """
    by_lower = {name.lower(): name for name in allowed}
    close = difflib.get_close_matches(text.lower(), by_lower, n=most, cutoff=0.5)
    names = " or ".join(f'"{by_lower[name]}"' for name in close)
    meant = f"did you mean {names}?" if text and close else ""
    return f"{meant} all of them: {all_of_them}".strip() if all_of_them else meant


_MADE_BY = {  # the function that returns an object of each type
    "Scenario": "read_scenario(path) reads one",
    "ScenarioSpace": "read_space(path) reads one",
    "Trace": "load_trace(path) reads one, run_trial(admitted) makes one",
    "Admitted": "admit(scenario) makes one",
}


def refuse_other_type(argument: str, value: object, *kinds: type, expected: str = "", hint: str = "") -> None:
    """Raise InputError unless the argument of a function is of an allowed type.

    Args:
        argument: The name of the argument.
        value: Its value.
        *kinds: The allowed types.
        expected: Completes "expected ..."; empty: the name of the first type.
        hint: Empty: the function that makes such a value, if the first type has one.

    """
    if not isinstance(value, kinds):
        name, got = kinds[0].__name__, f"{type(value).__name__} {value!r}"
        got = got if len(got) <= 80 else got[:77] + "..."
        raise InputError.of_option(argument, expected or f"a {name}", got, hint or _MADE_BY.get(name, ""))


def no_truth_value(question: str) -> InputError:
    """Return the error for a truth test such as ``assert judge(trace)``, which would pass for any verdict."""
    hint = "assert_holds(claim, trace), or evaluation.verdict is Verdict.HOLDS"
    return InputError.of_option("truth value", "a question that a verdict answers", question, hint)


def explanation(error: BaseException) -> str:
    """Return the text of an error for people: place, expectation, actual input and hint, line by line.

    The text of a missing package is a single line.
    """
    if not isinstance(error, InputError) or isinstance(error, MissingPackageError):
        return str(error)
    lines = [str(error.place), f"  expected {error.expected}", f"  got      {error.got}"]
    return "\n".join([*lines, f"  hint     {error.hint}"] if error.hint else lines)


class ScenarioError(InputError):
    """A scenario file is malformed, or it contains an impossible value."""


class RecordingError(InputError):
    """A recorded motion cannot be used: it lacks a time column or samples, or a gap or jump is too large."""


class LogError(InputError):
    """The log of a cell cannot be used: it is out of order, impossibly fast, damaged, or otherwise wrong."""


class StreamError(InputError):
    """A monitor cannot use a line of a stream, or can use only a part of the line."""


class InadmissibleError(InputError):
    """A well-formed scenario cannot run, for example with a start out of reach or an object out of view."""


class FormulaError(InputError):
    """A temporal formula is malformed, or does not fit the scenario."""


class SettingsError(InputError):
    """A setting has an impossible value."""


class TraceError(InputError):
    """A stored trace is missing, truncated, of another version or not a trace at all."""


class OutputError(InputError):
    """A folder or file for results cannot be written."""

    @classmethod
    def from_os_error(cls, path: Path, error: OSError) -> OutputError:
        """Return the error for ``path``, with the operating system's message in ``error``."""
        return cls(place=Place(file=path), expected="a place that can be written", got=str(error))


class ModelError(InputError):
    """A model file is missing, damaged, incomplete or of a kind that this version does not run."""


class DatasetError(InputError):
    """A data set cannot be generated, or a stored one is missing, damaged or of another version."""


class StatisticsError(InputError):
    """A sample allows no estimate, or a plan cannot reach its target."""


class LedgerError(InputError):
    """A campaign's ledger is missing, damaged, in use, of another version, or belongs to another plan."""


class RegionError(InputError):
    """A region cannot be used: a box has no inside, or a shell has no volume."""


class InstallationError(InputError):
    """The installation cannot be used: two packages own one module, or the engine of a world is missing."""


class MissingPackageError(InstallationError):
    """A missing optional package: ``place`` states what needs it, ``hint`` how to install it."""

    def __init__(self, *, place: Place, expected: str, got: str, hint: str = "") -> None:
        super().__init__(place=place, expected=expected, got=got, hint=hint)
        self.args = (f"{place}: needs {self.expected}, which is not installed: {self.hint}",)


class AvoiderError(SafetyHarnessError):
    """An avoider failed to propose a repulsive position (no direction, NaN or a wrong shape)."""


class SearchOrderError(SafetyHarnessError):
    """A search was used out of order, or a searcher proposed a point outside the unit cube.

    The order concerns the calls of ``ask`` and ``tell_scores``.
    """


class FlakyAvoiderError(AvoiderError):
    """An avoider gave two different answers to the same question with the same seed."""


class SimulationError(SafetyHarnessError):
    """A world could not be built or stepped."""


class ControllerError(SimulationError):
    """A run failed: the user's controller raised, returned an invalid action, or is no controller."""


class NoAnswerError(SimulationError):
    """An avoider gave no answer within the limit of real time, so the run has failed, without a verdict."""

    def __init__(self, name: str, limit_s: float) -> None:
        super().__init__(f"the avoider {name!r} gave no answer within {limit_s:g} s of wall time")


class EditedProgramError(InadmissibleError):
    """The files of a program have changed while a job runs, so that its runs would not belong together."""


class CampaignError(SafetyHarnessError):
    """A campaign cannot continue, because its workers cannot start or the cluster is gone."""


class ArmModelError(SafetyHarnessError):
    """The robot description is missing or is not the kind of arm that this package knows."""
