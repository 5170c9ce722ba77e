"""Mistakes of the user's, in the words that pytest prints, and those that can be told before any test."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from safety_harness.exceptions import InputError, Place


def explained(error: BaseException) -> str:
    """Where, what was expected, what came, the hint; and the line of the test that asked."""
    if isinstance(error, InputError):
        lines = [str(error.place), f"  expected {error.expected}", f"  got      {error.got}"]
        lines += [f"  hint     {error.hint}"] if error.hint else []
    else:
        lines = [str(error)]
    lines += [f"  {note}" for note in getattr(error, "__notes__", [])]
    return "\n".join(lines).replace(f"{Path.cwd()}{os.sep}", "")


def refuse_unusable_avoider(reference: str, *, make: bool) -> None:
    """UsageError for an ``--avoider`` that there is not or that is none; only ``make`` executes a file."""
    from safety_harness.admission.avoiders import refuse_unusable, resolve_avoider, scenario_of_avoider

    try:
        look = resolve_avoider if make else refuse_unusable
        look(reference, scenario_of_avoider(reference), folder=None, place=Place(field="--avoider"))
    except InputError as error:
        raise pytest.UsageError(explained(error)) from None
