"""All exceptions that this package raises on purpose.

All exceptions have a common root class, and each exception stores its data as attributes.
``SafetyHarnessError`` is the root.  Two subclasses matter to a caller:

* ``InputError`` means that the user can correct the cause.  The error states the place (file, line, field),
  the expected input and the actual input.  The command line prints it without a traceback and ends with exit
  code 2.
* ``SimulationError`` means that the run could not continue.  Such a run never counts as passed.
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
    """Return a text in which "?" replaces each character that breaks a line or controls a terminal."""
    return text if text.isprintable() else "".join(c if c.isprintable() else "?" for c in text)


def printable(text: str) -> str:
    """Return a user's text on one line.

    The text contains no addresses of objects, and at most ``MOST_WORDS`` characters.
    """
    return on_one_line(re.sub(r"0x[0-9a-fA-F]+", "0x...", " ".join(text[:MOST_WORDS].split())))


def described(error: BaseException, file: str | None = None) -> str:
    """Return an exception of a user's code on one line: "NameError: name 'x' is not defined (mine.py:12)".

    The text contains no addresses of objects, so that a repeated run produces the same text.

    Args:
        error: The exception.
        file: The path of the user's file as it appears in the traceback.  The text states the innermost line
            of the traceback in this file.  None means that the text states no line.

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
    """A place in the user's input.

    Unknown parts are None.  If a place has only a field, the field is an option or argument of a command, or
    an argument of a function.
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

    Each text is converted to a single line, and ``got`` is cut after 1,500 characters.

    Args:
        place: The place of the input.
        expected: Completes the sentence "expected ...".
        got: Completes the sentence "got ...".
        hint: One more line of help, such as a similar allowed name or the list of all allowed values.

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
        """Return the error for an option or argument of a command or function.

        Args:
            option: The name of the option.
            expected: Completes "expected ...".
            got: Completes "got ...".
            hint: One more line of help.

        """
        return cls(place=Place(field=option), expected=expected, got=got, hint=hint)

    @classmethod
    def of_file(cls, file: Path | None, expected: str, got: str, hint: str = "") -> Self:
        """Return an error that refers to a whole file.

        Args:
            file: The file, or None if the input is no file.
            expected: Completes "expected ...".
            got: Completes "got ...".
            hint: One more line of help.

        """
        return cls(place=Place(file=file), expected=expected, got=got, hint=hint)

    def __reduce__(self) -> tuple[partial[InputError], tuple[()]]:
        """Return a callable without arguments for pickle, because pickle cannot pass keyword arguments."""
        make = partial(type(self), place=self.place, expected=self.expected, got=self.got, hint=self.hint)
        return make, ()


def near_miss(text: str, allowed: Iterable[str], *, most: int = 1, all_of_them: str = "") -> str:
    """Return ``did you mean "..."?`` with the allowed names that are similar to ``text``.

    The result is empty if no name is similar.

    Args:
        text: The name that the user wrote.
        allowed: The names that are allowed here.
        most: The largest number of names in the result.
        all_of_them: The command that lists all allowed names.  If given, the result always ends with this
            command.

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
        expected: Completes the text "expected ...".  If empty, the text is the name of the first allowed
            type.
        hint: A hint for the user.  If empty, the hint states the function that creates the first type, if
            there is such a function.

    """
    if not isinstance(value, kinds):
        name, got = kinds[0].__name__, f"{type(value).__name__} {value!r}"
        got = got if len(got) <= 80 else got[:77] + "..."
        raise InputError.of_option(argument, expected or f"a {name}", got, hint or _MADE_BY.get(name, ""))


def no_truth_value(question: str) -> InputError:
    """Return the error for an attempt to use verdicts as a truth value.

    Such a test, for example ``assert judge(trace)``, would pass for any verdict.
    """
    hint = "assert_holds(claim, trace), or evaluation.verdict is Verdict.HOLDS"
    return InputError.of_option("truth value", "a question that a verdict answers", question, hint)


def explanation(error: BaseException) -> str:
    """Return the text of an error for people.

    Its lines are the place, the expected input, the actual input and the hint.  If a package is missing, the
    text is a single line.
    """
    if not isinstance(error, InputError) or isinstance(error, MissingPackageError):
        return str(error)
    lines = [str(error.place), f"  expected {error.expected}", f"  got      {error.got}"]
    return "\n".join([*lines, f"  hint     {error.hint}"] if error.hint else lines)


class ScenarioError(InputError):
    """A scenario file is malformed, or it contains an impossible value."""


class RecordingError(InputError):
    """A recorded motion cannot be used: it lacks times or samples, or has a gap or jump that is too large."""


class LogError(InputError):
    """The log of a cell cannot be used: it is out of order, impossibly fast, damaged, or otherwise wrong."""


class StreamError(InputError):
    """A monitor cannot use a line of a stream, or can use only a part of the line."""


class InadmissibleError(InputError):
    """A scenario is well formed but cannot run, for example because its start is out of reach."""


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
        """Return the error for ``path``, which contains the text of the operating system's error."""
        return cls(place=Place(file=path), expected="a place that can be written", got=str(error))


class ModelError(InputError):
    """A model file is missing, damaged or incomplete, or has a kind that this version does not run."""


class DatasetError(InputError):
    """A data set cannot be generated, or a stored one is missing, damaged or of another version."""


class StatisticsError(InputError):
    """A sample allows no estimate, or a plan cannot reach its target."""


class LedgerError(InputError):
    """A campaign's ledger is missing, damaged or in use, or it belongs to another version or another plan."""


class RegionError(InputError):
    """A region cannot be used, because a box or a shell has no volume."""


class InstallationError(InputError):
    """The installation cannot be used: two packages own one module, or the engine of a world is missing."""


class MissingPackageError(InstallationError):
    """An optional package is missing.

    ``place`` states the feature that needs the package, and ``hint`` states how to install the package.
    """

    def __init__(self, *, place: Place, expected: str, got: str, hint: str = "") -> None:
        super().__init__(place=place, expected=expected, got=got, hint=hint)
        self.args = (f"{place}: needs {self.expected}, which is not installed: {self.hint}",)


class AvoiderError(SafetyHarnessError):
    """An avoider failed to propose a position: its answer is NaN, lacks a direction or has a wrong shape."""


class SearchOrderError(SafetyHarnessError):
    """The calls to a search had a wrong order, or a searcher proposed a point outside the unit cube.

    Each call of ``ask`` must be followed by a call of ``tell_scores``.
    """


class FlakyAvoiderError(AvoiderError):
    """An avoider gave two different answers to the same question with the same seed."""


class SimulationError(SafetyHarnessError):
    """A world could not be built or stepped."""


class ControllerError(SimulationError):
    """A user's controller raised an exception, returned an invalid action, or lacks a necessary method."""


class NoAnswerError(SimulationError):
    """An avoider did not answer within the limit of real time.

    The run has failed and has no verdict.
    """

    def __init__(self, name: str, limit_s: float) -> None:
        super().__init__(f"the avoider {name!r} gave no answer within {limit_s:g} s of wall time")


class EditedProgramError(InadmissibleError):
    """The files of a program changed during a job.

    The runs before and after the change would not test the same program.
    """


class CampaignError(SafetyHarnessError):
    """A campaign cannot continue, because its workers cannot start or the cluster cannot be reached."""


class ArmModelError(SafetyHarnessError):
    """The robot description is missing, or it describes a kind of arm that this package does not support."""
